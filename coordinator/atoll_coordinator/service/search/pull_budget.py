"""Decides which states of checkpoints are pulled from workers while the search goes on. Pure.

The states that are held at a time are limited. The checkpoint that was begun first always goes on, once nothing is
being written, so that none waits for ever, and one that is larger than the limit goes through alone.
"""

from collections.abc import Mapping
from typing import Final

from atoll_coordinator.service.search.archipelago import Archipelago, ArchipelagoKey, Checkpoint
from atoll_core.wire.messages.epochs import PullStates, States
from atoll_core.wire.messages.limits import CHUNK_SIZE

MAX_PULLS: Final = 4
"""Pulls of states under way at the same time; with 4 MB an answer, what may come in at once."""

MAX_BYTES: Final = 256 * 1024**2
"""Of states held at the same time: gathered, asked for, or being written; and beyond that of one checkpoint."""


class PullBudget:
    """All checkpoints that are being gathered or written."""

    def __init__(self) -> None:
        self._pulls = 0
        self._gathered: dict[ArchipelagoKey, int] = {}  # bytes, in the order in which they were begun
        self._written: dict[ArchipelagoKey, int] = {}
        self.is_short = False
        """Whether a checkpoint waits for others to be written."""

    @property
    def held_bytes(self) -> int:
        """Bytes of all states that are here."""
        return sum(self._gathered.values()) + sum(self._written.values())

    def begin_round(self, archipelagos: Mapping[ArchipelagoKey, Archipelago]) -> None:
        """Forget checkpoints that were given up: their archipelago is not among the open ones, or lost a worker."""
        for key in list(self._gathered):
            if key not in archipelagos or archipelagos[key].gathered_bytes is None:
                del self._gathered[key]
        self.is_short = False

    def next_pulls(self, archipelago: Archipelago) -> list[tuple[str, PullStates]]:
        """Return the pulls of states that are due and affordable, each with its worker; they count as under way."""
        wanted = MAX_PULLS - self._pulls
        affordable = min(wanted, self._affordable_pulls(archipelago.key))
        self.is_short = self.is_short or affordable < wanted
        pulls = archipelago.next_pulls(affordable)
        if pulls:
            self._gathered.setdefault(archipelago.key, 0)
        self._pulls += len(pulls)
        return pulls

    def take_complete_checkpoint(self, archipelago: Archipelago) -> Checkpoint | None:
        """Return the checkpoint of an archipelago that can be written now, once; it counts as being written."""
        checkpoint = archipelago.take_complete_checkpoint()
        if checkpoint is not None:
            self._gathered.pop(archipelago.key, None)
            self._written[archipelago.key] = checkpoint.size
        return checkpoint

    def add_states(self, archipelago: Archipelago | None, worker: str, pull: PullStates, body: States | None) -> None:
        """Take in the answer to a pull; None: there was none.

        Raises:
            RemoteProtocolError: A state was damaged on its way, and is pulled again.
        """
        self._pulls -= 1
        if archipelago is None:
            return
        archipelago.add_states(worker, pull, body)
        if archipelago.gathered_bytes is None:
            self._gathered.pop(archipelago.key, None)
        elif archipelago.key in self._gathered:
            self._gathered[archipelago.key] = archipelago.gathered_bytes

    def mark_written(self, checkpoint: Checkpoint) -> None:
        """Take in that a checkpoint is durable."""
        self._written.pop(checkpoint.key, None)

    def _affordable_pulls(self, key: ArchipelagoKey) -> int:
        """Return for how many more pulls of an archipelago's states there is memory."""
        if not self._written and next(iter(self._gathered), key) == key:
            return MAX_PULLS
        return (MAX_BYTES - self.held_bytes) // CHUNK_SIZE - self._pulls
