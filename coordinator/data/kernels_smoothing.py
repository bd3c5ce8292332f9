"""Compiled numerics of smoothing and differentiating one trajectory: local interpolation and loess.

Everything here feeds the search and must give the same bits everywhere: plain loops in a fixed order, no library
reductions. Letters: R rows of one trajectory, H half widths of a stencil, K rows of a loess window, D degrees. Times
ascend strictly. Oracles written from the definitions stand in ``tests/oracles/smoothing.py``.
"""

import numpy as np

from common.dataset import FloatArray
from common.jit import allocating_kernel, inlined

HALF_WIDTHS = 7
"""Largest half width of an interpolation stencil: 15 rows, error of order step**14."""

DEGREES = 5
"""Loess fits degrees 0 to 4 in one pass."""


@inlined
def add_node(weights: FloatArray, nodes: FloatArray, count: int, scale: float) -> float:
    """Extend the weights of an interpolating polynomial at 0 from `count` nodes to one more.

    Fornberg 1988 (Mathematics of Computation 51), equations for nested node sets: ``weights[k, j]`` is the weight of
    node j in the k-th derivative at 0, k = 0, 1, 2. `scale` is the product of differences that the last call returned
    (1.0 before the first); returns the one for the next call.
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
    """Return the `place`-th nearest row to `row` by index: row, row+1, row-1, row+2, …; -1 when outside of [0, rows).

    At an end of the trajectory the missing side is filled up from the other one.
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
    """Fill `slopes` (R, H) with derivative 1 or 2 by stencils of 3, 5, … rows, `gains` (R, H) with their noise gain.

    The gain is the root of the sum of squared weights. Where a trajectory has fewer rows than the stencil needs, both
    are NaN.
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
    """Fill `errors` (R, H) with value minus its prediction from 2, 4, … neighbours, `gains` (R, H) with their gain.

    The gain is the standard deviation of the error when every value has independent noise of deviation one.
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
    """Choose the stencil of each row: the one whose step from the next narrower one is smallest.

    The uncertainty of a row is that step (the largest within two rows, lest a chance crossing look like accuracy) plus
    the noise (R,) of the values times the stencil's gain.
    """
    rows, widths = slopes.shape
    for row in range(rows):
        slope[row] = slopes[row, 0]
        uncertainty[row] = np.inf
        for width in range(1, widths):
            change = 0.0
            for near in range(max(row - 2, 0), min(row + 3, rows)):
                each = abs(slopes[near, width] - slopes[near, width - 1])
                if not each <= change:
                    change = each
            estimate = change + noise[row] * gains[row, width]
            if estimate < uncertainty[row]:
                uncertainty[row] = estimate
                slope[row] = slopes[row, width]


@inlined
def window_start(start: int, row: int, span: int, times: FloatArray) -> int:
    """Move `start` right until rows [start, start + span) are the ones nearest in time to `row`."""
    while start + span < len(times) and times[start + span] - times[row] < times[row] - times[start]:
        start += 1
    return start


@inlined
def weigh_window(offsets: FloatArray, weights: FloatArray, row: int, start: int, span: int, times: FloatArray) -> float:
    """Fill offsets (in bandwidths) and tricube weights of rows [start, start + window); return the bandwidth.

    Cleveland 1979, eq. 2.1; the bandwidth lies half a row beyond the farthest one so that each row counts, and grows
    in proportion where the span exceeds the trajectory.
    """
    window = min(span, len(times))
    reach = max(times[row] - times[start], times[start + window - 1] - times[row])
    bandwidth = reach * (1.0 + 1.0 / window) * max(1.0, span / window)
    for j in range(window):
        offset = (times[start + j] - times[row]) / bandwidth
        distance = abs(offset)
        rest = 1.0 - distance * distance * distance
        offsets[j] = offset
        weights[j] = rest * rest * rest
    return float(bandwidth)


@inlined
def next_polynomial(
    at_zero: FloatArray, current: FloatArray, last: FloatArray, offsets: FloatArray, alpha: float, beta: float
) -> None:
    """Advance the discrete orthogonal polynomials by one degree (Forsythe 1957): p' = (u - alpha) p - beta p_last.

    `at_zero` (2, 3) holds value, slope and curvature at 0 of the current and the last polynomial; `current` and `last`
    their values at the offsets. All are updated in place.
    """
    for j in range(len(offsets)):
        new = (offsets[j] - alpha) * current[j] - beta * last[j]
        last[j] = current[j]
        current[j] = new
    for derivative in range(2, -1, -1):
        new = -alpha * at_zero[0, derivative] - beta * at_zero[1, derivative]
        if derivative > 0:
            new += derivative * at_zero[0, derivative - 1]
        at_zero[1, derivative] = at_zero[0, derivative]
        at_zero[0, derivative] = new


@allocating_kernel
def validate_into(sums: FloatArray, times: FloatArray, values: FloatArray, span: int, every: int) -> None:
    """Add to `sums` (3, D), for loess of degrees 0 to 4 at every `every`-th row, what cross-validation needs.

    Row 0 sums squared residuals, row 1 leverages, row 2 squared leave-one-out residuals. `span` is the number of
    nearest rows. A degree that a window cannot bear adds infinity.
    """
    rows = len(times)
    window = min(span, rows)
    offsets, weights = np.empty(window), np.empty(window)
    current, last = np.empty(window), np.empty(window)
    at_zero = np.empty((2, 3))
    start = 0
    for row in range(0, rows, every):
        start = window_start(start, row, window, times)
        weigh_window(offsets, weights, row, start, span, times)
        at_zero[:] = 0.0
        at_zero[0, 0] = 1.0
        current[:] = 1.0
        last[:] = 0.0
        fit, leverage, norm_before = 0.0, 0.0, 1.0
        for degree in range(sums.shape[1]):
            norm, moment, product = 0.0, 0.0, 0.0
            for j in range(window):
                weighted = weights[j] * current[j]
                norm += weighted * current[j]
                moment += weighted * current[j] * offsets[j]
                product += weighted * (values[start + j] - values[row])
            if window < degree + 2 or not norm > 0.0:
                sums[:, degree] = np.inf
                continue
            fit += product / norm * at_zero[0, 0]
            leverage += at_zero[0, 0] * at_zero[0, 0] / norm
            sums[0, degree] += fit * fit
            sums[1, degree] += leverage
            left_out = fit / (1.0 - leverage)
            sums[2, degree] += left_out * left_out
            beta = norm / norm_before if degree > 0 else 0.0
            next_polynomial(at_zero, current, last, offsets, moment / norm, beta)
            norm_before = norm


@allocating_kernel
def loess_into(
    fits: FloatArray, gains: FloatArray, times: FloatArray, values: FloatArray, span: int, degrees: int
) -> None:
    """Fill `fits` (3, R) with the value, slope and curvature of loess over the `span` nearest rows.

    `gains` (4, R) receives their noise gains, the roots of the sums of squared weights with which the values enter, and
    the leverage, the weight of a row's own value in its fit. `degrees` counts the degrees used: 3 is a parabola.
    """
    rows = len(times)
    offsets, weights = np.empty(rows), np.empty(rows)
    current, last = np.empty(rows), np.empty(rows)
    influence = np.empty((3, rows))
    at_zero = np.empty((2, 3))
    start = 0
    window = min(span, rows)
    for row in range(rows):
        start = window_start(start, row, window, times)
        bandwidth = weigh_window(offsets, weights, row, start, span, times)
        at_zero[:] = 0.0
        at_zero[0, 0] = 1.0
        current[:window] = 1.0
        last[:window] = 0.0
        influence[:, :window] = 0.0
        norm_before = 1.0
        for degree in range(degrees):
            norm, moment = 0.0, 0.0
            for j in range(window):
                weighted = weights[j] * current[j]
                norm += weighted * current[j]
                moment += weighted * current[j] * offsets[j]
            for derivative in range(3):
                share = at_zero[0, derivative] / norm
                for j in range(window):
                    influence[derivative, j] += share * weights[j] * current[j]
            beta = norm / norm_before if degree > 0 else 0.0
            next_polynomial(at_zero, current, last, offsets[:window], moment / norm, beta)
            norm_before = norm
        gains[3, row] = influence[0, row - start]
        unit = 1.0
        for derivative in range(3):
            total, gain = 0.0, 0.0
            for j in range(window):
                total += influence[derivative, j] * (values[start + j] - values[row])
                gain += influence[derivative, j] * influence[derivative, j]
            fits[derivative, row] = total * unit + (values[row] if derivative == 0 else 0.0)
            gains[derivative, row] = np.sqrt(gain) * unit
            unit /= bandwidth


@allocating_kernel
def moments(values: FloatArray) -> tuple[float, float]:
    """Return mean and standard deviation (population) of finite values, summed in order, in two passes."""
    total = 0.0
    for value in values:
        total += value
    mean = total / len(values)
    squares = 0.0
    for value in values:
        squares += (value - mean) * (value - mean)
    return mean, np.sqrt(squares / len(values))
