"""The end of refining that ``--max-time`` sets: the one clock that may decide a result, where it was asked for.

Choosing the equations ends first; what remains is for their constants, errors and verdicts. Stages that find the time
over try nothing new and hand on the best so far.
"""

import time
from collections.abc import Callable
from typing import Final

CHOICE_SHARE: Final = 0.6
"""Share of the seconds in which equations are chosen. What follows takes about a tenth of that time, but more where
there are many rows, which choosing thins."""

_LAST_SHARE: Final = 0.9
"""Share of the seconds after which also the last stage only finishes what it has: the rest is for the report."""


class Deadline:
    """Tells when the time of a stage is over."""

    def __init__(self, seconds: float | None = None, clock: Callable[[], float] = time.monotonic) -> None:
        """Begin to count `seconds`; None: time is never over."""
        self.seconds: Final = seconds
        self._clock: Final = clock
        self._began: Final = clock()
        self._share = CHOICE_SHARE
        self.has_cut_short = False
        """Whether anything has been left out for want of time."""

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
