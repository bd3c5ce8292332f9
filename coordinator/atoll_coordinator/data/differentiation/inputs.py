"""Inputs between the rows at which they were measured: cubics, given by slopes at the rows. Pure.

Not for the search, which sees inputs at rows only: models are simulated with them. Most data have none, and
need not wait for the library.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from atoll_core.data.dataset import FloatArray


def estimate_input_slopes(times: Sequence[FloatArray], values: Sequence[FloatArray]) -> list[FloatArray]:
    """Return slopes of one input along each trajectory.

    The input is taken as smooth, with continuous second derivatives (de Boor 1978, chapter IV), or as shape-preserving,
    so that nothing overshoots where it is switched (Fritsch & Butland 1984): whichever predicts rows that are left out
    better. A linear input has its own slope, but for rounding.

    Args:
        times: of each trajectory, ascending strictly, 5 rows or more.
        values: of the input at these times, finite.
    """
    from scipy.interpolate import CubicSpline, PchipInterpolator

    _, exponent = math.frexp(max(float(np.max(np.abs(part))) for part in values))
    samples = [(part_times, np.ldexp(part, -exponent)) for part_times, part in zip(times, values, strict=True)]
    best = min((CubicSpline, PchipInterpolator), key=lambda kind: _left_out_error(kind, samples))
    with np.errstate(over="ignore", under="ignore"):
        return [np.ldexp(best(*sample)(sample[0], 1), exponent) for sample in samples]


def _left_out_error(
    kind: Callable[[FloatArray, FloatArray], Any], samples: Sequence[tuple[FloatArray, FloatArray]]
) -> float:
    """Return the sum of absolute errors at inner rows when every other row is left out, first the odd then the even."""
    from scipy.interpolate import CubicHermiteSpline

    total = 0.0
    for times, values in samples:
        for first in (0, 1):
            kept = slice(first, None, 2)
            left_out = slice(first + 1, len(times) - 1, 2)
            slopes = kind(times[kept], values[kept])(times[kept], 1)
            curve = CubicHermiteSpline(times[kept], values[kept], slopes)
            total += float(np.sum(np.abs(curve(times[left_out]) - values[left_out])))
    return total
