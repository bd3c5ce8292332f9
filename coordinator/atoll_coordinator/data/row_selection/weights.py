"""Weights of rows, as a column gives them: inverse variances of the measurement errors, up to a factor. Pure."""

import math

import numpy as np

from atoll_coordinator.data.differentiation.kernels.stencils import moments
from atoll_coordinator.data.differentiation.standard_deviation import ROUNDING
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray

LIMITS = SETTINGS.rows


def normalize_weights(weights: FloatArray | None) -> FloatArray | None:
    """Return positive weights over their mean; None when there are none, or all are equal."""
    if weights is None:
        return None
    scaled = weights / float(np.max(weights))
    mean, deviation = moments(scaled)
    return None if deviation <= ROUNDING * mean else np.ascontiguousarray(scaled / mean)


def select_weighty_rows(weights: FloatArray | None, rows: list[int]) -> list[int]:
    """Return those of `rows` whose weight is not far below the median one, most of them in any case.

    The search counts all rows alike (ADR 0027), so that rows of a far larger error are left out of it.
    """
    if weights is None:
        return rows
    ordered = np.sort(weights[rows]).tolist()
    least = ordered[len(rows) - max(1, math.ceil(LIMITS.least_kept * len(rows)))]
    limit = min(ordered[len(rows) // 2] / LIMITS.over_median_uncertainty**2, least)
    return [row for row in rows if weights[row] >= limit]
