"""Values, derivatives and their uncertainty along trajectories, for one state at a time (pure).

Noisy states are smoothed by loess. Where leaving rows out shows that the data follow local polynomials of high order
better than any smoother (there is no noise to speak of), they are interpolated instead. Rows of different weights say
that there is noise.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from atoll.data.dataset import FloatArray
from atoll_coordinator.data.differentiation.interpolation import (
    STENCIL_ROWS,
    estimate_value_noise,
    interpolate_derivative,
    is_interpolation_better,
    predict_left_out,
)
from atoll_coordinator.data.differentiation.kernels.stencils import moments
from atoll_coordinator.data.differentiation.robust import fit_robustly, has_heavy_tails, weigh_by
from atoll_coordinator.data.differentiation.smoothing import (
    Signal,
    SmoothedSignal,
    Smoother,
    estimate_noise,
    select_smoother,
    smooth,
)
from atoll_coordinator.data.differentiation.standard_deviation import derivative_standard_deviation
from atoll_coordinator.data.settings import SETTINGS
from atoll_coordinator.data.trajectories.measurements import Measurements


@dataclass(frozen=True, eq=False)
class StateEstimate:
    """What is known of one state over all its rows, in the order of the signals. All arrays are (R,).

    `values` are interpolated (as measured) or smoothed; `derivative` is the one sought, `velocity` the first one;
    `uncertainty` is the standard error of `derivative`, and `total_uncertainty` the root of its square and that of the
    estimated bias (where the state was interpolated, the same as `uncertainty`). `noise` is the estimated standard
    deviation of the measurement errors and `standard_deviation` that of the measurements; `smoother` is None where the
    state was interpolated. `outliers`, how many rows have no weight, and `robustness_weights` are None unless loess was
    robust; `has_heavy_tails` advises that it should be. `narrower_noise` is the noise by loess with the narrower span,
    `narrower_span` (rows), by which the bias is estimated.
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
        """Degrees of loess among which one is selected."""
        return SETTINGS.smoothing.paper_degrees if self.paper else SETTINGS.smoothing.degrees


def estimate_states(
    measurements: Measurements, weights: FloatArray | None, options: Differentiation
) -> list[StateEstimate]:
    """Return values and derivatives of the measured states.

    Args:
        measurements: with trajectories.
        weights: inverse variances of the errors of each row, up to a factor; None: all are 1.
        options: how.

    Raises:
        DataError: the derivative of a state is zero everywhere, or beyond the range of numbers.
    """
    assert measurements.trajectories is not None
    parts = [None if weights is None else weights[first:last] for first, last in measurements.ranges]
    estimates = []
    for state, along in measurements.trajectories.states.items():
        signals = [
            Signal(times, values, inverse_variances=part)
            for times, values, part in zip(measurements.trajectories.times, along, parts, strict=True)
        ]
        estimates.append(estimate_derivatives(signals, options, measurements.held_out))
        derivative_standard_deviation(state, estimates[-1].derivative)
    return estimates


def estimate_derivatives(
    signals: Sequence[Signal], options: Differentiation, held_out: Sequence[bool] = ()
) -> StateEstimate:
    """Return values and derivatives of one state, over all rows of all signals.

    Args:
        signals: the state along each trajectory, 5 rows or more each.
        options: how.
        held_out: for each signal, whether it takes no part in any choice; empty: all do.
    """
    _, exponent = math.frexp(max(float(np.max(np.abs(signal.values))) for signal in signals))
    scaled = [replace(signal, values=np.ldexp(signal.values, -exponent)) for signal in signals]
    return _rescale(_estimate(scaled, options, held_out or [False] * len(signals)), exponent)


def _rescale(estimate: StateEstimate, exponent: int) -> StateEstimate:
    """Return the estimate of values 2**exponent times as large: values of any size have squares in between."""
    arrays = ("values", "velocity", "derivative", "uncertainty", "total_uncertainty")
    with np.errstate(over="ignore", under="ignore"):
        scaled: dict[str, Any] = {name: np.ldexp(getattr(estimate, name), exponent) for name in arrays}
        for name in ("noise", "standard_deviation", "narrower_noise"):
            scaled[name] = float(np.ldexp(getattr(estimate, name), exponent))
    return replace(estimate, **scaled)


def _estimate(signals: Sequence[Signal], options: Differentiation, held_out: Sequence[bool]) -> StateEstimate:
    searched = [signal for signal, is_held_out in zip(signals, held_out, strict=True) if not is_held_out]
    smoother = select_smoother(searched, options.degrees)
    smoothed = [smooth(signal, smoother) for signal in searched]
    is_tailed = has_heavy_tails(searched, smoothed)
    is_weighted = any(signal.inverse_variances is not None for signal in signals)
    if not options.paper and not is_weighted and not (options.robust and is_tailed):
        errors, gains = predict_left_out(searched)
        noise, deviation = estimate_value_noise(errors, gains), _standard_deviation(searched)
        is_small = noise <= SETTINGS.interpolation.largest_noise * deviation
        if is_small and is_interpolation_better(searched, errors, smoothed):
            return _interpolate(signals, options.order, noise, deviation)
    fit = fit_robustly(searched, options.degrees) if options.robust else None
    if fit is None or not fit.outliers:
        return replace(_by_loess(signals, smoother, options.order, searched), has_heavy_tails=is_tailed)
    rest = iter(fit.signals)
    weighted = [weigh_by(fit, signal) if out else next(rest) for signal, out in zip(signals, held_out, strict=True)]
    given = [signal.robustness_weights for signal in weighted]
    weights = [
        np.ones(len(signal.times)) if each is None else each for signal, each in zip(weighted, given, strict=True)
    ]
    estimate = _by_loess(weighted, fit.smoother, options.order, fit.signals)
    return replace(estimate, outliers=fit.outliers, robustness_weights=np.concatenate(weights))


def _by_loess(signals: Sequence[Signal], smoother: Smoother, order: int, searched: Sequence[Signal]) -> StateEstimate:
    """Return what loess gives of `signals`, with the noise of those `searched`."""
    noise = estimate_noise(searched, [smooth(signal, smoother) for signal in searched])
    fits, gains = _joined([smooth(signal, smoother) for signal in signals])
    span = max(int(SETTINGS.smoothing.narrower * smoother.span), smoother.degree + 2)
    narrower = replace(smoother, span=span)
    narrower_noise = estimate_noise(searched, [smooth(signal, narrower) for signal in searched])
    narrower_fits, _ = _joined([smooth(signal, narrower) for signal in signals])
    bias = fits[order] - narrower_fits[order]
    uncertainty = noise * gains[order]
    total = np.sqrt(uncertainty * uncertainty + bias * bias)
    return StateEstimate(
        fits[0], fits[1], fits[order], uncertainty, total, noise, _standard_deviation(searched), smoother,
        narrower_noise=narrower_noise, narrower_span=narrower.rows,
    )  # fmt: skip


def _joined(smoothed: Sequence[SmoothedSignal]) -> tuple[FloatArray, FloatArray]:
    """Return fits and gains over the rows of all signals."""
    fits = np.concatenate([each.fits for each in smoothed], axis=1)
    return fits, np.concatenate([each.gains for each in smoothed], axis=1)


def _standard_deviation(signals: Sequence[Signal]) -> float:
    """Return the standard deviation of all values but outliers."""
    return moments(np.concatenate([signal.values[signal.weights > 0.0] for signal in signals]))[1]


def _interpolate(signals: Sequence[Signal], order: int, noise: float, deviation: float) -> StateEstimate:
    velocity, uncertainty = interpolate_derivative(signals, 1, noise)
    derivative = velocity
    if order == 2:
        derivative, uncertainty = interpolate_derivative(signals, 2, noise)
    values = np.concatenate([signal.values for signal in signals])
    return StateEstimate(values, velocity, derivative, uncertainty, uncertainty, noise, deviation, None)
