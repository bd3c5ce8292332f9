"""Some of many places, spread evenly and in step with nothing that recurs. Pure; whole numbers alone.

Every n-th place could always be the same place in a pattern of period n, such as the first row of each trajectory. A
lattice (Korobov 1959) with a step near the golden section samples every part of a range equally often, and neighbouring
ranges in distant parts.
"""

import math
from collections.abc import Iterable
from typing import Final

import numpy as np
import numpy.typing as npt

from atoll_coordinator.result.base import finite
from atoll_core.data.dataset import FloatArray

_GOLDEN: Final = 0.618
"""The golden section, the number that fractions are farthest from."""


def lattice_step(count: int) -> int:
    """Return the step whose multiples modulo `count` are all numbers below, neighbours being distant."""
    steps = (step for step in range(1, count + 1) if math.gcd(step, count) == 1)
    return min(steps, key=lambda step: abs(step - _GOLDEN * count))


def thinned_places(places: int, most: int) -> npt.NDArray[np.int64]:
    """Return about `most` of so many places, ascending, one of each of equal ranges; all of less than twice as many."""
    width = places // most
    if width < 2:
        return np.arange(places, dtype=np.int64)
    ranges = np.arange(places // width, dtype=np.int64)
    return ranges * width + ranges * lattice_step(width) % width


def spread_places(places: int, most: int) -> list[int]:
    """Return at most `most` (2 or more) of so many places, evenly spread, the first and the last among them."""
    if places <= most:
        return [*range(places)]
    return [(index * (places - 1)) // (most - 1) for index in range(most)]


def curve(values: FloatArray, digits: int = 7) -> tuple[float | None, ...]:
    """Return `values` (R,) as a result lists them: in this many significant digits, null where a value is not finite.

    Curves have many numbers and are looked at, so that seven digits are enough.
    """
    return tuple(finite(float(f"{value:.{digits}g}")) for value in values.tolist())


def curves(names: Iterable[str], values: Iterable[FloatArray], digits: int = 7) -> dict[str, tuple[float | None, ...]]:
    """Return the curve of each row of values by its name."""
    return {name: curve(row, digits) for name, row in zip(names, values, strict=True)}
