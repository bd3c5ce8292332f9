"""Sums, means and neighbours of a few thousand numbers, added in a fixed order. Pure."""

import math
from collections.abc import Sequence

import numpy as np

from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray


def dot(one: FloatArray, other: FloatArray) -> float:
    """Return the sum of products."""
    return math.fsum((one * other).tolist())


def mean(values: FloatArray) -> float:
    """Return the mean, 0 of nothing."""
    return math.fsum(values.tolist()) / max(1, len(values))


def variance(values: FloatArray) -> float:
    """Return the mean square of the distances from the mean."""
    away = values - mean(values)
    return dot(away, away) / max(1, len(away))


def middle(values: FloatArray) -> float:
    """Return the upper median, 0 of nothing."""
    return float(np.sort(values)[len(values) // 2]) if len(values) else 0.0


def roughness(parts: Sequence[FloatArray]) -> float:
    """Return half of the mean square step from row to row over the variance (von Neumann 1941), NaN left out.

    It is 1 for white noise, and small for what is smooth: 1 - cos(2 pi / n) for a wave of n rows.
    """
    begin = [part[: SETTINGS.columns.most_rows] for part in parts]
    steps = np.concatenate([np.diff(part) for part in begin])
    values = np.concatenate(begin)
    steps, values = steps[np.isfinite(steps)], values[np.isfinite(values)]
    spread = variance(values)
    return 0.5 * dot(steps, steps) / (max(1, len(steps)) * spread) if spread > 0.0 else 0.0


def sign_changes(values: FloatArray) -> float:
    """Return the share of rows whose neighbour lies on the other side of the median: 1/2 for white noise.

    A few rows far out, as at the begin of a motion, decide a mean square, but not this.
    """
    above = values > middle(values)
    return int(np.count_nonzero(above[1:] != above[:-1])) / max(1, len(values) - 1)
