"""States driven by held inputs: smooth between two switches, with a slope that jumps at each switch. Pure.

If an input is held over five rows or more, each piece between two switches is differentiated as a separate trajectory.
If it is switched more often, the slope is the difference quotient of two neighbouring rows. This is the mean slope
during one value of the input; to second order it is the slope at the midpoint between the rows. In this case, smoothing
cannot separate errors from motion. Instead, a polynomial in all variables is fitted to the slopes, and the errors are
estimated from its residuals.

This estimate of the errors is the doubtful part: if no polynomial fits the motion, the errors are too large.

Letters: R rows, N steps between rows, P terms.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations_with_replacement, pairwise
from typing import Final

import numpy as np

from atoll_coordinator.data.columns.examined_columns import dot
from atoll_coordinator.data.differentiation.derivatives import Differentiation, StateEstimate, estimate_states
from atoll_coordinator.data.differentiation.interpolation import make_signal
from atoll_coordinator.data.differentiation.kernels.stencils import moments
from atoll_coordinator.data.differentiation.smoothing import Smoother
from atoll_coordinator.data.trajectories.measurements import Measurements, Range, take_pieces
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray

_DEGREES: Final = (1, 2, 3)
"""Degrees of the polynomials in all variables. These polynomials are fitted to slopes to estimate the errors of the
slopes; the best fit is used."""
_STEPS_PER_TERM: Final = 3
"""Fewest steps for each term of a polynomial. With this number and fifty steps, the residual variance is known to
within 25 %."""
_NEIGHBOURS: Final = Smoother(2, 1, 0.0)
"""A line through two neighbouring rows, described as a smoother."""


def estimate_driven_states(
    measurements: Measurements, weights: FloatArray | None, options: Differentiation
) -> list[StateEstimate]:
    """Return values and derivatives of the measured states, with jumps of slopes where held inputs are switched.

    Without held inputs the result is the result of `estimate_states`, which has the same arguments and raises the same
    errors.
    """
    if not measurements.roles.held:
        return estimate_states(measurements, weights, options)
    pieces = pieces_between_switches(measurements)
    long = [[piece for piece in its if piece[1] - piece[0] >= SETTINGS.common.fewest_rows] for its in pieces]
    rows = [
        begin + row
        for (begin, _), its in zip(measurements.ranges, long, strict=True)
        for first, end in its
        for row in range(first, end)
    ]
    is_any_searched = any(its and not out for its, out in zip(long, measurements.held_out, strict=True))
    if is_any_searched and len({*rows}) >= SETTINGS.rows.least_kept * measurements.row_count:
        split = take_pieces(measurements, long)
        estimates = estimate_states(split, None if weights is None else weights[rows], options)
        pairs = zip(estimates, measurements.roles.states, strict=True)
        estimates = [_over_all_rows(estimate, rows, measurements, name) for estimate, name in pairs]
        if not any(map(_is_hidden, estimates)):
            return estimates
    smoothed = estimate_states(measurements, weights, options)
    differences = None if options.order == 2 else _by_differences(measurements, weights, smoothed)
    return smoothed if differences is None or any(map(_is_hidden, differences)) else differences


def pieces_between_switches(measurements: Measurements) -> list[list[Range]]:
    """Return, for each trajectory, the half-open ranges of rows in which held inputs do not change.

    The row of a switch ends one range and begins the next. An input that is switched at the last row acts only after
    the last measurement, so no range begins there.
    """
    held = np.array([measurements.columns[name] for name in measurements.roles.held])
    pieces = []
    for first, end in measurements.ranges:
        part = held[:, first : end - 1]
        switches = np.flatnonzero((part[:, 1:] != part[:, :-1]).any(axis=0)) + 1
        ends = pairwise([0, *switches.tolist(), end - first - 1])
        pieces.append([(begin, last + 1) for begin, last in ends])
    return pieces


def _over_all_rows(
    estimate: StateEstimate, rows: Sequence[int], measurements: Measurements, name: str
) -> StateEstimate:
    """Return an estimate over all rows, made from an estimate over some `rows`; each of these rows occurs once or
    twice.

    At a row where two pieces meet, the estimate of the later piece is used, since its input acts on the next rows. If a
    row ends a piece, but no piece begins there, the state is not known at this row, unless the trajectory ends there.
    """
    of_row = dict(zip(rows, range(len(rows)), strict=True))  # if a row has two estimates, the later estimate is used
    ends = {last - 1 for _, last in measurements.ranges}
    goes_on = {row for row, after in pairwise(rows) if after == row + 1}
    kept = [row for row in of_row if row in goes_on or row in ends]
    places = [of_row[row] for row in kept]
    known = [row for row in of_row if row not in goes_on and row not in ends]

    def spread(values: FloatArray, elsewhere: FloatArray) -> FloatArray:
        result = elsewhere.copy()
        result[kept] = values[places]
        return result

    values = _filled(measurements, name)
    values[known] = estimate.values[[of_row[row] for row in known]]
    zeros, unknown = np.zeros(len(values)), np.full(len(values), math.inf)
    weights = estimate.robustness_weights
    return replace(
        estimate,
        values=spread(estimate.values, values),
        velocity=spread(estimate.velocity, zeros),
        derivative=spread(estimate.derivative, zeros),
        uncertainty=spread(estimate.uncertainty, unknown),
        total_uncertainty=spread(estimate.total_uncertainty, unknown),
        robustness_weights=None if weights is None else spread(weights, zeros + 1.0),
    )


def _is_hidden(estimate: StateEstimate) -> bool:
    """Tell whether errors cause most of the variance of a derivative. If so, smoothing across jumps is more
    accurate."""
    known = np.flatnonzero(estimate.is_known)
    if len(known) < SETTINGS.common.fewest_rows:
        return True
    error, spread = moments(estimate.total_uncertainty[known])
    return error * error + spread * spread > 0.5 * moments(estimate.derivative[known])[1] ** 2


def _by_differences(
    measurements: Measurements, weights: FloatArray | None, smoothed: Sequence[StateEstimate]
) -> list[StateEstimate] | None:
    """Return first derivatives as difference quotients of neighbouring rows, each stored at the first row of its step.

    `smoothed` are the estimates that ignore jumps. None if there are too few steps to estimate errors.
    """
    assert measurements.trajectories is not None
    times = np.concatenate(measurements.trajectories.times)
    steps = np.array([row for first, end in measurements.ranges for row in range(first, end - 1)])
    lengths = times[steps + 1] - times[steps]
    inverse = np.ones(len(times)) if weights is None else 1.0 / weights
    gains = np.sqrt(inverse[steps] + inverse[steps + 1]) / lengths
    states = [_filled(measurements, name) for name in measurements.roles.states]
    points = [0.5 * (values[steps] + values[steps + 1]) for values in states]
    driving = [
        values[steps] if name in measurements.roles.held else 0.5 * (values[steps] + values[steps + 1])
        for name, values in zip(measurements.roles.inputs, map(np.concatenate, measurements.inputs), strict=True)
    ]
    searched = np.flatnonzero(np.isin(steps, measurements.searched_rows))
    sample = searched[np.linspace(0, len(searched) - 1, min(len(searched), SETTINGS.rows.most)).astype(np.int64)]
    estimates = []
    for values, middle, estimate in zip(states, points, smoothed, strict=True):
        slopes = (values[steps + 1] - values[steps]) / lengths
        is_known = estimate.is_known[steps] & estimate.is_known[steps + 1]
        chosen = sample[is_known[sample]]
        noise = _noise(slopes[chosen], gains[chosen], [column[chosen] for column in (*points, *driving)])
        if noise is None:
            return None
        noise = max(noise, 0.0 if estimate.quantisation is None else estimate.quantisation.error)
        whole, errors = values.copy(), np.full(len(values), math.inf)
        derivative = np.zeros(len(values))
        whole[steps], derivative[steps[is_known]] = middle, slopes[is_known]
        errors[steps[is_known]] = noise * gains[is_known]
        differences = StateEstimate(
            values, derivative, derivative, errors, errors, noise, estimate.standard_deviation, _NEIGHBOURS,
            has_heavy_tails=estimate.has_heavy_tails, quantisation=estimate.quantisation, points=whole,
        )  # fmt: skip
        estimates.append(differences)
    return estimates


def _filled(measurements: Measurements, name: str) -> FloatArray:
    """Return the measured values (R,) of a state. Missing values are interpolated linearly between their neighbours."""
    assert measurements.trajectories is not None
    pairs = zip(measurements.trajectories.times, measurements.trajectories.states[name], strict=True)
    return np.concatenate([make_signal(times, values).values for times, values in pairs])


def _noise(slopes: FloatArray, gains: FloatArray, variables: Sequence[FloatArray]) -> float | None:
    """Return the standard deviation of a state's errors, from residuals of polynomials fitted to its `slopes` (N,).

    `gains` (N,) are the standard errors of slopes for errors of standard deviation one. The result is None if there are
    too few steps.
    """
    columns = [(values - mean) / (deviation or 1.0) for values in variables for mean, deviation in [moments(values)]]
    least: float | None = None
    for degree in _DEGREES:
        powers = [power for size in range(degree + 1) for power in combinations_with_replacement(columns, size)]
        if _STEPS_PER_TERM * len(powers) > len(slopes):
            break
        rest, basis = slopes / gains, list[FloatArray]()
        for power in powers:
            column = 1.0 / gains
            for factor in power:
                column = column * factor
            size = dot(column, column)
            for _ in range(2):  # the second time removes the rounding errors of the first
                for other in basis:
                    column = column - dot(column, other) * other
            left = dot(column, column)
            if left > SETTINGS.common.negligible**2 * size:
                basis.append(column / math.sqrt(left))
                rest = rest - dot(rest, basis[-1]) * basis[-1]
        noise = math.sqrt(dot(rest, rest) / (len(slopes) - len(basis)))
        least = noise if least is None else min(least, noise)
    return least
