"""The end of refining set by ``--max-time``: the only clock that may change a result, and only if the user sets it.

Choosing the equations ends first; the remaining time is for their constants, errors and verdicts. A stage that begins
after the end tries nothing new and returns the best so far.
"""

import time
from collections.abc import Callable
from typing import Final

CHOICE_SHARE: Final = 0.6
"""Share of the seconds in which equations are chosen. The later stages take about a tenth of that time, but more with
many rows, which the choice thins."""

_LAST_SHARE: Final = 0.9
"""Share of the seconds after which also the last stage starts nothing new: the rest is for the report."""


class Deadline:
    """Tells when the time of a stage is over."""

    def __init__(self, seconds: float | None = None, clock: Callable[[], float] = time.monotonic) -> None:
        """Begin to count `seconds`; None: time is never over."""
        self.seconds: Final = seconds
        self._clock: Final = clock
        self._began: Final = clock()
        self._share = CHOICE_SHARE
        self.has_cut_short = False
        """Whether the time limit has stopped any work."""

    @property
    def is_over(self) -> bool:
        """Whether nothing new is to be begun."""
        if self.seconds is None or self._clock() - self._began < self._share * self.seconds:
            return False
        self.has_cut_short = True
        return True

    @property
    def left(self) -> float | None:
        """Seconds until nothing new is to be begun, at least 0; None: that never comes."""
        return None if self.seconds is None else max(0.0, self._began + self._share * self.seconds - self._clock())

    def begin_last_stage(self) -> None:
        """Allow the time that choosing equations does not have."""
        self._share = _LAST_SHARE
