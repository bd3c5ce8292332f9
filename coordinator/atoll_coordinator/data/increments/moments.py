"""Mean and products of steps in bins of neighbouring rows, and what they say of errors of measurement. Pure.

The increments r of a process, less its drift, are independent from step to step; errors e of measurement are not: a
step that ends too high begins the next one too high, so that E r_k r_k+1 = - var e (Roll 1984). Letters: S states, N
steps, M bins.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from atoll_coordinator.data.increments.bins import Rows, split_into_bins, total
from atoll_coordinator.data.increments.correlations import Pair, correlated_pairs
from atoll_coordinator.data.increments.steps import Steps
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray

_DEPENDENT = 1e-9
"""Guard: a pivot that is smaller than this share of its diagonal is rounding."""


@dataclass(frozen=True, eq=False)
class BinnedMoments:
    """Moments of steps over their length, in bins.

    `points` (V, M) are the means of where steps begin, `drift` (S, M) those of increments over their time, `products`
    has for each pair of states the mean products of what that leaves of increments, over the time (M,); `errors` (one
    for each of `drift`, then for each of `products`) their mean standard errors. `noise` (S,) is the variance of errors
    of measurement, 0 where none is seen.
    """

    points: FloatArray
    drift: FloatArray
    products: dict[Pair, FloatArray]
    errors: list[float]
    noise: FloatArray


def bin_moments(steps: Steps) -> BinnedMoments:
    """Return the moments of the steps; their positions are those of the step before where there is noise.

    Where a position has errors of its own, they are errors of the increment as well, with the other sign.
    """
    bins, drift, residuals, factors = _drift(steps)
    noise = measurement_noise(residuals, steps)
    is_noisy = bool((noise > 0.0).any())
    if is_noisy:
        steps = lagged(steps)
        bins, drift, residuals, factors = _drift(steps)
        noise = np.where(noise > 0.0, np.maximum(measurement_noise(residuals, steps), noise), 0.0)
    pairs = [(i, i) for i in range(len(drift))] + correlated_pairs(steps, bins)
    squares = {pair: products(residuals, steps, pair, corrected=is_noisy) for pair in pairs}
    points = np.array([[total(positions[rows]) / len(rows) for rows in bins] for positions in steps.points])
    times = [total(steps.lengths[rows]) for rows in bins]
    means = {
        pair: np.array([total(its[rows]) / t * factor for rows, t, factor in zip(bins, times, factors, strict=True)])
        for pair, its in squares.items()
    }
    errors = [_mean_error(values, steps.lengths, bins) for values in (*residuals, *squares.values())]
    return BinnedMoments(points, drift, means, errors, noise)


def _drift(steps: Steps) -> tuple[list[Rows], FloatArray, FloatArray, list[float]]:
    """Return bins, drifts in the middle of each (S, M), and what lines through them leave of the increments (S, N).

    There are at most twice the root of the rows as many bins, and rows to judge the lines in each by. In each bin the
    drift is a linear function of where steps begin. The last are for each bin the factors by which products of what is
    left are larger than they seem, for what is fitted.
    """
    rows_in_all, variables = len(steps.lengths), len(steps.points)
    most = max(min(2 * math.isqrt(rows_in_all), rows_in_all // (2 * (variables + 1))), 1)
    bins = split_into_bins(steps.points, most)
    drift = np.zeros((len(steps.increments), len(bins)))
    residuals = steps.increments.copy()
    factors = []
    for number, rows in enumerate(bins):
        design = _design(steps, rows)
        sides = [[total(column * increments[rows]) for increments in steps.increments] for column in design]
        normal = [[total(one * other) for other in design] for one in design]
        solved, rank = _solved(normal, sides)
        for state in range(len(drift)):
            drift[state, number] = solved[0][state]
            for column, coefficients in zip(design, solved, strict=True):
                residuals[state, rows] -= coefficients[state] * column
        factors.append(len(rows) / (len(rows) - rank) if len(rows) > rank else 1.0)
    return bins, drift, residuals, factors


def _design(steps: Steps, rows: Rows) -> list[FloatArray]:
    """Return what multiplies each coefficient: the length of a step, and that times where it begins, from -1 to 1."""
    columns = [steps.lengths[rows]]
    for positions in steps.points:
        middle = total(positions[rows]) / len(rows)
        away = positions[rows] - middle
        widest = float(np.max(np.abs(away)))
        columns.append(away / widest * steps.lengths[rows] if widest > 0.0 else np.zeros(len(rows)))
    return columns


def _solved(normal: list[list[float]], sides: list[list[float]]) -> tuple[list[list[float]], int]:
    """Return the solutions X (K, S) of normal X = sides, and the rank; unknowns that are not determined are 0.

    Elimination without exchange of rows, which a positive matrix does not need.
    """
    size = len(normal)
    matrix = [[*row, *side] for row, side in zip(normal, sides, strict=True)]
    is_determined = []
    for k in range(size):
        is_determined.append(matrix[k][k] > _DEPENDENT * normal[k][k])
        for i in range(k + 1, size):
            factor = matrix[i][k] / matrix[k][k] if is_determined[k] else 0.0
            matrix[i] = [entry - factor * pivot for entry, pivot in zip(matrix[i], matrix[k], strict=True)]
    solution = [[0.0] * len(sides[0]) for _ in range(size)]
    for k in range(size - 1, -1, -1):
        if is_determined[k]:
            for state in range(len(sides[0])):
                rest = math.fsum(matrix[k][i] * solution[i][state] for i in range(k + 1, size))
                solution[k][state] = (matrix[k][size + state] - rest) / matrix[k][k]
    return solution, sum(is_determined)


def lagged(steps: Steps) -> Steps:
    """Return the steps that follow another one, from where that begins."""
    rows = np.flatnonzero(steps.follows)
    follows = steps.follows[rows - 1]
    points = np.ascontiguousarray(steps.points[:, rows - 1])
    return Steps(points, steps.lengths[rows], np.ascontiguousarray(steps.increments[:, rows]), follows)


def measurement_noise(residuals: FloatArray, steps: Steps) -> FloatArray:
    """Return the variance of errors of measurement of each state (S,), 0 where products of neighbours are chance."""
    variances = np.zeros(len(residuals))
    rows = np.flatnonzero(steps.follows)
    for state, residual in enumerate(residuals):
        products = residual[rows] * residual[rows - 1]
        covariance, square = total(products), total(products * products)
        if covariance < 0.0 and covariance * covariance > SETTINGS.process.significant**2 * square:
            variances[state] = -covariance / len(rows)
    return variances


def products(residuals: FloatArray, steps: Steps, pair: Pair, *, corrected: bool) -> FloatArray:
    """Return the products of two states' residuals (N,); `corrected` by those of neighbours, which noise has, too.

    E r_k^2 = B h + 2 var e and E r_k r_k+1 = - var e, so that the sum of the first and both neighbours is B h.
    """
    one, other = residuals[pair[0]], residuals[pair[1]]
    product = one * other
    if corrected:
        rows = np.flatnonzero(steps.follows)
        mixed = 0.5 * (one[rows] * other[rows - 1] + one[rows - 1] * other[rows])
        product[rows] += mixed
        product[rows - 1] += mixed
    return np.asarray(product)


def _mean_error(values: FloatArray, lengths: FloatArray, bins: Sequence[Rows]) -> float:
    """Return the mean standard error of the sums of `values` over the time of their bin."""
    errors = []
    for rows in bins:
        time, in_bin = total(lengths[rows]), values[rows]
        spread = in_bin - total(in_bin) / len(rows)
        bessel = len(rows) / (len(rows) - 1.0) if len(rows) > 1 else 1.0
        errors.append(math.sqrt(total(spread * spread) * bessel) / time)
    return math.fsum(errors) / len(errors)
