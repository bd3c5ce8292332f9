"""Compiled numerics of differentiating one trajectory by local interpolation.

The results are input of the search and must have the same bits on every machine. So all sums are loops in a fixed
order, without library reductions. Letters: R rows of one trajectory, H half widths of a stencil. Times (R,) ascend
strictly. Oracles written from the definitions are in ``tests/oracles/smoothing.py``.
"""

import numpy as np

from atoll_core.compilation.jit import allocating_kernel, inlined
from atoll_core.data.dataset import FloatArray

HALF_WIDTHS = 7
"""Largest half width of an interpolation stencil: 15 rows, error of order step**14."""


@inlined
def add_node(weights: FloatArray, nodes: FloatArray, count: int, scale: float) -> float:
    """Extend the weights of an interpolating polynomial at 0 from `count` nodes to `count` + 1 nodes.

    The equations for nested node sets are from Fornberg 1988 (Mathematics of Computation 51). ``weights[k, j]`` is the
    weight of node j in the k-th derivative at 0, k = 0, 1, 2. `scale` is the product of differences that the previous
    call returned, 1.0 in the first call. Returns the product for the next call.
    """
    if count == 0:
        weights[0, 0] = 1.0
        weights[1, 0] = 0.0
        weights[2, 0] = 0.0
        return 1.0
    new = nodes[count]
    last = nodes[count - 1]
    product = 1.0
    for j in range(count):
        product *= new - nodes[j]
    ratio = scale / product
    weights[2, count] = ratio * (2.0 * weights[1, count - 1] - last * weights[2, count - 1])
    weights[1, count] = ratio * (weights[0, count - 1] - last * weights[1, count - 1])
    weights[0, count] = -ratio * last * weights[0, count - 1]
    for j in range(count):
        gap = new - nodes[j]
        weights[2, j] = (new * weights[2, j] - 2.0 * weights[1, j]) / gap
        weights[1, j] = (new * weights[1, j] - weights[0, j]) / gap
        weights[0, j] = new * weights[0, j] / gap
    return product


@inlined
def stencil_row(row: int, place: int, rows: int) -> int:
    """Return the `place`-th nearest row to `row` by index: row, row+1, row-1, row+2, …; -1 if there is no such row.

    Near an end of the trajectory, rows that are missing on one side are replaced by further rows on the other side.
    """
    left = row
    right = rows - 1 - row
    if place == 0:
        return row
    reach = (place + 1) // 2
    if reach <= left and reach <= right:
        return row + reach if place % 2 == 1 else row - reach
    both = min(left, right)
    beyond = place - both
    if left < right:
        return row + beyond if row + beyond < rows else -1
    return row - beyond if row - beyond >= 0 else -1


@allocating_kernel
def differences_into(
    slopes: FloatArray, gains: FloatArray, times: FloatArray, values: FloatArray, derivative: int
) -> None:
    """Write derivative 1 or 2 by stencils of 3, 5, … rows into `slopes` (R, H), their noise gains into `gains` (R, H).

    The noise gain is the square root of the sum of squared weights. If a trajectory has fewer rows than a stencil, its
    slope and gain are NaN.
    """
    rows = len(times)
    nodes = np.empty(2 * HALF_WIDTHS + 1)
    weights = np.empty((3, 2 * HALF_WIDTHS + 1))
    for row in range(rows):
        step = times[row] - times[row - 1] if row > 0 else times[1] - times[0]
        unit = 1.0 / step if derivative == 1 else 1.0 / (step * step)
        scale = 1.0
        for place in range(2 * HALF_WIDTHS + 1):
            if place >= rows:
                if place % 2 == 0:
                    slopes[row, place // 2 - 1] = np.nan
                    gains[row, place // 2 - 1] = np.nan
                continue
            nodes[place] = (times[stencil_row(row, place, rows)] - times[row]) / step
            scale = add_node(weights, nodes, place, scale)
            if place % 2 == 0 and place > 0:
                total = 0.0
                gain = 0.0
                for j in range(place + 1):
                    total += weights[derivative, j] * (values[stencil_row(row, j, rows)] - values[row])
                    gain += weights[derivative, j] * weights[derivative, j]
                slopes[row, place // 2 - 1] = total * unit
                gains[row, place // 2 - 1] = np.sqrt(gain) * unit


@allocating_kernel
def left_out_into(errors: FloatArray, gains: FloatArray, times: FloatArray, values: FloatArray) -> None:
    """Write each value minus its interpolation from 2, 4, … neighbours into `errors` (R, H), its gain into `gains`.

    The gain (R, H) is the standard deviation of this error if every value has independent noise of standard deviation
    one.
    """
    rows = len(times)
    nodes = np.empty(2 * HALF_WIDTHS)
    weights = np.empty((3, 2 * HALF_WIDTHS))
    for row in range(rows):
        step = times[row] - times[row - 1] if row > 0 else times[1] - times[0]
        scale = 1.0
        for place in range(2 * HALF_WIDTHS):
            if place + 1 >= rows:
                if place % 2 == 1:
                    errors[row, place // 2] = np.nan
                    gains[row, place // 2] = np.nan
                continue
            nodes[place] = (times[stencil_row(row, place + 1, rows)] - times[row]) / step
            scale = add_node(weights, nodes, place, scale)
            if place % 2 == 1:
                total = 0.0
                gain = 1.0
                for j in range(place + 1):
                    total += weights[0, j] * (values[stencil_row(row, j + 1, rows)] - values[row])
                    gain += weights[0, j] * weights[0, j]
                errors[row, place // 2] = -total
                gains[row, place // 2] = np.sqrt(gain)


@allocating_kernel
def best_stencil_into(
    slope: FloatArray, uncertainty: FloatArray, slopes: FloatArray, gains: FloatArray, noise: FloatArray
) -> None:
    """Choose for each row the stencil with the smallest uncertainty; write its `slope` and `uncertainty` (R,).

    The uncertainty of a stencil is the difference of its slope from the slope of the next narrower stencil, plus the
    `noise` (R,) of the values times the stencil's gain. The difference is the largest one within two rows, because at a
    single row two slopes can agree by chance.
    """
    rows, widths = slopes.shape
    for row in range(rows):
        slope[row] = slopes[row, 0]
        uncertainty[row] = np.inf
        for width in range(1, widths):
            change = 0.0
            for near in range(max(row - 2, 0), min(row + 3, rows)):
                step = abs(slopes[near, width] - slopes[near, width - 1])
                if not step <= change:
                    change = step
            estimate = change + noise[row] * gains[row, width]
            if estimate < uncertainty[row]:
                uncertainty[row] = estimate
                slope[row] = slopes[row, width]


@allocating_kernel
def moments(values: FloatArray) -> tuple[float, float]:
    """Return mean and population standard deviation of finite `values`, summed in their order in two passes."""
    total = 0.0
    for value in values:
        total += value
    mean = total / len(values)
    squares = 0.0
    for value in values:
        squares += (value - mean) * (value - mean)
    return mean, np.sqrt(squares / len(values))
