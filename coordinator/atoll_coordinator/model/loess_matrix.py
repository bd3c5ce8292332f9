"""The matrix of loess for evenly spaced rows, and the share of a measurement error that remains in its residual. Pure.

Letters: n rows; S (n, n), the matrix that maps measured values to smoothed values.
"""

from functools import lru_cache
from typing import Final

import numpy as np

from atoll_core.data.dataset import FloatArray

_MOST_ROWS: Final = 240
"""Most rows of the computed matrix. More rows are not needed: all rows far from both ends have equal shares."""


@lru_cache(maxsize=64)
def residual_shares(rows: int, span: int, degree: int) -> FloatArray:
    """Return for each row (n,) the variance of its residual divided by the variance of its error; the ratio is at most
    1.

    This is the diagonal of (I - S)(I - S)'. At the ends, loess follows the errors of the rows, and the shares are
    small; with few rows this holds for all rows. If there are many rows, the share in the middle does not depend on
    their number.
    """
    degree = min(degree, rows - 2)
    if degree < 0:
        return np.ones(rows)
    taken = min(rows, max(_MOST_ROWS, 3 * span)) if span < rows else min(rows, _MOST_ROWS)
    window = max(round(span * taken / rows) if span >= rows else span, degree + 2)
    rest = np.eye(taken) - loess_matrix(taken, window, degree)
    shares = np.minimum((rest * rest).sum(axis=1), 1.0)
    half = taken // 2
    return np.concatenate([shares[:half], np.full(rows - taken, shares[half]), shares[half:]])


def loess_matrix(rows: int, span: int, degree: int) -> FloatArray:
    """Return S (n, n) for evenly spaced rows: tricube weights over the nearest rows (Cleveland 1979)."""
    window = min(span, rows)
    places = np.arange(rows)
    starts = np.clip(places - window // 2, 0, rows - window)
    columns = starts[:, None] + np.arange(window)
    offsets = (columns - places[:, None]).astype(np.float64)
    reach = np.abs(offsets).max(axis=1, keepdims=True) * (1.0 + 1.0 / window) * max(1.0, span / window)
    offsets /= reach
    roots = np.sqrt((1.0 - np.abs(offsets) ** 3) ** 3)
    orthogonal, triangle = np.linalg.qr(roots[:, :, None] * offsets[:, :, None] ** np.arange(degree + 1))
    first = np.zeros((rows, degree + 1, 1))
    first[:, 0] = 1.0
    at_zero = np.linalg.solve(np.swapaxes(triangle, 1, 2), first)
    matrix = np.zeros((rows, rows))
    np.put_along_axis(matrix, columns, roots * (orthogonal @ at_zero)[:, :, 0], axis=1)
    return matrix
