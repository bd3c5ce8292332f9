"""Rows that are near each other: the leaves of a k-d tree (Bentley 1975). Pure, and the same bits on every machine."""

import math

import numpy as np
import numpy.typing as npt

from atoll_core.data.dataset import FloatArray

Rows = npt.NDArray[np.intp]


def split_into_bins(positions: FloatArray, most: int) -> list[Rows]:
    """Return the rows of `positions` (V, N) in at most so many bins of nearly equal numbers of rows, a power of two.

    Bins are halved at the median of the variable along which they are widest, as a share of its whole range.
    """
    ranges = np.max(positions, axis=1) - np.min(positions, axis=1)
    bins: list[Rows] = [np.arange(positions.shape[1])]
    while 2 * len(bins) <= most and min(map(len, bins)) >= 2:
        bins = [half for rows in bins for half in _halves(positions, rows, ranges)]
    return bins


def _halves(positions: FloatArray, rows: Rows, ranges: FloatArray) -> tuple[Rows, Rows]:
    points = positions[:, rows]
    widths = np.max(points, axis=1) - np.min(points, axis=1)
    widest = int(np.argmax(np.divide(widths, ranges, out=np.zeros(len(ranges)), where=ranges > 0.0)))
    order = rows[np.argsort(points[widest], kind="stable")]
    return order[: len(order) // 2], order[len(order) // 2 :]


def total(values: FloatArray) -> float:
    """Return the sum, correctly rounded."""
    return math.fsum(values.tolist())
