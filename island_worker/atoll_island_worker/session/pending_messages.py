"""Mail of terms whose placement has not come yet. Pure; what is dropped can be pulled."""

import math
from typing import Final

from atoll_island_worker.session.events import Mailed

MAX_PENDING: Final = 256
"""Messages kept of such terms."""


class PendingMessages:
    """The last messages of such terms, in the order in which they came."""

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
