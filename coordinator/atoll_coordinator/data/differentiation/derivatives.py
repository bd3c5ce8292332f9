"""Values, derivatives and their uncertainty along trajectories, for one state at a time (pure).

Noisy states are smoothed by loess. Where leaving rows out shows that the data follow local polynomials of high order
better than any smoother (there is no noise to speak of), they are interpolated instead: the derivative is that of the
polynomial through the 3 to 15 nearest rows, each row taking the stencil whose step from the next narrower one is least
(weights by Fornberg 1988, good for uneven steps). That difference between two orders is the row's uncertainty. Rows of
different weights say that there is noise.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np

from atoll.data.dataset import FloatArray
from atoll_coordinator.data.differentiation.kernels.stencils import (
    HALF_WIDTHS,
    best_stencil_into,
    differences_into,
    left_out_into,
    moments,
)
from atoll_coordinator.data.differentiation.robust import has_heavy_tails, outliers, retrusted, trusted
from atoll_coordinator.data.differentiation.smoothing import Choice, Run, Smoothed, choose, noise_of, smooth

DEGREES_TRIED: Final = (3, 4)
"""By values alone a parabola passes for a cubic, but its slope has far more bias: measured, the derivative error was up
to 2.8 times the standard error with it and up to 1.9 times without."""
PAPER_DEGREES: Final = (2,)
END_ROWS: Final = 4
"""Rows at each end of a trajectory whose derivatives by interpolation are much worse than the others'."""
TRIMMED_LENGTH: Final = 20
"""Shortest trajectory whose ends are left out."""
JUDGED_SHARES: Final = (0.95, 0.75)
"""Shares of the rows, the best ones, by which interpolation and smoothing are compared: jumps must not decide, nor must
rows at rest. Without noise interpolation wins by either; with noise it loses by a factor near 1.5 by both."""
SMALLEST_NOISE: Final = 1e-9
"""Noise, as a share of the state's standard deviation, below which data count as free of it."""
NARROWER: Final = 0.6
"""The bias of a derivative is told by its difference from that with a span as many times as wide."""
LARGEST_NOISE: Final = 3e-4
"""Noise, as a share of the state's standard deviation, beyond which data are never interpolated."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """What is known of one state over all its rows, in the order of the runs. All arrays are (R,).

    `values` are interpolated (as measured) or smoothed; `derivative` is the one sought, `velocity` the first one;
    `uncertainty` belongs to `derivative`, and so does `doubt`, the uncertainty with an estimate of the bias, zeros
    where the state was interpolated. `error` is the estimated standard deviation of the measurement errors and
    `deviation` that of the measurements; `choice` is None where the state was interpolated. `outliers`, how many
    rows have no weight, and `trust` (R,), the weights, are None unless loess was robust; `has_heavy_tails` advises that
    it should be.
    """

    values: FloatArray
    velocity: FloatArray
    derivative: FloatArray
    uncertainty: FloatArray
    doubt: FloatArray
    error: float
    deviation: float
    choice: Choice | None
    outliers: int | None = None
    trust: FloatArray | None = None
    has_heavy_tails: bool = False

    @property
    def interpolated(self) -> bool:
        """Whether the data are free of noise, or nearly."""
        return self.choice is None

    @property
    def relative(self) -> float:
        """The measurement errors as a share of the state's standard deviation."""
        return self.error / self.deviation if self.deviation > 0.0 else 0.0

    @property
    def noise(self) -> float:
        """The relative noise that the search reckons with: 0.0 when interpolated, or below what can be told."""
        return 0.0 if self.interpolated or self.relative < SMALLEST_NOISE else self.relative


@dataclass(frozen=True)
class Way:
    """How a state is differentiated.

    `order` is 1 or 2, the derivative sought; `paper`: as in the paper, loess of degree 2 and no interpolation;
    `robust`: outliers lose their weight.
    """

    order: Literal[1, 2] = 1
    paper: bool = False
    robust: bool = False

    @property
    def degrees(self) -> tuple[int, ...]:
        """Degrees of loess among which one is chosen."""
        return PAPER_DEGREES if self.paper else DEGREES_TRIED


def estimate(runs: Sequence[Run], way: Way, held_out: Sequence[bool] = ()) -> Estimate:
    """Return values and derivatives of one state, over all rows of all runs.

    Args:
        runs: the state along each trajectory, 5 rows or more each.
        way: how.
        held_out: for each run, whether it takes no part in any choice; empty: all do.
    """
    _, exponent = math.frexp(max(float(np.max(np.abs(run.values))) for run in runs))
    scaled = [replace(run, values=np.ldexp(run.values, -exponent)) for run in runs]
    return _rescaled(_estimate(scaled, way, held_out or [False] * len(runs)), exponent)


def _rescaled(its: Estimate, exponent: int) -> Estimate:
    """Return the estimate of values 2**exponent times as large: values of any size have squares in between."""
    with np.errstate(over="ignore", under="ignore"):
        return replace(
            its,
            values=np.ldexp(its.values, exponent),
            velocity=np.ldexp(its.velocity, exponent),
            derivative=np.ldexp(its.derivative, exponent),
            uncertainty=np.ldexp(its.uncertainty, exponent),
            doubt=np.ldexp(its.doubt, exponent),
            error=float(np.ldexp(its.error, exponent)),
            deviation=float(np.ldexp(its.deviation, exponent)),
        )


def _estimate(runs: Sequence[Run], way: Way, held_out: Sequence[bool]) -> Estimate:
    seen = [run for run, is_held_out in zip(runs, held_out, strict=True) if not is_held_out]
    choice = choose(seen, way.degrees)
    smoothed = [smooth(run, choice) for run in seen]
    is_tailed = has_heavy_tails(seen, smoothed)
    is_weighed = any(run.precision is not None for run in runs)
    if not way.paper and not is_weighed and not (way.robust and is_tailed):
        errors, gains = _left_out(seen)
        noise = _value_noise(errors, gains)
        if noise <= LARGEST_NOISE * _deviation(seen) and _is_better(seen, errors, smoothed):
            return _interpolated(runs, way.order, noise, _deviation(seen))
    its = trusted(seen, way.degrees) if way.robust else None
    if its is None or not outliers(its.runs):
        return replace(_by_loess(runs, choice, way, seen), has_heavy_tails=is_tailed)
    rest = iter(its.runs)
    weighed = [retrusted(run, its) if out else next(rest) for run, out in zip(runs, held_out, strict=True)]
    trust = np.concatenate([np.ones(len(run.times)) if run.trust is None else run.trust for run in weighed])
    return replace(_by_loess(weighed, its.choice, way, its.runs), outliers=outliers(its.runs), trust=trust)


def end_rows(lengths: Sequence[int]) -> FloatArray:
    """Return 1.0 at rows that stand at the ends of long enough trajectories, else 0.0."""
    ends = np.zeros(sum(lengths))
    first = 0
    for length in lengths:
        if length >= TRIMMED_LENGTH:
            ends[first : first + END_ROWS] = 1.0
            ends[first + length - END_ROWS : first + length] = 1.0
        first += length
    return ends


def _by_loess(runs: Sequence[Run], choice: Choice, way: Way, seen: Sequence[Run]) -> Estimate:
    """Return what loess gives of `runs`, with the noise that is `seen`."""
    noise = noise_of(seen, [smooth(run, choice) for run in seen])
    fits, gains = _joined([smooth(run, choice) for run in runs])
    narrower = replace(choice, span=max(int(NARROWER * choice.span), choice.degree + 2))
    apart = fits[way.order] - _joined([smooth(run, narrower) for run in runs])[0][way.order]
    uncertainty = noise * gains[way.order]
    doubt = np.sqrt(uncertainty * uncertainty + apart * apart)
    return Estimate(fits[0], fits[1], fits[way.order], uncertainty, doubt, noise, _deviation(seen), choice)


def _joined(smoothed: Sequence[Smoothed]) -> tuple[FloatArray, FloatArray]:
    """Return fits and gains over the rows of all runs."""
    fits = np.concatenate([its.fits for its in smoothed], axis=1)
    return fits, np.concatenate([its.gains for its in smoothed], axis=1)


def _deviation(runs: Sequence[Run]) -> float:
    """Return the standard deviation of all values but outliers."""
    return moments(np.concatenate([run.values[run.weights > 0.0] for run in runs]))[1]


def _left_out(runs: Sequence[Run]) -> tuple[FloatArray, FloatArray]:
    """Return errors of predicting each row from its neighbours, and their noise gains, both (R, H)."""
    errors, gains = [], []
    for run in runs:
        shape = (len(run.times), HALF_WIDTHS)
        errors.append(np.empty(shape))
        gains.append(np.empty(shape))
        left_out_into(errors[-1], gains[-1], run.times, run.values)
    return np.concatenate(errors), np.concatenate(gains)


def _is_better(runs: Sequence[Run], errors: FloatArray, smoothed: Sequence[Smoothed]) -> bool:
    """Say whether interpolation predicts rows that are left out better than loess does."""
    inner = end_rows([len(run.times) for run in runs]) == 0.0
    by_loess = _loess_errors(runs, smoothed)[inner]
    for share in JUDGED_SHARES:
        typical = min(_typical(errors[inner, width], share) for width in range(HALF_WIDTHS))
        if typical < _typical(by_loess, share):
            return True
    return False


def _loess_errors(runs: Sequence[Run], smoothed: Sequence[Smoothed]) -> FloatArray:
    """Return the leave-one-out errors (R,) of loess: residual / (1 - leverage)."""
    values = np.concatenate([run.values for run in runs])
    fits = np.concatenate([its.fits[0] for its in smoothed])
    leverages = np.concatenate([its.gains[3] for its in smoothed])
    errors: FloatArray = (values - fits) / np.maximum(1.0 - leverages, 1e-12)
    return errors


def _typical(errors: FloatArray, share: float) -> float:
    """Return the root mean square of the smallest errors; infinite when not all of them are finite."""
    ordered = np.sort(np.abs(errors))[: max(1, int(share * len(errors)))]
    mean, deviation = moments(ordered)
    typical = math.sqrt(mean * mean + deviation * deviation)
    return typical if math.isfinite(typical) else math.inf


def _value_noise(errors: FloatArray, gains: FloatArray) -> float:
    """Return an upper estimate of the values' noise: the median left-out error over its gain, at the best width."""
    noises = np.sort(np.abs(errors) / gains, axis=0)[len(errors) // 2]
    return min(float(noise) for noise in noises if not math.isnan(float(noise)))


def _interpolated(runs: Sequence[Run], order: int, noise: float, deviation: float) -> Estimate:
    velocity, uncertainty = _differentiated(runs, 1, noise)
    derivative = velocity
    if order == 2:
        derivative, uncertainty = _differentiated(runs, 2, noise)
    values = np.concatenate([run.values for run in runs])
    return Estimate(values, velocity, derivative, uncertainty, np.zeros(len(values)), noise, deviation, None)


def _differentiated(runs: Sequence[Run], order: int, noise: float) -> tuple[FloatArray, FloatArray]:
    """Return the derivative of the given order and its uncertainty, over all rows."""
    derivatives, uncertainties = [], []
    for run in runs:
        rows = len(run.times)
        slopes, gains = np.empty((rows, HALF_WIDTHS)), np.empty((rows, HALF_WIDTHS))
        differences_into(slopes, gains, run.times, run.values, order)
        derivatives.append(np.empty(rows))
        uncertainties.append(np.empty(rows))
        rounding = np.maximum(noise, 2.0**-53 * np.abs(run.values))
        best_stencil_into(derivatives[-1], uncertainties[-1], slopes, gains, rounding)
    return np.concatenate(derivatives), np.concatenate(uncertainties)
