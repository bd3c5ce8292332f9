"""Subsets of many rows: evenly spread, and without a period. Pure; integer arithmetic only.

With every n-th row, a pattern of period n would always be sampled at the same phase, for example at the first row of
each trajectory. A lattice (Korobov 1959) with a step near the golden section avoids this: it samples every part of a
range equally often, and neighbouring ranges at different phases.
"""

import math
from collections.abc import Iterable
from typing import Final

import numpy as np
import numpy.typing as npt

from atoll_coordinator.result.base import finite
from atoll_core.data.dataset import FloatArray

_GOLDEN: Final = 0.618
"""The golden section. Among all numbers, fractions approximate it worst."""


def lattice_step(count: int) -> int:
    """Return a step near the golden section of `count` that has no common divisor with `count`.

    The multiples of the step modulo `count` are all numbers below `count`, in an order in which consecutive numbers are
    far apart."""
    steps = (step for step in range(1, count + 1) if math.gcd(step, count) == 1)
    return min(steps, key=lambda step: abs(step - _GOLDEN * count))


def thinned_places(places: int, most: int) -> npt.NDArray[np.int64]:
    """Return about `most` row numbers below `places`, in ascending order. The rows are divided into ranges of equal
    length, and one row of each range is returned. All row numbers are returned if `places` is less than 2 `most`."""
    width = places // most
    if width < 2:
        return np.arange(places, dtype=np.int64)
    ranges = np.arange(places // width, dtype=np.int64)
    return ranges * width + ranges * lattice_step(width) % width


def spread_places(places: int, most: int) -> list[int]:
    """Return evenly spread row numbers below `places`, at most `most` (2 or more). The first and the last row are
    included."""
    if places <= most:
        return [*range(places)]
    return [(index * (places - 1)) // (most - 1) for index in range(most)]


def curve(values: FloatArray, digits: int = 7) -> tuple[float | None, ...]:
    """Return `values` (R,) for a result, rounded to `digits` significant digits; a value that is not finite becomes
    None.

    Curves have many numbers and are only plotted, so seven digits are enough.
    """
    return tuple(finite(float(f"{value:.{digits}g}")) for value in values.tolist())


def curves(names: Iterable[str], values: Iterable[FloatArray], digits: int = 7) -> dict[str, tuple[float | None, ...]]:
    """Return the curve of each row of `values` by name."""
    return {name: curve(row, digits) for name, row in zip(names, values, strict=True)}
