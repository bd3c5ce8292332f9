"""Regression problems for the drift and the diffusion of a stochastic process, made from its measurements. Pure.

1. `take_steps`: `Measurements` -> `Steps`: the increments of the states from row to row. Nothing is smoothed.
2. `noise_shares`, `is_driven`: whether a state has noise of its own, only follows noisy states, or is smooth.
3. `bin_moments`: means and products of increments in bins of neighbouring points. Significance tests decide whether
   there is measurement noise, and whether the noises of two states are correlated.
4. `assemble_process`: all of these -> `Preparation`: one target for each drift and for each component of the diffusion.

Differences of high order remove smooth motion almost completely and keep the noise. A divided difference over k steps
is a weighted sum of the k increments. The data of the search are computed only with + - * /, square roots and correctly
rounded sums, so that every machine gets the same bits.

The targets are doubtful for long steps: moments are divided by the length h of a step, and terms of order h are
neglected. Models are later fitted and judged by the likelihood of single steps, which includes these terms
(`atoll_coordinator.process_steps.moments`).

Letters: S states, N steps, V variables, W windows of neighbouring steps, M bins.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate, combinations
from typing import Final

import numpy as np
import numpy.typing as npt

from atoll_coordinator.data.differentiation.derivatives import derivative_standard_deviation
from atoll_coordinator.data.recording import Preparation, ProcessRecording, SampledPath
from atoll_coordinator.data.trajectories.measurements import Measurements
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import Dataset, FloatArray, Target
from atoll_core.errors import DataError

Pair = tuple[int, int]
Rows = npt.NDArray[np.intp]
LIMITS = SETTINGS.selection
_DEPENDENT: Final = 1e-9
"""Guard: a pivot that is smaller than this share of its diagonal element is a rounding error."""

# ------------------------------------------------------------------------------------------------- steps and windows


@dataclass(frozen=True, eq=False)
class Steps:
    """N steps of S states, one trajectory after another.

    `points` (V, N) has the states at the beginning of each step, then the inputs, each averaged over both ends of the
    step; `lengths` (N,) are in the unit of time, `increments` (S, N) are the changes of the states. `follows` (N,) is
    true for a step that begins where the step before it ends.
    """

    points: FloatArray
    lengths: FloatArray
    increments: FloatArray
    follows: npt.NDArray[np.bool_]

    @cached_property
    def least_variances(self) -> FloatArray:
        """Return the variances (S,) below which the residuals of a state's steps do not count as noise."""
        sizes = np.median(np.abs(self.increments), axis=1)
        return np.asarray((LIMITS.least_noise * sizes) ** 2)


def take_steps(process: ProcessRecording, *, held_out: bool = False) -> Steps:
    """Return the steps of the trajectories that are used in fits, or of the held-out trajectories."""
    states, inputs = len(process.states), len(process.inputs)
    parts = [(np.zeros((states + inputs, 0)), np.zeros(0), np.zeros((states, 0)), np.zeros(0, np.bool_))]
    for path in process.paths:
        if path.held_out is held_out:
            middles = path.inputs[:, :-1] + 0.5 * (path.inputs[:, 1:] - path.inputs[:, :-1])
            points = np.concatenate([path.states[:, :-1], middles])
            follows = np.arange(len(path.times) - 1) > 0
            parts.append((points, np.diff(path.times), np.diff(path.states), follows))
    return Steps(*(np.concatenate(columns, axis=-1) for columns in zip(*parts, strict=True)))


@dataclass(frozen=True, eq=False)
class StepWindows:
    """Windows of `count` consecutive increments of `lag` steps; `first` (W,) are the indices of their first steps."""

    steps: Steps
    first: Rows
    count: int
    lag: int = 1

    def differences(self, state: int) -> FloatArray:
        """Return divided differences of one state (W,), scaled so that Brownian motion of rate 1 gives variance 1."""
        differences, variance = np.zeros(len(self.first)), np.zeros(len(self.first))
        lengths = self._moves(self.steps.lengths)
        moves = self._moves(self.steps.increments[state])
        times = [*accumulate((length / lengths[0] for length in lengths), initial=np.zeros_like(lengths[0]))]
        of_rows = []
        for i, time in enumerate(times):
            product = np.ones_like(time)
            for j, other in enumerate(times):
                product = product * (time - other) if i != j else product
            of_rows.append(1.0 / product)
        weights = [*accumulate(reversed(of_rows[1:]))][::-1]
        for weight, move, length in zip(weights, moves, lengths, strict=True):
            differences += weight * move
            variance += weight * weight * length
        return np.asarray(differences / np.sqrt(variance))

    def _moves(self, values: FloatArray) -> list[FloatArray]:
        moves = [np.zeros(len(self.first)) for _ in range(self.count)]
        for k in range(self.count * self.lag):
            moves[k // self.lag] += values[self.first + k]
        return moves


def all_windows(steps: Steps, count: int, lag: int = 1) -> StepWindows:
    """Return the windows that begin at every step, except windows that would pass the end of a trajectory."""
    span = count * lag
    is_within = np.ones(max(len(steps.lengths) - span + 1, 0), dtype=np.bool_)
    for k in range(1, span):
        is_within &= steps.follows[k : k + len(is_within)]
    return StepWindows(steps, np.flatnonzero(is_within), count, lag)


def separate_windows(steps: Steps, count: int) -> StepWindows:
    """Return windows without common steps, placed one after another from the beginning of each trajectory."""
    windows = all_windows(steps, count)
    begins = np.flatnonzero(~steps.follows)
    place = windows.first - begins[np.searchsorted(begins, windows.first, side="right") - 1]
    return StepWindows(steps, windows.first[place % count == 0], count)


# --------------------------------------------------------------------------------------------- is a state rough at all?

_ROUGHNESS_STEPS: Final = 7
"""Number of steps of one divided difference, which combines eight rows and has order seven."""
_OWN: Final = 2.0
"""If the noise rate grows by more than this limit when the lag is doubled, the state has no noise of its own. The rate
of a state with noise of its own does not grow; the rate of a state that follows a noisy state grows fourfold."""
_SMOOTH: Final = 2.0**10
"""If the noise rate grows by more than this limit when the lag is doubled, the state is smooth. The rate grows by 2^13
for smooth motion, and by 2^8 for noise that is integrated four times."""


def noise_shares(steps: Steps) -> FloatArray:
    """Return for each state (S,) the approximate size of the noise relative to the median increment."""
    shares = np.zeros(len(steps.increments))
    for state, increments in enumerate(steps.increments):
        step, rate = float(np.median(np.abs(increments))), noise_rate(steps, state)
        shares[state] = math.sqrt(rate * float(np.median(steps.lengths))) / step if step > 0.0 else math.inf
    return shares


def is_driven(steps: Steps, state: int) -> bool:
    """Tell whether a state has no noise of its own but follows a state with noise.

    A state that only follows noisy states is an integral of their noise. The variance of its increments over a step h
    grows as h^3, so its noise rate grows fourfold when the lag is doubled. For an integral of such an integral, the
    variance grows as h^5, and so on. The rate of a state with noise of its own stays the same.
    """
    rate = noise_rate(steps, state)
    return _OWN * rate < noise_rate(steps, state, lag=2) < _SMOOTH * rate


def noise_rate(steps: Steps, state: int, lag: int = 1) -> float:
    """Return the approximate variance that noise adds to a state per unit of time, from rows `lag` apart.

    The result is infinite if there are no windows. For a state with noise of its own the result is about 0.45 of this
    variance: 0.45 is the median of the square of a standard normal number.
    """
    differences = all_windows(steps, _ROUGHNESS_STEPS, lag).differences(state)
    return float(np.median(differences * differences)) if len(differences) else math.inf


# --------------------------------------------------------------------------------------------------- correlated noises

_WINDOW_STEPS: Final = 3
"""Steps of a window: the smallest number for which the difference removes most of the drift, even for the longest steps
that a process may have."""
_TESTS: Final = 2
"""Tests of each pair: one for a correlation over all steps, one for correlations whose sign changes from bin to bin."""
_DOUBLED: Final = 1.28
"""How much the squared limit of a normal score grows when the probability that a score exceeds the limit is halved:
1.25 to 1.28 for probabilities of 0.0027 or less."""


def correlated_pairs(steps: Steps, bins: Sequence[Rows]) -> list[Pair]:
    """Return the pairs of states whose noises are correlated: overall, or with different signs in different bins.

    Only states with noise of their own are tested. Two effects look like correlated noise: during a step, the drift
    carries the noise of one state into the other, and both states share the part of the drift that bins do not resolve.
    Differences of high order remove both. They weight the increments by weights w whose sum is zero. With the Jacobian
    J of the drift and the diffusion B, the carried noise is J B h^2 (sum w)^2 / 2, so it vanishes; smooth motion almost
    vanishes. Let p be the product of two states' differences, in windows without a common step. If the noises are not
    correlated, both signs of p are equally probable. Then sum(p) / sqrt(sum(p^2)) has mean 0 and variance 1 for any
    sizes of p (Efron 1969), and is normal for many windows.

    All tests together have the false positive rate of one test at `significant` (Bonferroni).
    """
    rough = [state for state in range(len(steps.increments)) if not is_driven(steps, state)]
    pairs = [*combinations(rough, 2)]
    doublings = (_TESTS * len(pairs) - 1).bit_length()
    limit = math.sqrt(SETTINGS.common.significant**2 + _DOUBLED * doublings)
    windows = separate_windows(steps, _WINDOW_STEPS)
    places = [np.flatnonzero(np.isin(windows.first, rows)) for rows in bins]
    differences = {state: windows.differences(state) for state in rough}
    return [(i, j) for i, j in pairs if max(correlation_scores(differences[i] * differences[j], places)) > limit]


def correlation_scores(products: FloatArray, bins: Sequence[Rows]) -> tuple[float, float]:
    """Return the scores of both tests for products (W,) in bins.

    They are about standard normal if signs are independent. The second score comes from a sum over bins that is about
    chi-square; its cube root is about normal (Wilson & Hilferty 1931).
    """
    sums = [total(products[rows]) for rows in bins]
    squares = [total(products[rows] * products[rows]) for rows in bins]
    variance = math.fsum(squares)
    if not variance > 0.0:
        return 0.0, 0.0
    parts = [bin_sum * bin_sum / square for bin_sum, square in zip(sums, squares, strict=True) if square > 0.0]
    spread = 2.0 / (9.0 * len(parts))
    mean = math.fsum(parts) / len(parts)
    root = max(mean, 1.0)
    for _ in range(64):  # the cube root by Newton's iteration: the same bits on every machine
        root -= (root - mean / (root * root)) / 3.0
    return abs(math.fsum(sums)) / math.sqrt(variance), (root - (1.0 - spread)) / math.sqrt(spread)


# ----------------------------------------------------------------------------------------------------- moments in bins


def total(values: FloatArray) -> float:
    """Return the correctly rounded sum."""
    return math.fsum(values.tolist())


def split_into_bins(positions: FloatArray, most: int) -> list[Rows]:
    """Return the rows of `positions` (V, N) in bins with nearly equal numbers of rows. The number of bins is a power of
    two, at most `most`.

    Bins are the leaves of a k-d tree (Bentley 1975). Each node is halved at the median of the variable along which it
    is widest, relative to the variable's whole range.
    """
    ranges = np.max(positions, axis=1) - np.min(positions, axis=1)
    bins: list[Rows] = [np.arange(positions.shape[1])]
    while 2 * len(bins) <= most and min(map(len, bins)) >= 2:
        halves = []
        for rows in bins:
            points = positions[:, rows]
            widths = np.max(points, axis=1) - np.min(points, axis=1)
            widest = int(np.argmax(np.divide(widths, ranges, out=np.zeros(len(ranges)), where=ranges > 0.0)))
            order = rows[np.argsort(points[widest], kind="stable")]
            halves += [order[: len(order) // 2], order[len(order) // 2 :]]
        bins = halves
    return bins


@dataclass(frozen=True, eq=False)
class BinnedMoments:
    """Moments of increments per unit of time, in bins.

    `points` (V, M) are the mean points at which steps begin; `drift` (S, M) are the fitted mean increments per unit of
    time. `products` has for each pair of states (M,) the mean products of the residuals of increments per unit of time.
    `errors` are the mean standard errors, one for each row of `drift`, then one for each of `products`. `noise` (S,) is
    the variance of measurement errors, 0 if none is found.
    """

    points: FloatArray
    drift: FloatArray
    products: dict[Pair, FloatArray]
    errors: list[float]
    noise: FloatArray


def bin_moments(steps: Steps) -> BinnedMoments:
    """Return the moments of the steps; with measurement noise, each step is assigned the position one step before it.

    The measurement error of a step's own position is also, with opposite sign, an error of its increment; the earlier
    position does not have this error.
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
    """Return bins, drifts at the centre of each bin (S, M), residuals of increments about lines (S, N), and factors.

    In each bin the drift is fitted by a linear function of the position where steps begin. The number of bins is at
    most twice the square root of the number of rows, with enough rows in each bin to judge the lines. The factors, one
    for each bin, correct products of residuals for the number of fitted coefficients.
    """
    rows_in_all, variables = len(steps.lengths), len(steps.points)
    most = max(min(2 * math.isqrt(rows_in_all), rows_in_all // (2 * (variables + 1))), 1)
    bins = split_into_bins(steps.points, most)
    drift = np.zeros((len(steps.increments), len(bins)))
    residuals = steps.increments.copy()
    factors = []
    for number, rows in enumerate(bins):
        design = [steps.lengths[rows]]  # columns of the coefficients: lengths, and lengths times positions in [-1, 1]
        for positions in steps.points:
            away = positions[rows] - total(positions[rows]) / len(rows)
            widest = float(np.max(np.abs(away)))
            design.append(away / widest * steps.lengths[rows] if widest > 0.0 else np.zeros(len(rows)))
        sides = [[total(column * increments[rows]) for increments in steps.increments] for column in design]
        normal = [[total(one * other) for other in design] for one in design]
        solved, rank = _solved(normal, sides)
        for state in range(len(drift)):
            drift[state, number] = solved[0][state]
            for column, coefficients in zip(design, solved, strict=True):
                residuals[state, rows] -= coefficients[state] * column
        factors.append(len(rows) / (len(rows) - rank) if len(rows) > rank else 1.0)
    return bins, drift, residuals, factors


def _solved(normal: list[list[float]], sides: list[list[float]]) -> tuple[list[list[float]], int]:
    """Return the solutions X (K, S) of ``normal @ X = sides``, and the rank; undetermined unknowns are 0.

    Gaussian elimination without pivoting: a positive semidefinite matrix does not need it.
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
    """Return the steps that follow another step, each with the position at the beginning of the previous step."""
    rows = np.flatnonzero(steps.follows)
    follows = steps.follows[rows - 1]
    points = np.ascontiguousarray(steps.points[:, rows - 1])
    return Steps(points, steps.lengths[rows], np.ascontiguousarray(steps.increments[:, rows]), follows)


def measurement_noise(residuals: FloatArray, steps: Steps) -> FloatArray:
    """Return the variance of measurement errors of each state (S,).

    It is 0 if products of neighbouring residuals are not significant. With process noise alone, the residuals r of
    increments about the drift are independent from step to step. Measurement errors e make neighbouring residuals
    anticorrelated: if a row is too high, one increment is too large and the next too small. So E r_k r_k+1 = - var e
    (Roll 1984).
    """
    variances = np.zeros(len(residuals))
    rows = np.flatnonzero(steps.follows)
    for state, residual in enumerate(residuals):
        neighbours = residual[rows] * residual[rows - 1]
        covariance, square = total(neighbours), total(neighbours * neighbours)
        if covariance < 0.0 and covariance * covariance > SETTINGS.common.significant**2 * square:
            variances[state] = -covariance / len(rows)
    return variances


def products(residuals: FloatArray, steps: Steps, pair: Pair, *, corrected: bool) -> FloatArray:
    """Return the products of two states' residuals (N,); if `corrected`, without the contribution of measurement noise.

    E r_k^2 = B h + 2 var e and E r_k r_k+1 = - var e. So r_k^2 plus the products with both neighbours has expectation B
    h.
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
    errors = []
    for rows in bins:
        time, in_bin = total(lengths[rows]), values[rows]
        spread = in_bin - total(in_bin) / len(rows)
        bessel = len(rows) / (len(rows) - 1.0) if len(rows) > 1 else 1.0
        errors.append(math.sqrt(total(spread * spread) * bessel) / time)
    return math.fsum(errors) / len(errors)


# ------------------------------------------------------------------------------------------------ regression problems


def assemble_process(measurements: Measurements, equations: Collection[str], symbols: Mapping[str, str]) -> Preparation:
    """Return the problems of the `equations` that the data can determine, and the recording of a process.

    `symbols` maps column names to names in expressions. Raises DataError for too few steps, or a state without noise.
    """
    process = _record(measurements, symbols)
    steps = take_steps(process)
    if len(steps.lengths) < LIMITS.fewest_steps:
        count = f"there are {len(steps.lengths)} steps from row to row"
        raise DataError(f"{count}; a stochastic process takes at least {LIMITS.fewest_steps}")
    for number, (state, share) in enumerate(zip(process.states, noise_shares(steps).tolist(), strict=True)):
        if share < LIMITS.least_noise and not is_driven(steps, number):
            raise DataError(
                f"neither state '{state}' nor a state it follows has noise; leave out --stochastic, "
                f"or, if only other states have noise, make '{state}' an input with --inputs"
            )
    moments = bin_moments(steps)
    process = replace(process, noise=moments.noise, pairs=tuple(moments.products))
    values = [*moments.drift, *moments.products.values()]
    targets = []
    for name, moment, error in zip([*process.states, *process.components], values, moments.errors, strict=True):
        if name in equations:
            column = np.ascontiguousarray(moment)
            scale, lhs = derivative_standard_deviation(name, column), measurements.roles.left_hand_side(name)
            targets.append(Target(name, lhs, column, error / scale, scale, error / scale))
    groups = f"{moments.points.shape[1]} groups of neighbouring rows"
    warnings = [f"The search sees means over {groups}; models are judged by all {len(steps.lengths)} steps."]
    warnings += [
        f"Consecutive steps of '{state}' are anticorrelated: besides the noise of the process there are measurement "
        f"errors of about {variance**0.5:.2g}."
        for state, variance in zip(process.states, moments.noise.tolist(), strict=True)
        if variance > 0.0
    ]
    names, remarks = tuple(symbols.values()), (*measurements.warnings, *warnings)
    return Preparation(Dataset(names, moments.points, tuple(targets), dict(symbols), remarks), process=process)


def _record(measurements: Measurements, symbols: Mapping[str, str]) -> ProcessRecording:
    roles, whole = measurements.roles, measurements.trajectories
    assert whole is not None
    inputs = measurements.inputs
    paths = []
    for number, (name, times, held_out) in enumerate(zip(whole.names, whole.times, measurements.held_out, strict=True)):
        states = np.array([whole.states[state][number] for state in roles.states])
        acting = np.array([parts[number] for parts in inputs]).reshape(len(inputs), len(times))
        rows = np.flatnonzero(np.isfinite(states).all(axis=0))
        states, acting = (np.ascontiguousarray(array[:, rows]) for array in (states, acting))
        paths.append(SampledPath(name, times[rows], states, acting, held_out))
    return ProcessRecording(
        roles.states,
        tuple(symbols[name] for name in roles.states),
        roles.inputs,
        tuple(symbols[name] for name in roles.inputs),
        whole.offset,
        tuple(paths),
    )
