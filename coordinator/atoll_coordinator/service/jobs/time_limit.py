"""The limit on a job's time, `--max-time`: when it ends preparing, the search and refining."""

from dataclasses import dataclass
from typing import Final

from atoll_core.wire.messages.views import JobState

SEARCH_SHARE: Final = 0.5
"""Share of what preparing leaves that the search may take: refining takes about as long."""


@dataclass(frozen=True, slots=True)
class TimeLimit:
    """A limit of so many `seconds` from a job's start; None: no limit."""

    seconds: float | None

    def is_up(self, state: JobState, spent: float, prepared_in: float) -> bool:
        """Tell whether what a job in this state does ends `spent` seconds after its start.

        The search ends before the limit, so that refining has its share of what preparing, which took `prepared_in`
        seconds, has left. A job that waits or has ended has no limit.
        """
        if self.seconds is None or state not in ("preparing", "running", "refining"):
            return False
        search_end = prepared_in + SEARCH_SHARE * max(0.0, self.seconds - prepared_in)
        return spent >= (search_end if state == "running" else self.seconds)

    def remaining(self, spent: float) -> float | None:
        """Return the seconds that are left after `spent`, not below 0; None: there is no limit."""
        return None if self.seconds is None else max(0.0, self.seconds - spent)
