"""Least squares whose rows are weighted by what they leave, in a fixed order of sums.

Letters: K columns, N rows.
"""

import math

import numpy as np

from atoll_coordinator.model.sparse.kernels.least_squares import triangularize
from atoll_core.compilation.jit import allocating_kernel
from atoll_core.data.dataset import FloatArray

CAUCHY = 2.385
"""Residuals of this many standard errors get half the weight: 95 % efficient where errors are normal (Holland & Welsch
1977)."""
NORMAL_DEVIATION = 1.4826
"""A normal error's standard deviation over its median size."""
SETTLED = 1e-3
"""Weights have settled when the scale moves by less than this share."""


@allocating_kernel
def robust_fit(
    columns: FloatArray,
    side: FloatArray,
    errors: FloatArray,
    rounds: int,
    coefficients: FloatArray,
    weights: FloatArray,
) -> float:
    """Fit `side` (N,), with standard errors `errors` (N,), by all `columns` (K, N); return the scale of what is left.

    Squares are weighted by 1/(1 + (r/(c s))^2) with the residual r in standard errors and the scale s, a multiple of
    the median of |r| (Cauchy's distribution), again and again until s settles. `weights` (N,) are those to begin with,
    and take the last ones, as factors of rows; `coefficients` (K,) take the fit. With one round weights stay.
    """
    count, rows = columns.shape
    unit, upper, rotated = np.empty((count, rows)), np.zeros((count, count)), np.zeros(count)
    rest, sizes, left = np.empty(rows), np.empty(count), np.empty(rows)
    scale = math.inf
    for turn in range(rounds):
        for i in range(rows):
            rest[i] = side[i] * weights[i] / errors[i]
        for k in range(count):
            norm = 0.0
            for i in range(rows):
                unit[k, i] = columns[k, i] * weights[i] / errors[i]
                norm += unit[k, i] * unit[k, i]
            sizes[k] = math.sqrt(norm) if norm > 0.0 else 1.0
            for i in range(rows):
                unit[k, i] /= sizes[k]
        triangularize(unit, rest, upper, rotated)
        for k in range(count - 1, -1, -1):
            value = rotated[k]
            for j in range(k + 1, count):
                value -= upper[k, j] * coefficients[j] * sizes[j]
            coefficients[k] = value / upper[k, k] / sizes[k] if upper[k, k] > 0.0 else 0.0
        for i in range(rows):
            left[i] = side[i]
        for k in range(count):
            for i in range(rows):
                left[i] -= coefficients[k] * columns[k, i]
        for i in range(rows):
            left[i] = abs(left[i]) / errors[i]
        before = scale
        scale = NORMAL_DEVIATION * np.sort(left)[rows // 2]
        if turn + 1 == rounds or not scale > 0.0 or abs(before - scale) <= SETTLED * scale:
            break
        for i in range(rows):
            far = left[i] / (CAUCHY * scale)
            weights[i] = 1.0 / math.sqrt(1.0 + far * far)
    return scale
