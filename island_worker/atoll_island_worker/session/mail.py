"""Mail between islands: a mailbox of immigrants, and what comes before its placement. Pure; what is lost is pulled.

Blocks are filed by (epoch, destination, source), each once: so the order in which mail arrives cannot matter.
"""

import math
from collections.abc import Container, Iterable, KeysView
from typing import Final

from atoll_core.wire.messages.epochs import Block
from atoll_island_worker.session.events import Mailed

MAX_PENDING: Final = 256
"""Messages kept of terms whose placement has not come yet."""


class Mailbox:
    """The immigrants that came for the islands of a shard and have not been handed over."""

    def __init__(self) -> None:
        self._blocks: dict[tuple[int, int], dict[int, bytes]] = {}

    def file(self, epoch: int, block: Block) -> bool:
        """File a block of an epoch; return whether it is the first of its source and destination."""
        filed = self._blocks.setdefault((epoch, block.destination), {})
        is_first = block.source not in filed
        filed.setdefault(block.source, block.data)
        return is_first

    def sources(self, epoch: int, destination: int) -> KeysView[int]:
        """Return the islands whose blocks of an epoch are there for `destination`."""
        return self._blocks.get((epoch, destination), {}).keys()

    def blocks(self, epoch: int, destination: int, sources: Iterable[int]) -> dict[int, bytes]:
        """Return the blocks of these sources, by source in ascending order; all of them must be there."""
        filed = self._blocks[epoch, destination]
        return {source: filed[source] for source in sorted(sources)}

    def keep_only(self, epoch: int, destination: int, sources: Container[int]) -> None:
        """Forget the blocks of other sources than these."""
        filed = self._blocks[epoch, destination]
        self._blocks[epoch, destination] = {source: data for source, data in filed.items() if source in sources}

    def forget(self, epoch: int, destination: int) -> None:
        """Forget the blocks of an epoch for `destination`, if any."""
        self._blocks.pop((epoch, destination), None)

    def filed(self) -> KeysView[tuple[int, int]]:
        """Return (epoch, destination) of all that is there."""
        return self._blocks.keys()


class PendingMessages:
    """The last messages of terms whose placement has not come yet, in the order in which they came."""

    def __init__(self) -> None:
        self._messages: list[Mailed] = []

    def keep(self, mail: Mailed) -> bool:
        """Keep a message; return whether it is the first of its archipelago."""
        is_first = all(
            (message.body.job, message.body.variable) != (mail.body.job, mail.body.variable)
            for message in self._messages
        )
        self._messages = [*self._messages[-(MAX_PENDING - 1) :], mail]
        return is_first

    def take(self, job: str, variable: str) -> list[Mailed]:
        """Remove the messages of an archipelago and return them."""
        taken = [message for message in self._messages if (message.body.job, message.body.variable) == (job, variable)]
        self.forget(job, variable)
        return taken

    def forget(self, job: str, variable: str | None = None, term: float = math.inf) -> None:
        """Forget the messages of an archipelago, or of all of a job (`variable` None), up to a term."""
        self._messages = [
            message
            for message in self._messages
            if message.body.job != job or variable not in (None, message.body.variable) or message.body.term > term
        ]

    def clear(self) -> None:
        """Forget all messages."""
        self._messages.clear()
