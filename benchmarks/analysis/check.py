"""One figure beside what it should be."""

import time
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Check:
    """What was `found` of a quantity beside what is `expected`, with the source of that; None: nothing is expected."""

    part: str
    quantity: str
    found: str
    expected: str
    source: str
    passes: bool | None


def near(part: str, quantity: str, value: float, expected: float, source: str, tolerance: float) -> Check:
    """Return the check of a number that may be off by `tolerance`, as a share of the expected one or of 1."""
    off = abs(value - expected) / (abs(expected) or 1.0)
    return Check(part, quantity, f"{value:.9g}", f"{expected:.9g} to {tolerance:g}", source, bool(off <= tolerance))


def same(part: str, quantity: str, value: Any, expected: Any, source: str) -> Check:
    """Return the check of what must be equal."""
    return Check(part, quantity, str(value), str(expected), source, bool(value == expected))


@dataclass
class Timer:
    """Wall time and time of this process's own, in seconds since it was made."""

    def __post_init__(self) -> None:
        self._wall, self._processor = time.monotonic(), time.process_time()

    def check(self, part: str, quantity: str, limit: float | None) -> Check:
        """Return the check that the wall time lies below a limit, if there is one."""
        wall, processor = time.monotonic() - self._wall, time.process_time() - self._processor
        return _limited(part, quantity, f"{wall:.1f} s (processor {processor:.1f} s)", wall, limit)


def seconds(part: str, quantity: str, times: list[float], limit: float | None) -> Check:
    """Return the check of times: their median lies below a limit, if there is one."""
    middle = float(np.median(times))
    spread = f"{middle:.2f} s ({min(times):.2f} to {max(times):.2f}, {len(times)} times)"
    return _limited(part, quantity, spread, middle, limit)


def _limited(part: str, quantity: str, text: str, time_s: float, limit: float | None) -> Check:
    if limit is None:
        return Check(part, quantity, text, "", "", None)
    return Check(part, quantity, text, f"below {limit:g} s", "", time_s < limit)
