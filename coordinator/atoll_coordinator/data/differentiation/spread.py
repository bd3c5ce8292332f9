"""The standard deviation by which values are judged, for values of any size. Pure."""

from typing import Final

from atoll.data.dataset import FloatArray
from atoll.errors import DataError
from atoll_coordinator.data.differentiation.kernels.stencils import moments

ROUNDING: Final = 1e-12
"""A column that varies less than this share of its mean is judged by the mean: it may well be constant."""
SMALLEST: Final = 1e-150
"""Numbers below this, or above its inverse, have no square that can be told from zero or infinity."""


def spread(values: FloatArray, least: float = ROUNDING) -> float:
    """Return the standard deviation, or `least` times the mean's size where the values hardly vary."""
    mean, deviation = moments(values)
    return max(deviation, least * abs(mean), SMALLEST)


def finite_spread(name: str, values: FloatArray) -> float:
    """Return the standard deviation; raises DataError when it is beyond the range of numbers."""
    its = spread(values)
    if not SMALLEST < its < 1.0 / SMALLEST:
        raise DataError(f"the values of '{name}' are too large or too small to compute with; choose another unit")
    return its
