"""Compiled numerics of loess along one trajectory, and of averaging its rows in bins.

The results are input of the search and must have the same bits on every machine. So all sums are loops in a fixed
order, without library reductions. Letters: R rows of one trajectory, B bins, K rows of a loess window, D degrees. Times
(R,) ascend strictly. `row_weights` (R,) are the weights of the rows, 0 or more. Oracles written from the definitions
are in ``tests/oracles/smoothing.py``.
"""

import numpy as np

from atoll_core.compilation.jit import allocating_kernel, inlined, kernel
from atoll_core.data.dataset import FloatArray

DEGREES = 5
"""Loess fits degrees 0 to 4 in one pass."""

RANGE = 2**32
SPREADING = 2654435769
"""The golden section of `RANGE`. Its multiples modulo `RANGE` are spread evenly (Knuth 1973, section 6.4), so that the
selected rows cover all phases of any oscillation."""

RANK = 1e-13
"""Smallest norm of an orthogonal polynomial, relative to the norm of the constant polynomial. Below it, the rows of a
window do not determine this degree."""


@inlined
def window_start(start: int, row: int, span: int, times: FloatArray) -> int:
    """Move `start` right until rows [start, start + span) are the ones nearest in time to `row`."""
    while start + span < len(times) and times[start + span] - times[row] < times[row] - times[start]:
        start += 1
    return start


@inlined
def widen_window(
    row: int, start: int, window: int, times: FloatArray, row_weights: FloatArray, fewest: int
) -> tuple[int, int]:
    """Return start and length of a window that has at least `fewest` rows with positive weight, if there are so many.

    The window grows by the row that is nearest in time, at most to the whole trajectory.
    """
    stop = start + window
    count = 0
    for j in range(start, stop):
        if row_weights[j] > 0.0:
            count += 1
    while count < fewest and stop - start < len(times):
        to_left = stop == len(times) or (start > 0 and times[row] - times[start - 1] <= times[stop] - times[row])
        if to_left:
            start -= 1
        else:
            stop += 1
        if row_weights[start if to_left else stop - 1] > 0.0:
            count += 1
    return start, stop - start


@inlined
def weigh_window(
    offsets: FloatArray,
    weights: FloatArray,
    row: int,
    start: int,
    window: int,
    span: int,
    times: FloatArray,
    row_weights: FloatArray,
) -> float:
    """Write `offsets` (in bandwidths) and `weights` of rows [start, start + window); return the bandwidth.

    A weight is the tricube function (Cleveland 1979, eq. 2.1) times the row weight. If no row of the window has a
    positive row weight, all row weights are taken as 1. The bandwidth is larger than the distance of the farthest row
    by half a row, so that each row has a positive weight. If the span exceeds the trajectory, the bandwidth grows in
    proportion.
    """
    reach = max(times[row] - times[start], times[start + window - 1] - times[row])
    bandwidth = reach * (1.0 + 1.0 / window) * max(1.0, span / window)
    total = 0.0
    for j in range(window):
        total += row_weights[start + j]
    for j in range(window):
        offset = (times[start + j] - times[row]) / bandwidth
        distance = abs(offset)
        rest = 1.0 - distance * distance * distance
        offsets[j] = offset
        weights[j] = rest * rest * rest * (row_weights[start + j] if total > 0.0 else 1.0)
    return float(bandwidth)


@inlined
def next_polynomial(
    at_zero: FloatArray, current: FloatArray, last: FloatArray, offsets: FloatArray, alpha: float, beta: float
) -> None:
    """Advance the discrete orthogonal polynomials by one degree (Forsythe 1957): p' = (u - alpha) p - beta p_last.

    `at_zero` (2, 3) holds value, slope and curvature at 0 of the current and the previous polynomial. `current` and
    `last` (K,) hold their values at the `offsets` (K,). All three are updated in place.
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
def validate_into(
    sums: FloatArray, times: FloatArray, values: FloatArray, row_weights: FloatArray, span: int, every: int
) -> None:
    """Add the sums for cross-validation to `sums` (3, D), for loess of degrees 0 to 4 at one of `every` rows.

    sums[0] are the squared residuals, sums[1] the leverages, both weighted by the row weights; sums[2] are these row
    weights. `span` is the number of nearest rows in a window. A window is widened if too few of its rows have a
    positive weight. If a window has fewer than degree + 2 rows, both sums of this degree become infinity.
    """
    rows = len(times)
    narrow = min(span, rows)
    offsets, weights = np.empty(rows), np.empty(rows)
    current, last = np.empty(rows), np.empty(rows)
    at_zero = np.empty((2, 3))
    left = 0
    for row in range(rows):
        if row_weights[row] <= 0.0 or (row * SPREADING) % RANGE >= RANGE // every:
            continue
        left = window_start(left, row, narrow, times)
        start, window = widen_window(row, left, narrow, times, row_weights, min(narrow, sums.shape[1] + 1))
        weigh_window(offsets, weights, row, start, window, span, times, row_weights)
        at_zero[:] = 0.0
        at_zero[0, 0] = 1.0
        current[:window] = 1.0
        last[:window] = 0.0
        fit, leverage, first, norm_before = 0.0, 0.0, 0.0, 1.0
        for degree in range(sums.shape[1]):
            norm, moment, product = 0.0, 0.0, 0.0
            for j in range(window):
                weighted = weights[j] * current[j]
                norm += weighted * current[j]
                moment += weighted * current[j] * offsets[j]
                product += weighted * (values[start + j] - values[row])
            if narrow < degree + 2:
                sums[:2, degree] = np.inf
                continue
            if degree == 0:
                first = norm
            if norm > RANK * first:
                fit += product / norm * at_zero[0, 0]
                leverage += at_zero[0, 0] * at_zero[0, 0] / norm
                beta = norm / norm_before if degree > 0 else 0.0
                next_polynomial(at_zero, current, last, offsets[:window], moment / norm, beta)
                norm_before = norm
            sums[0, degree] += row_weights[row] * (fit * fit)
            sums[1, degree] += row_weights[row] * (leverage * row_weights[row])
            sums[2, degree] += row_weights[row]


@allocating_kernel
def loess_into(
    fits: FloatArray,
    gains: FloatArray,
    times: FloatArray,
    values: FloatArray,
    row_weights: FloatArray,
    inverse_variance: FloatArray,
    span: int,
    degrees: int,
) -> None:
    """Write the value, slope and curvature of loess over the `span` nearest rows into `fits` (3, R).

    `inverse_variance` (R,), positive, is the inverse variance of each row's error, up to a common factor. The first
    three rows of `gains` (4, R) are the noise gains of value, slope and curvature: the square root of the sum of
    squared weights of the values, each divided by the inverse variance. The last row is the leverage, the weight of a
    row's own value in its fit. `degrees` is the number of degrees used; 3 is a parabola. A window is widened if too few
    of its rows have a positive weight.
    """
    rows = len(times)
    offsets, weights = np.empty(rows), np.empty(rows)
    current, last = np.empty(rows), np.empty(rows)
    influence = np.empty((3, rows))
    at_zero = np.empty((2, 3))
    left = 0
    narrow = min(span, rows)
    for row in range(rows):
        left = window_start(left, row, narrow, times)
        start, window = widen_window(row, left, narrow, times, row_weights, min(narrow, degrees + 1))
        bandwidth = weigh_window(offsets, weights, row, start, window, span, times, row_weights)
        at_zero[:] = 0.0
        at_zero[0, 0] = 1.0
        current[:window] = 1.0
        last[:window] = 0.0
        influence[:, :window] = 0.0
        first, norm_before = 0.0, 1.0
        for degree in range(degrees):
            norm, moment = 0.0, 0.0
            for j in range(window):
                weighted = weights[j] * current[j]
                norm += weighted * current[j]
                moment += weighted * current[j] * offsets[j]
            if degree == 0:
                first = norm
            if not norm > RANK * first:
                break
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
                gain += influence[derivative, j] * influence[derivative, j] / inverse_variance[start + j]
            fits[derivative, row] = total * unit + (values[row] if derivative == 0 else 0.0)
            gains[derivative, row] = np.sqrt(gain) * unit
            unit /= bandwidth


@kernel
def thin_into(
    bin_times: FloatArray,
    bin_values: FloatArray,
    bin_weights: FloatArray,
    times: FloatArray,
    values: FloatArray,
    row_weights: FloatArray,
) -> None:
    """Write the mean time, value and weight of each bin (B,); the bins are B equal parts of the rows.

    The means of times and values are weighted by the row weights. If all row weights of a bin are 0, they are
    unweighted.
    """
    rows, bins = len(times), len(bin_times)
    for index in range(bins):
        first, last = index * rows // bins, (index + 1) * rows // bins
        total = 0.0
        for row in range(first, last):
            total += row_weights[row]
        time, value, whole = 0.0, 0.0, 0.0
        for row in range(first, last):
            weight = row_weights[row] if total > 0.0 else 1.0
            time += weight * (times[row] - times[first])
            value += weight * (values[row] - values[first])
            whole += weight
        bin_times[index] = times[first] + time / whole
        bin_values[index] = values[first] + value / whole
        bin_weights[index] = total / (last - first)


@kernel
def spread_into(
    fits: FloatArray,
    gains: FloatArray,
    times: FloatArray,
    bin_times: FloatArray,
    bin_fits: FloatArray,
    bin_gains: FloatArray,
) -> None:
    """Interpolate fits (3, B) and gains (4, B) of bins to `fits` (3, R) and `gains` (4, R) at `times` (R,).

    Each row blends the parabolas of the two bins around it, linearly in time.
    """
    bins = len(bin_times)
    rows_of_bin = len(times) / bins
    left = 0
    for row in range(len(times)):
        while left + 2 < bins and bin_times[left + 1] <= times[row]:
            left += 1
        share = (times[row] - bin_times[left]) / (bin_times[left + 1] - bin_times[left])
        share = min(max(share, 0.0), 1.0)
        fits[:, row] = 0.0
        gains[:, row] = 0.0
        for side in range(2):
            index = left + side
            weight = share if side == 1 else 1.0 - share
            away = times[row] - bin_times[index]
            value, slope, curvature = bin_fits[0, index], bin_fits[1, index], bin_fits[2, index]
            fits[0, row] += weight * (value + away * (slope + 0.5 * away * curvature))
            fits[1, row] += weight * (slope + away * curvature)
            fits[2, row] += weight * curvature
            for derivative in range(3):
                gains[derivative, row] += weight * bin_gains[derivative, index] / np.sqrt(rows_of_bin)
            gains[3, row] += weight * bin_gains[3, index] / rows_of_bin
