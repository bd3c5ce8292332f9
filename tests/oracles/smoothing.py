"""Slow, obvious versions of the smoothing kernels, written from the definitions with numpy's linear algebra."""

from math import factorial

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]


def nearest_by_index(row: int, count: int, rows: int) -> list[int]:
    """Return `count` rows around `row`, as many on each side as the trajectory has, in ascending order."""
    first = min(max(row - count // 2, 0), rows - count)
    return list(range(first, first + count))


def stencil_derivative(times: FloatArray, values: FloatArray, row: int, count: int, order: int) -> tuple[float, float]:
    """Return the derivative at `row` of the polynomial through `count` rows, and the norm of its weights."""
    rows = nearest_by_index(row, count, len(times))
    unit = times[rows[-1]] - times[rows[0]]
    powers = np.vander((times[rows] - times[row]) / unit, increasing=True)
    weights = np.linalg.inv(powers)[order] * factorial(order) / unit**order
    return float(weights @ values[rows]), float(np.linalg.norm(weights))


def left_out_error(times: FloatArray, values: FloatArray, row: int, count: int) -> tuple[float, float]:
    """Return value minus prediction from the other rows of a stencil of `count`, and the gain of noise in it."""
    rows = [index for index in nearest_by_index(row, count, len(times)) if index != row]
    unit = times[rows[-1]] - times[rows[0]]
    powers = np.vander((times[rows] - times[row]) / unit, increasing=True)
    weights = np.linalg.inv(powers)[0]
    return float(values[row] - weights @ values[rows]), float(np.sqrt(1.0 + weights @ weights))


def loess(
    times: FloatArray,
    values: FloatArray,
    trust: FloatArray,
    row: int,
    span: int,
    degree: int,
    precision: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Return value, slope and curvature of a local polynomial, and their noise gains with the leverage."""
    window = min(span, len(times))
    rows = sorted(sorted(range(len(times)), key=lambda index: (abs(times[index] - times[row]), -index))[:window])
    bandwidth = max(abs(times[rows] - times[row])) * (1 + 1 / window) * max(1.0, span / window)
    offsets = (times[rows] - times[row]) / bandwidth
    roots = np.sqrt(trust[rows] * (1 - abs(offsets) ** 3) ** 3)
    powers = np.vander(offsets, degree + 1, increasing=True)
    influence = np.linalg.pinv(roots[:, None] * powers) * roots
    scales = np.array([factorial(order) / bandwidth**order for order in range(degree + 1)])
    influence = (influence.T * scales).T
    deviations = np.ones(len(rows)) if precision is None else 1.0 / np.sqrt(precision[rows])
    norms = np.linalg.norm(influence[:3] * deviations, axis=1)
    return influence[:3] @ values[rows], np.append(norms, influence[0, rows.index(row)])
