"""The time limit of refining, ``--max-time``. Nothing else in refining may depend on a clock.

The choice of equations ends first; the remaining time is for constants, errors and verdicts. When the time of a stage
is over, the stage tries nothing new and returns the best result so far.
"""

import time
from collections.abc import Callable
from typing import Final

CHOICE_SHARE: Final = 0.6
"""Share of the seconds in which equations are chosen. The later stages take about a tenth of that time. With many rows
their share of the time is larger, since the choice uses only a subset of the rows."""

_LAST_SHARE: Final = 0.9
"""Share of the seconds after which the last stage starts nothing new. The rest is for the report."""


class Deadline:
    """The time limit of refining, in two stages."""

    def __init__(self, seconds: float | None = None, clock: Callable[[], float] = time.monotonic) -> None:
        """Start the clock. `seconds` is the limit; None: no limit."""
        self.seconds: Final = seconds
        self._clock: Final = clock
        self._began: Final = clock()
        self._share = CHOICE_SHARE
        self.has_cut_short = False
        """Whether the time limit has stopped any work."""

    @property
    def is_over(self) -> bool:
        """Whether the time of the current stage is over, so that nothing new may start."""
        if self.seconds is None or self._clock() - self._began < self._share * self.seconds:
            return False
        self.has_cut_short = True
        return True

    @property
    def seconds_left(self) -> float | None:
        """Seconds until `is_over`, at least 0; None: no limit."""
        return None if self.seconds is None else max(0.0, self._began + self._share * self.seconds - self._clock())

    def begin_last_stage(self) -> None:
        """Extend the limit from the choice of equations to the stages after it."""
        self._share = _LAST_SHARE
