"""A value that stands for a missing one: repeated, and far outside of all others, such as -9999. Pure."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from atoll_coordinator.data.columns.finding import Columns, Finding
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray

LIMITS = SETTINGS.columns
ROUNDING: Final = 1e-12
"""Guard: values that differ by less than this share of their size are one value."""


@dataclass(frozen=True)
class FillValue:
    """A value that `count` rows of a column hold."""

    value: float
    count: int


def check_fill_values(columns: Columns) -> Iterator[Finding]:
    """Yield a finding for each value that looks like one that was written where nothing was measured."""
    for name, fill in fill_values(columns).items():
        values = columns.finite(name)
        others = values[values != fill.value]
        rows = "1 row holds" if fill.count == 1 else f"{fill.count} rows hold"
        yield Finding(
            f"{rows} {fill.value:.15g} in '{name}', whose other values lie between {float(np.min(others)):.4g} and "
            f"{float(np.max(others)):.4g}",
            f"if it stands for a missing value, add --missing-value {fill.value:.15g}",
        )


def fill_values(columns: Columns) -> dict[str, FillValue]:
    """Return the value of each column, if there is one, that looks like one of a missing measurement."""
    found = {name: _fill_value(columns.finite(name)) for name in columns.values if name not in columns.angles}
    return {name: fill for name, fill in found.items() if fill is not None}


def _fill_value(values: FloatArray) -> FillValue | None:
    """Return the least or the largest value if it is repeated and further from all others than these are apart.

    What moves would have passed through values in between. Of the others there are several, so that it is no switch;
    they are most of the rows. One row will do for a number that is written in nines, as those of missing values are.
    """
    unique, counts = np.unique(values, return_counts=True)
    if len(unique) <= LIMITS.few_values:
        return None
    gaps = np.diff(unique)
    for end, gap, rest in ((0, gaps[0], unique[1:]), (-1, gaps[-1], unique[:-1])):
        others, size = float(rest[-1] - rest[0]), float(np.max(np.abs(rest)))
        value, count = float(unique[end]), int(counts[end])
        enough = 1 if _is_nines(value) else LIMITS.least_repeats
        if gap > others > ROUNDING * size and enough <= count < len(values) // 2:
            return FillValue(value, count)
    return None


def _is_nines(value: float) -> bool:
    """Say whether a number is written as 99, -999, 9999.0, 99.99 and so on, with two nines or more."""
    digits = f"{abs(value):.15g}".replace(".", "")
    return len(digits) > 1 and set(digits) == {"9"}
