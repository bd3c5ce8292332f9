"""Stretches in which a sensor was at the end of its range: rows exactly at the largest or the least value. Pure."""

from collections.abc import Iterator, Sequence

import numpy as np

from atoll_coordinator.data.columns.finding import Columns, Finding, Parts
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray

LIMITS = SETTINGS.columns


def check_clipping(columns: Columns) -> Iterator[Finding]:
    """Yield a finding for each state that was clipped; what it was there is not known, but for a bound."""
    if not columns.is_in_time or columns.config.data.stochastic:
        return
    for name in columns.roles.states:
        if name in columns.angles:
            continue
        clipped = _clipped(columns.values[name])
        rows = sum(int(np.count_nonzero(columns.whole[name] == value)) for value in clipped)
        if not clipped or len(columns.finite(name)) - rows < rows // LIMITS.most_clipped:
            continue
        bounds = " and ".join(f"{value:.6g}" for value in clipped)
        yield Finding(
            f"{rows} values of '{name}' are exactly {bounds}, as of a sensor at the end of its range",
            "they are taken as missing, since they only bound what was measured",
            missing=tuple((name, value) for value in clipped),
        )


def _clipped(parts: Parts) -> list[float]:
    """Return the largest value, the least one, or both, where a state that moves fast stops there at once.

    A state that comes to rest does so gradually, and the steps beside a turn that was rounded are a few of its
    rounding. One that is held stays at other values as well.
    """
    values = np.concatenate(list(parts))
    unique = np.unique(values[np.isfinite(values)])
    if len(unique) <= LIMITS.few_values:
        return []
    resolution = float(np.min(np.diff(unique)))
    ends = [float(unique[-1]), float(unique[0])]
    runs = [(value, part, run) for part in parts for value, run in _runs(part)]
    if any(value not in ends for value, _, _ in runs):
        return []
    steep = LIMITS.steep_steps * resolution
    return [end for end in ends if any(value == end and _is_abrupt(part, run, steep) for value, part, run in runs)]


def _runs(part: FloatArray) -> Iterator[tuple[float, tuple[int, int]]]:
    """Yield the value and the half-open range of each run of equal values that is long enough."""
    begins = np.flatnonzero(np.concatenate([[True], part[1:] != part[:-1]]))
    ends = np.append(begins[1:], len(part))
    is_long = ends - begins >= LIMITS.least_run
    for first, last in zip(begins[is_long].tolist(), ends[is_long].tolist(), strict=True):
        yield float(part[first]), (first, last)


def _is_abrupt(part: FloatArray, run: Sequence[int], steep: float) -> bool:
    """Say whether the steps just outside of a run, on both of its sides, are steep."""
    first, last = run
    if first < 2 or last > len(part) - 2:
        return False
    return abs(float(part[first - 1] - part[first - 2])) > steep and abs(float(part[last + 1] - part[last])) > steep
