"""Numbers as ``result.json`` holds them: finite or null, curves thinned and rounded. Pure."""

import math
from typing import Final

from atoll_core.data.dataset import FloatArray

CURVE_DIGITS: Final = 7
"""Significant digits of curves, which are looked at; there are many of their numbers."""


def finite(value: float | None) -> float | None:
    """Return `value` as JSON can hold it: None when it is not finite."""
    return float(value) if value is not None and math.isfinite(value) else None


def thinned(rows: int, most: int) -> list[int]:
    """Return at most `most` (2 or more) of so many row numbers, spread evenly, the first and the last among them."""
    if rows <= most:
        return [*range(rows)]
    return [(index * (rows - 1)) // (most - 1) for index in range(most)]


def curve(values: FloatArray, digits: int = CURVE_DIGITS) -> tuple[float | None, ...]:
    """Return `values` (R,) rounded to so many significant digits, None for those that are not finite."""
    return tuple(finite(float(f"{value:.{digits}g}")) for value in values.tolist())
