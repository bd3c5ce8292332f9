"""Mail of terms whose placement has not come yet. Pure; what is dropped can be pulled."""

import math
from typing import Final

from atoll_island_worker.session.events import Mailed

MAX_EARLY: Final = 256
"""Messages kept of such terms."""


class EarlyMail:
    """The last messages of such terms, in the order in which they came."""

    def __init__(self) -> None:
        self._kept: list[Mailed] = []

    def keep(self, mail: Mailed) -> bool:
        """Keep a message; return whether it is the first of its archipelago."""
        is_first = all(
            (each.body.job, each.body.variable) != (mail.body.job, mail.body.variable) for each in self._kept
        )
        self._kept = [*self._kept[-(MAX_EARLY - 1) :], mail]
        return is_first

    def take(self, job: str, variable: str) -> list[Mailed]:
        """Hand over the messages of an archipelago; they are kept no more."""
        taken = [each for each in self._kept if (each.body.job, each.body.variable) == (job, variable)]
        self._kept = [each for each in self._kept if each not in taken]
        return taken

    def forget(self, job: str, variable: str | None = None, term: float = math.inf) -> None:
        """Forget the messages of an archipelago, or of all of a job (`variable` None), up to a term."""
        self._kept = [
            each
            for each in self._kept
            if each.body.job != job or variable not in (None, each.body.variable) or each.body.term > term
        ]

    def clear(self) -> None:
        """Forget all messages."""
        self._kept.clear()
