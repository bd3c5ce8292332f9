"""Values, derivatives and their uncertainty along trajectories, for one state at a time. Pure.

Noisy states are smoothed by loess. Each row is also predicted from its neighbours by local polynomials of high order.
If these polynomials predict left-out rows better than loess does, the noise is negligible, and the state is
interpolated instead. If rows have different weights, noise is assumed.

The estimated bias of a smoothed derivative is the most doubtful of the results. This bias is the difference from a
second fit with a narrower span. The difference has noise itself, and it does not show features of the motion that are
shorter than both spans.
"""

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt

from atoll_coordinator.data.differentiation.interpolation import (
    are_moving,
    estimate_value_noise,
    fill,
    fill_missing,
    interpolate_derivative,
    is_interpolation_better,
    make_signal,
    predict_left_out,
)
from atoll_coordinator.data.differentiation.kernels.stencils import moments
from atoll_coordinator.data.differentiation.quantisation import find_quantisation, is_refuted
from atoll_coordinator.data.differentiation.smoothing import (
    Signal,
    Smoother,
    estimate_noise,
    fit_robustly,
    has_heavy_tails,
    select_smoother,
    smooth,
    weigh_by,
)
from atoll_coordinator.data.recording import STENCIL_ROWS, StateQuantisation
from atoll_coordinator.data.trajectories.measurements import Measurements
from atoll_coordinator.data.trajectories.table_checks import SMALLEST, check_size
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.errors import DataError

ROUNDING: Final = 1e-12
"""Guard: if a column varies less than this share of its mean, it may be constant. Its scale is then this share of the
mean."""


_NARROWER: Final = 0.6
"""The bias of a derivative is estimated from a second estimate, whose span is this share of the first span."""
_QUIET_SHARE: Final = 0.5
"""Interpolation and smoothing are also compared on only this share of the rows, the rows with the smallest errors. On
fast transients the errors of interpolation are large even without noise, so only slowly changing rows may show that
there is no noise."""


@dataclass(frozen=True, eq=False)
class StateEstimate:
    """The estimate of one state over all its rows, in the order of the signals. All arrays are (R,).

    `values` are the measured values if the state is interpolated, or else smoothed values. `derivative` is the
    derivative of the requested order, and `velocity` is the first derivative. `uncertainty` is the standard error of
    `derivative`; `total_uncertainty` is sqrt(standard error^2 + estimated bias^2); for an interpolated state, it is
    equal to `uncertainty`. If the state is missing at a row, and its other rows do not determine it, both uncertainties
    are infinite there, the derivatives are 0, and the value is a substitute.

    `noise` is the estimated standard deviation of the measurement errors; it is at least the rounding error of the
    `quantisation` (None: no rounding). `standard_deviation` refers to the measurements. `smoother` is None for an
    interpolated state. `outliers` is the number of rows with weight 0; this number and `robustness_weights` are None
    unless loess was robust; `has_heavy_tails` means that robust loess is advisable. `narrower_noise` is the noise by
    loess with the narrower span `narrower_span` (rows), which is used for the estimate of the bias. `points` (R,) are
    the values of the state at which the derivatives are estimated, if they differ from `values`.
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
    quantisation: StateQuantisation | None = None
    points: FloatArray | None = None

    @property
    def is_known(self) -> npt.NDArray[np.bool_]:
        """A mask (R,) of the rows at which the state is known: it was measured, or its other rows determine it."""
        return np.isfinite(self.total_uncertainty)

    @property
    def is_interpolated(self) -> bool:
        """Whether the state was interpolated: its noise is zero or negligible."""
        return self.smoother is None

    @property
    def span(self) -> int:
        """The largest number of rows on which the value or derivative of a row depends."""
        return STENCIL_ROWS if self.smoother is None else self.smoother.rows

    @property
    def relative_noise(self) -> float:
        """The measurement errors as a share of the state's standard deviation."""
        return self.noise / self.standard_deviation if self.standard_deviation > 0.0 else 0.0

    @property
    def target_noise(self) -> float:
        """The relative noise that the search assumes. It is 0.0 if the state is interpolated, or if the noise is too
        small to be determined."""
        is_free = self.is_interpolated or self.relative_noise < SETTINGS.smoothing.smallest_noise
        return 0.0 if is_free else self.relative_noise


@dataclass(frozen=True)
class Differentiation:
    """How states are differentiated.

    `order` is the order of the derivative, 1 or 2. `paper`: states are differentiated as in the paper, by loess of
    degree 2 and without interpolation. `robust`: outliers get weight 0.
    """

    order: Literal[1, 2] = 1
    paper: bool = False
    robust: bool = False

    @property
    def degrees(self) -> tuple[int, ...]:
        """The degrees of loess from which one is selected; Schmidt & Lipson 2008 use degree 2."""
        return (2,) if self.paper else SETTINGS.smoothing.degrees


def estimate_states(
    measurements: Measurements, weights: FloatArray | None, options: Differentiation
) -> list[StateEstimate]:
    """Return values and derivatives of the measured states.

    `weights` (R,) are inverse variances of the errors of each row, up to a factor; None: all are 1. Raises DataError if
    a state has too few values along every trajectory, or if its derivative is zero everywhere or out of the range of
    numbers.
    """
    assert measurements.trajectories is not None
    parts = [None if weights is None else weights[first:last] for first, last in measurements.ranges]
    estimates = []
    for state, along in measurements.trajectories.states.items():
        signals = [
            make_signal(times, values, part)
            for times, values, part in zip(measurements.trajectories.times, along, parts, strict=True)
        ]
        if not any(signal.is_long_enough for signal in _searched(signals, measurements.held_out)):
            few = SETTINGS.common.fewest_rows
            raise DataError(f"state '{state}' has fewer than {few} values along every trajectory; sample more of them")
        quantisation = find_quantisation(along)
        if quantisation is not None and is_refuted(quantisation, [part for part in signals if part.is_long_enough]):
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

    Each signal has at least 5 rows; if fewer of its rows were measured, the state is not known in the whole signal.
    Signals that are `held_out` do not influence any choice. An empty sequence means that no signal is held out. The
    standard deviation of the errors is at least `least_noise`.
    """
    # scaled by a power of two, so that squares of values of any size are finite
    _, exponent = math.frexp(max(float(np.max(np.abs(signal.values))) for signal in signals))
    scaled = [replace(signal, values=np.ldexp(signal.values, -exponent)) for signal in signals]
    least = math.ldexp(least_noise, -exponent)
    estimate = _by_loess_or_interpolation(scaled, options, held_out or [False] * len(signals), least)
    rescaled: dict[str, Any] = {}
    with np.errstate(over="ignore", under="ignore"):
        for name in ("values", "velocity", "derivative", "uncertainty", "total_uncertainty"):
            rescaled[name] = np.ldexp(getattr(estimate, name), exponent)
        for name in ("noise", "standard_deviation", "narrower_noise"):
            rescaled[name] = float(np.ldexp(getattr(estimate, name), exponent))
    return replace(estimate, **rescaled)


def _by_loess_or_interpolation(
    signals: Sequence[Signal], options: Differentiation, held_out: Sequence[bool], least: float
) -> StateEstimate:
    """Interpolate if noise is small and left-out rows are then predicted better than by loess; else use loess."""
    searched = [signal for signal in _searched(signals, held_out) if signal.is_long_enough]
    searched = [signal for signal in searched if signal.measured.values.any()] or searched
    smoother = select_smoother(searched, options.degrees)
    smoothed = [smooth(signal, smoother) for signal in searched]
    is_tailed = has_heavy_tails(searched, smoothed)
    is_weighted = any(signal.inverse_variances is not None for signal in signals)
    if not options.paper and not is_weighted and not (options.robust and is_tailed):
        errors, gains = predict_left_out([signal.measured for signal in searched])
        moving = are_moving([signal.measured.values for signal in searched])
        moving = moving if np.count_nonzero(moving) >= SETTINGS.common.fewest_rows else np.ones_like(moving)
        noise = max(estimate_value_noise(errors[moving], gains[moving]), least)
        deviation = _standard_deviation(searched)
        largest, shares = SETTINGS.smoothing.largest_noise * deviation, SETTINGS.smoothing.judged_shares
        if noise > largest:
            noise = max(estimate_value_noise(errors[moving], gains[moving], is_quiet=True), least)
            shares = (*shares, _QUIET_SHARE)
        if noise <= largest and is_interpolation_better(searched, errors, smoothed, shares):
            return _by_interpolation(signals, options.order, noise, deviation)
    fit = fit_robustly(searched, options.degrees) if options.robust else None
    if fit is None or not fit.outliers:
        return replace(_by_loess(signals, smoother, options.order, searched, least), has_heavy_tails=is_tailed)
    fitted = {id(signal): weighted for signal, weighted in zip(searched, fit.signals, strict=True)}
    weighted = [fitted.get(id(signal)) or weigh_by(fit, signal) for signal in signals]
    weights = [signal.robustness_weights for signal in weighted if signal.robustness_weights is not None]
    estimate = _by_loess(weighted, fit.smoother, options.order, fit.signals, least)
    return replace(estimate, outliers=fit.outliers, robustness_weights=np.concatenate(weights))


def _searched(signals: Sequence[Signal], held_out: Sequence[bool]) -> list[Signal]:
    return [signal for signal, is_held_out in zip(signals, held_out, strict=True) if not is_held_out]


def _standard_deviation(signals: Sequence[Signal]) -> float:
    return moments(np.concatenate([signal.values[signal.weights > 0.0] for signal in signals]))[1]


def _by_loess(
    signals: Sequence[Signal], smoother: Smoother, order: int, searched: Sequence[Signal], least: float
) -> StateEstimate:
    """Return the loess estimate of `signals`. The noise is estimated from the `searched` signals, and is at least
    `least`."""
    noise = max(estimate_noise(searched, smoother), least)
    smoothed = [smooth(signal, smoother) for signal in signals]
    fits = np.concatenate([part.fits for part in smoothed], axis=1)
    gains = np.concatenate([part.gains for part in smoothed], axis=1)
    span = max(int(_NARROWER * smoother.span), smoother.degree + 2)
    narrower = replace(smoother, span=span)
    narrower_noise = max(estimate_noise(searched, narrower), least)
    narrower_fits = np.concatenate([smooth(signal, narrower).fits for signal in signals], axis=1)
    bias = fits[order] - narrower_fits[order]
    uncertainty = noise * gains[order]
    total = np.sqrt(uncertainty * uncertainty + bias * bias)
    estimate = StateEstimate(
        fits[0], fits[1], fits[order], uncertainty, total, noise, _standard_deviation(searched), smoother,
        narrower_noise=narrower_noise, narrower_span=narrower.rows,
    )  # fmt: skip
    return _without_unknown(estimate, signals, gains[0])


def _by_interpolation(signals: Sequence[Signal], order: int, noise: float, deviation: float) -> StateEstimate:
    filled = [fill_missing(signal) for signal in signals]
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


def _without_unknown(estimate: StateEstimate, signals: Sequence[Signal], gains: FloatArray) -> StateEstimate:
    """Return the estimate with unknown rows marked: their uncertainty is infinite, their derivatives are 0, and their
    value is a value nearby.

    A missing value counts as known if its noise gain (R,) is at most 1: then the other rows determine the value at
    least as well as a measurement would.
    """
    if all(signal.is_measured is None for signal in signals):
        return estimate
    is_long = np.concatenate([np.full(len(signal.times), signal.is_long_enough) for signal in signals])
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


# -------------------------------------------------------------------------------------------------- scales of values


def bounded_standard_deviation(values: FloatArray, least: float = ROUNDING) -> float:
    """Return the standard deviation. If the values hardly vary, return `least` times the absolute value of the mean."""
    mean, deviation = moments(values)
    return max(deviation, least * abs(mean), SMALLEST)


def representable_standard_deviation(name: str, values: FloatArray) -> float:
    """Return the standard deviation; raises DataError if it is out of the range of numbers."""
    deviation = bounded_standard_deviation(values)
    check_size(name, deviation)
    return deviation


def derivative_standard_deviation(state: str, values: FloatArray) -> float:
    """Return the standard deviation of a state's derivative; raises DataError if it is zero or out of range."""
    if not values.any():
        raise DataError(
            f"state '{state}' is constant at all rows where it can be differentiated, like a state that is switched "
            f"between values, so its equation cannot be searched; make it an input with --inputs {state}"
        )
    return representable_standard_deviation(f"derivative of {state}", values)


# ------------------------------------------------------------------------------------------------------------ warm-up


def warm_up() -> list[FloatArray]:
    """Compile or load every kernel that preparing data needs, by running them on a few noisy and a few noise-free rows.

    Return what they estimated. Nothing is done for interpreted kernels (``NUMBA_DISABLE_JIT``). The first run on a
    machine takes some seconds.
    """
    if os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0"):
        return []
    numbers = np.arange(24.0)
    times = 0.1 * numbers
    noisy, clean = Signal(times, numbers * 31.0 % 47.0), Signal(times, 1.0 / (1.0 + times))
    estimates = [estimate_derivatives([signal], Differentiation()) for signal in (noisy, clean)]
    return [*(each.derivative for each in estimates), smooth(noisy, Smoother(5, 1, 0.0, thinning=2)).fits]
