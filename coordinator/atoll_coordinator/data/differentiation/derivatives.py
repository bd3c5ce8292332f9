"""Values, derivatives and their uncertainty along trajectories, for one state at a time (pure).

Noisy states are smoothed by loess. Where leaving rows out shows that the data follow local polynomials of high order
better than any smoother (there is no noise to speak of), they are interpolated instead. Rows of different weights say
that there is noise.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from atoll_coordinator.data.differentiation.interpolation import (
    interpolate_derivative,
    is_interpolation_better,
    predict_left_out,
)
from atoll_coordinator.data.differentiation.kernels.stencils import moments
from atoll_coordinator.data.differentiation.missing_values import fill, fill_holes, make_signal
from atoll_coordinator.data.differentiation.noise import are_moving, estimate_noise, estimate_value_noise
from atoll_coordinator.data.differentiation.quantisation import find_quantisation, is_refuted
from atoll_coordinator.data.differentiation.robust import fit_robustly, has_heavy_tails, weigh_by
from atoll_coordinator.data.differentiation.smoothing import Signal, Smoother, select_smoother, smooth
from atoll_coordinator.data.differentiation.value_scale import derivative_standard_deviation
from atoll_coordinator.data.recording import STENCIL_ROWS, Quantisation
from atoll_coordinator.data.trajectories.measurements import Measurements
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.errors import DataError


@dataclass(frozen=True, eq=False)
class StateEstimate:
    """What is known of one state over all its rows, in the order of the signals. All arrays are (R,).

    `values` are interpolated (as measured) or smoothed; `derivative` is the one sought, `velocity` the first one;
    `uncertainty` is the standard error of `derivative`, and `total_uncertainty` the root of its square and that of the
    estimated bias (where the state was interpolated, the same as `uncertainty`). Where the state is missing and its own
    rows do not tell it, both are infinite, the derivatives 0, and a value nearby stands in. `noise` is the estimated
    standard deviation of the measurement errors, at least that of the `quantisation` (None where there is none to see),
    and `standard_deviation` that of the measurements; `smoother` is None where the state was interpolated. `outliers`,
    how many rows have no weight, and `robustness_weights` are None unless loess was robust; `has_heavy_tails` advises
    that it should be. `narrower_noise` is the noise by loess with the narrower span, `narrower_span` (rows), by which
    the bias is estimated. `points` (R,) are the values that the derivatives belong to where these are not `values`.
    """

    values: FloatArray
    velocity: FloatArray
    derivative: FloatArray
    uncertainty: FloatArray
    total_uncertainty: FloatArray
    noise: float
    standard_deviation: float
    smoother: Smoother | None
    outliers: int | None = None
    robustness_weights: FloatArray | None = None
    has_heavy_tails: bool = False
    narrower_noise: float = 0.0
    narrower_span: int = 0
    quantisation: Quantisation | None = None
    points: FloatArray | None = None

    @property
    def is_known(self) -> npt.NDArray[np.bool_]:
        """Where the state is known (R,): it was measured, or its own rows tell it."""
        return np.isfinite(self.total_uncertainty)

    @property
    def is_interpolated(self) -> bool:
        """Whether the data are free of noise, or nearly."""
        return self.smoother is None

    @property
    def span(self) -> int:
        """How many rows, at most, the value or derivative of a row depends on."""
        return STENCIL_ROWS if self.smoother is None else self.smoother.rows

    @property
    def relative_noise(self) -> float:
        """The measurement errors as a share of the state's standard deviation."""
        return self.noise / self.standard_deviation if self.standard_deviation > 0.0 else 0.0

    @property
    def target_noise(self) -> float:
        """The relative noise that the search assumes: 0.0 when interpolated, or below what can be told."""
        is_free = self.is_interpolated or self.relative_noise < SETTINGS.interpolation.smallest_noise
        return 0.0 if is_free else self.relative_noise


@dataclass(frozen=True)
class Differentiation:
    """How states are differentiated.

    `order` is 1 or 2, the derivative sought; `paper`: as in the paper, loess of degree 2 and no interpolation;
    `robust`: outliers lose their weight.
    """

    order: Literal[1, 2] = 1
    paper: bool = False
    robust: bool = False

    @property
    def degrees(self) -> tuple[int, ...]:
        """Degrees of loess among which one is selected; 2 is that of Schmidt & Lipson 2008."""
        return (2,) if self.paper else SETTINGS.smoothing.degrees


def estimate_states(
    measurements: Measurements, weights: FloatArray | None, options: Differentiation
) -> list[StateEstimate]:
    """Return values and derivatives of the measured states.

    `weights` (R,) are inverse variances of the errors of each row, up to a factor; None: all are 1. Raises DataError
    where a state has too few values along every trajectory, or a derivative of zeros, or beyond the range of numbers.
    """
    assert measurements.trajectories is not None
    parts = [None if weights is None else weights[first:last] for first, last in measurements.ranges]
    estimates = []
    for state, along in measurements.trajectories.states.items():
        signals = [
            make_signal(times, values, part)
            for times, values, part in zip(measurements.trajectories.times, along, parts, strict=True)
        ]
        if not any(map(_is_long_enough, _not_held_out(signals, measurements.held_out))):
            few = SETTINGS.checks.min_rows
            raise DataError(f"state '{state}' has fewer than {few} values along every trajectory; sample more of them")
        quantisation = find_quantisation(along)
        if quantisation is not None and is_refuted(quantisation, list(filter(_is_long_enough, signals))):
            quantisation = None
        least = 0.0 if quantisation is None else quantisation.error
        estimate = estimate_derivatives(signals, options, measurements.held_out, least)
        derivative_standard_deviation(state, estimate.derivative)
        estimates.append(replace(estimate, quantisation=quantisation))
    return estimates


def estimate_derivatives(
    signals: Sequence[Signal], options: Differentiation, held_out: Sequence[bool] = (), least_noise: float = 0.0
) -> StateEstimate:
    """Return values and derivatives of one state, over all rows of all signals.

    Signals have 5 rows or more each; where fewer of them were measured, the state is not known there. Those `held_out`
    take no part in any choice (empty: all do). Errors have the standard deviation `least_noise` at least.
    """
    _, exponent = math.frexp(max(float(np.max(np.abs(signal.values))) for signal in signals))
    scaled = [replace(signal, values=np.ldexp(signal.values, -exponent)) for signal in signals]
    least = math.ldexp(least_noise, -exponent)
    return _rescale(_estimate(scaled, options, held_out or [False] * len(signals), least), exponent)


def _rescale(estimate: StateEstimate, exponent: int) -> StateEstimate:
    """Return the estimate of values 2**exponent times as large: values of any size have squares in between."""
    with np.errstate(over="ignore", under="ignore"):
        return replace(
            estimate,
            values=np.ldexp(estimate.values, exponent),
            velocity=np.ldexp(estimate.velocity, exponent),
            derivative=np.ldexp(estimate.derivative, exponent),
            uncertainty=np.ldexp(estimate.uncertainty, exponent),
            total_uncertainty=np.ldexp(estimate.total_uncertainty, exponent),
            noise=float(np.ldexp(estimate.noise, exponent)),
            standard_deviation=float(np.ldexp(estimate.standard_deviation, exponent)),
            narrower_noise=float(np.ldexp(estimate.narrower_noise, exponent)),
        )


def _estimate(
    signals: Sequence[Signal], options: Differentiation, held_out: Sequence[bool], least: float
) -> StateEstimate:
    searched = [signal for signal in _not_held_out(signals, held_out) if _is_long_enough(signal)]
    searched = [signal for signal in searched if signal.measured.values.any()] or searched
    smoother = select_smoother(searched, options.degrees)
    smoothed = [smooth(signal, smoother) for signal in searched]
    is_tailed = has_heavy_tails(searched, smoothed)
    is_weighted = any(signal.inverse_variances is not None for signal in signals)
    if not options.paper and not is_weighted and not (options.robust and is_tailed):
        errors, gains = predict_left_out([signal.measured for signal in searched])
        moving = are_moving([signal.measured.values for signal in searched])
        moving = moving if np.count_nonzero(moving) >= SETTINGS.checks.min_rows else np.ones_like(moving)
        noise = max(estimate_value_noise(errors[moving], gains[moving]), least)
        deviation = _standard_deviation(searched)
        largest, shares = SETTINGS.interpolation.largest_noise * deviation, SETTINGS.interpolation.judged_shares
        if noise > largest:
            noise = max(estimate_value_noise(errors[moving], gains[moving], is_quiet=True), least)
            shares = (*shares, SETTINGS.interpolation.quiet_share)
        if noise <= largest and is_interpolation_better(searched, errors, smoothed, shares):
            return _interpolate(signals, options.order, noise, deviation)
    fit = fit_robustly(searched, options.degrees) if options.robust else None
    if fit is None or not fit.outliers:
        return replace(_by_loess(signals, smoother, options.order, searched, least), has_heavy_tails=is_tailed)
    fitted = {id(signal): weighted for signal, weighted in zip(searched, fit.signals, strict=True)}
    weighted = [fitted.get(id(signal)) or weigh_by(fit, signal) for signal in signals]
    weights = [signal.robustness_weights for signal in weighted if signal.robustness_weights is not None]
    estimate = _by_loess(weighted, fit.smoother, options.order, fit.signals, least)
    return replace(estimate, outliers=fit.outliers, robustness_weights=np.concatenate(weights))


def _by_loess(
    signals: Sequence[Signal], smoother: Smoother, order: int, searched: Sequence[Signal], least: float
) -> StateEstimate:
    """Return what loess gives of `signals`, with the noise of those `searched`, `least` at least."""
    noise = max(estimate_noise(searched, smoother), least)
    fits, gains = _joined(signals, smoother)
    span = max(int(SETTINGS.smoothing.narrower * smoother.span), smoother.degree + 2)
    narrower = replace(smoother, span=span)
    narrower_noise = max(estimate_noise(searched, narrower), least)
    narrower_fits, _ = _joined(signals, narrower)
    bias = fits[order] - narrower_fits[order]
    uncertainty = noise * gains[order]
    total = np.sqrt(uncertainty * uncertainty + bias * bias)
    estimate = StateEstimate(
        fits[0], fits[1], fits[order], uncertainty, total, noise, _standard_deviation(searched), smoother,
        narrower_noise=narrower_noise, narrower_span=narrower.rows,
    )  # fmt: skip
    return _without_unknown(estimate, signals, gains[0])


def _without_unknown(estimate: StateEstimate, signals: Sequence[Signal], gains: FloatArray) -> StateEstimate:
    """Return the estimate with what is not known said to be so.

    A missing value is known where it is as certain, by the others, as one measurement: where its noise gain (R,) is at
    most 1.
    """
    if all(signal.is_measured is None for signal in signals):
        return estimate
    is_long = np.concatenate([np.full(len(signal.times), _is_long_enough(signal)) for signal in signals])
    is_known = is_long & (np.concatenate([signal.measured_rows for signal in signals]) | (gains <= 1.0))
    held, start = estimate.values.copy(), 0
    for signal in signals:
        part = slice(start, start + len(signal.times))
        rows = is_known[part] if is_known[part].any() else signal.measured_rows
        held[part] = fill(signal.times, held[part], rows, 1)[0] if rows.any() else moments(held[is_known])[0]
        start = part.stop
    return replace(
        estimate,
        values=held,
        velocity=np.where(is_known, estimate.velocity, 0.0),
        derivative=np.where(is_known, estimate.derivative, 0.0),
        uncertainty=np.where(is_known, estimate.uncertainty, math.inf),
        total_uncertainty=np.where(is_known, estimate.total_uncertainty, math.inf),
    )


def _not_held_out(signals: Sequence[Signal], held_out: Sequence[bool]) -> list[Signal]:
    return [signal for signal, is_held_out in zip(signals, held_out, strict=True) if not is_held_out]


def _is_long_enough(signal: Signal) -> bool:
    """Say whether enough rows of a signal were measured for it to have a derivative."""
    return len(signal.measured.times) >= SETTINGS.checks.min_rows


def _joined(signals: Sequence[Signal], smoother: Smoother) -> tuple[FloatArray, FloatArray]:
    """Return fits (3, R) and gains (4, R) over the rows of all signals."""
    smoothed = [smooth(signal, smoother) for signal in signals]
    fits = np.concatenate([signal.fits for signal in smoothed], axis=1)
    return fits, np.concatenate([signal.gains for signal in smoothed], axis=1)


def _standard_deviation(signals: Sequence[Signal]) -> float:
    """Return the standard deviation of all values but outliers."""
    return moments(np.concatenate([signal.values[signal.weights > 0.0] for signal in signals]))[1]


def _interpolate(signals: Sequence[Signal], order: int, noise: float, deviation: float) -> StateEstimate:
    filled = [fill_holes(signal) for signal in signals]
    whole, errors = [], []
    for filling in filled:
        known = np.flatnonzero(np.isfinite(filling.steps))
        part = slice(int(known[0]), int(known[-1]) + 1) if len(known) else slice(0)
        whole.append(Signal(filling.signal.times[part], filling.signal.values[part]))
        errors.append(np.maximum(noise, noise * filling.gains + filling.steps)[part])
    rows = np.concatenate([np.isfinite(filling.steps) for filling in filled])
    derivatives = {each: np.zeros((2, len(rows))) for each in (1, order)}
    for each, everywhere in derivatives.items():
        everywhere[:, rows] = interpolate_derivative(whole, each, errors)
    velocity, (derivative, uncertainty) = derivatives[1][0], derivatives[order]
    values = np.concatenate([filling.signal.values for filling in filled])
    estimate = StateEstimate(values, velocity, derivative, uncertainty, uncertainty, noise, deviation, None)
    return _without_unknown(estimate, signals, np.where(rows, 0.0, math.inf))
