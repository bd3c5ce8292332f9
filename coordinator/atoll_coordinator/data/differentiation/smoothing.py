"""Loess: local polynomials with tricube weights, whose span and degree are chosen by cross-validation; and robust
loess. Pure.

The slope of the local polynomial is the derivative (Schmidt & Lipson 2008). Span and degree are chosen for each state
by generalised cross-validation (GCV), pooled over its trajectories. If the span is wide, long signals are first
thinned: means of neighbouring rows replace the rows. So every row is used, and the work does not grow with the span.
GCV assumes independent errors. If errors are correlated from row to row, GCV chooses spans that are too narrow, and the
noise is underestimated.

Robust loess reduces the weight of rows far from the curve; outliers get weight 0 (Cleveland 1979, section 2). Cleveland
chooses span and degree once. Here they are chosen again for each set of weights, because outliers favour wide spans.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
import numpy.typing as npt

from atoll_coordinator.data.differentiation.kernels.loess import (
    DEGREES,
    loess_into,
    spread_into,
    thin_into,
    validate_into,
)
from atoll_coordinator.data.differentiation.kernels.stencils import moments
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray

LIMITS = SETTINGS.smoothing
REACH: Final = 6.0
"""Residuals larger than this many times the median residual have no weight (Cleveland 1979, section 2)."""
ROUNDS: Final = 6
"""Most rounds of robust loess. In each round, the weights follow from the residuals of the previous round; nearly all
fits converge earlier."""
_SPAN_RATIO: Final = 1.25
"""Ratio of a span to the previous span that was tried."""
_PATIENCE: Final = 5
"""After this number of spans without a better score, no wider spans are tried."""
_FEWEST_OUTLIERS: Final = 3
"""Tails are heavy if at least this many residuals are large and isolated. A smaller number may occur by chance."""
NORMAL_DEVIATION: Final = 1.4826
"""Standard deviation of normal errors, divided by the median of their absolute values: 1 / 0.6745."""
_LEAST_BINS: Final = LIMITS.bins // 2
"""A signal with at most this many rows is never thinned, and a longer signal keeps at least as many bins. This leaves
room for wide spans."""
_NARROW_SPANS: Final = tuple(LIMITS.bins // part for part in (4, 2, 1))
"""Spans, in rows, of fits without thinning. These fits show whether thinning has lost a fast wave."""
_MOST_LEVERAGE: Final = 0.999
"""Guard: a smoother whose mean leverage is at least this value reproduces the data, so it has no score."""


@dataclass(frozen=True, eq=False)
class Signal:
    """One state along one trajectory: strictly ascending `times` and `values`, both (R,).

    `robustness_weights` (R,), from 0 to 1, are low for rows far from the curve of the other rows; `inverse_variances`
    (R,), positive, are inverse variances of the errors of each row, up to a factor; `is_measured` (R,) is 1, or 0 if a
    value is missing and `values` has a substitute. If one of these three arrays is None, all its elements are 1.
    """

    times: FloatArray
    values: FloatArray
    robustness_weights: FloatArray | None = None
    inverse_variances: FloatArray | None = None
    is_measured: FloatArray | None = None

    @cached_property
    def measured_rows(self) -> npt.NDArray[np.bool_]:
        """Whether each row was measured, (R,)."""
        return np.ones(len(self.times), np.bool_) if self.is_measured is None else self.is_measured > 0.0

    @cached_property
    def measured(self) -> "Signal":
        """The signal with only the measured rows. If no row is missing, this is the same object."""
        if self.is_measured is None:
            return self
        rows, factors = self.measured_rows, (self.robustness_weights, self.inverse_variances)
        return Signal(self.times[rows], self.values[rows], *(part if part is None else part[rows] for part in factors))

    @property
    def is_long_enough(self) -> bool:
        """Whether enough rows were measured for a derivative."""
        return len(self.measured.times) >= SETTINGS.common.fewest_rows

    @cached_property
    def filled_inverse_variances(self) -> FloatArray:
        """The inverse variance of each row's errors, (R,)."""
        return np.ones(len(self.times)) if self.inverse_variances is None else self.inverse_variances

    @cached_property
    def weights(self) -> FloatArray:
        """The weight of each row, (R,): its inverse variance times its robustness weight. The weight of a missing value
        is 0."""
        weights = self.filled_inverse_variances
        for factor in (self.robustness_weights, self.is_measured):
            weights = weights if factor is None else factor * weights
        return weights


@dataclass(frozen=True)
class Smoother:
    """A loess smoother: its `span` in bins, the `degree` of its polynomials, and its score (a lower score is better).

    A bin has `thinning` rows on average; this number is 1 unless there are many rows.
    """

    span: int
    degree: int
    score: float
    thinning: int = 1

    @property
    def rows(self) -> int:
        """The span in rows."""
        return self.span * self.thinning


@dataclass(frozen=True, eq=False)
class SmoothedSignal:
    """Loess of one signal.

    `fits` (3, R) are the value, the slope and the curvature. `gains` (4, R) are the noise gains of these three, then
    the leverage. A noise gain is the standard error of a fit, divided by the standard deviation of the errors in a row
    of weight 1.
    """

    fits: FloatArray
    gains: FloatArray


def smooth(signal: Signal, smoother: Smoother) -> SmoothedSignal:
    """Return the loess fit of one signal by `smoother`; the degree is reduced for a short signal."""
    bins, share = _thin(signal, smoother.thinning)
    count, rows = len(bins.times), len(signal.times)
    of_bins = SmoothedSignal(np.empty((3, count)), np.empty((4, count)))
    degree = min(smoother.degree, count - 2)
    window = max(round(smoother.span / share), degree + 2), degree + 1
    weights = bins.weights, bins.filled_inverse_variances
    loess_into(of_bins.fits, of_bins.gains, bins.times, bins.values, *weights, *window)
    if smoother.thinning == 1:
        return of_bins
    smoothed = SmoothedSignal(np.empty((3, rows)), np.empty((4, rows)))
    spread_into(smoothed.fits, smoothed.gains, signal.times, bins.times, of_bins.fits, of_bins.gains)
    return smoothed


def _thin(signal: Signal, thinning: int) -> tuple[Signal, float]:
    """Return means over bins of about `thinning` rows, and the ratio of the rows in a bin to `thinning`. If `thinning`
    is 1, return the signal itself.

    A short signal is thinned less: then the ratio is below 1, and a span has more bins.
    """
    if thinning == 1:
        return signal, 1.0
    rows = len(signal.times)
    bins = max(rows // thinning, min(rows, _LEAST_BINS))
    share = rows / bins / thinning if bins > rows // thinning else 1.0
    times, values, weights, inverse_variances = np.empty((4, bins))
    thin_into(times, values, inverse_variances, signal.times, signal.values, signal.filled_inverse_variances)
    thin_into(times, values, weights, signal.times, signal.values, signal.weights)
    return Signal(times, values, share * weights / inverse_variances, inverse_variances), share


def estimate_noise(signals: Sequence[Signal], smoother: Smoother) -> float:
    """Return the standard deviation of the errors in a row of inverse variance 1, estimated from the residuals of
    loess.

    The variance is the sum of squared residuals divided by the degrees of freedom (Cleveland & Devlin 1988, section 3).
    These are the number of rows, minus twice the trace of the smoother's matrix, plus the trace of its square. Rows
    without weight do not count.
    """
    squares, degrees_of_freedom = 0.0, 0.0
    for signal in signals:
        fit, inverse_variances = smooth(signal, smoother), signal.filled_inverse_variances
        residuals, weights = (signal.values - fit.fits[0]).tolist(), signal.weights.tolist()
        row_degrees_of_freedom = (1.0 - 2.0 * fit.gains[3] + inverse_variances * fit.gains[0] * fit.gains[0]).tolist()
        rows = zip(residuals, weights, inverse_variances.tolist(), row_degrees_of_freedom, strict=True)
        for residual, weight, inverse_variance, free in rows:
            if weight > 0.0:
                squares += inverse_variance * residual * residual
                degrees_of_freedom += free
    return math.sqrt(squares / max(degrees_of_freedom, 1.0))


# --------------------------------------------------------------------------------------------------- span and degree


def select_smoother(signals: Sequence[Signal], degrees: Sequence[int]) -> Smoother:
    """Return the smoother with the least generalised cross-validation score, pooled over `signals`.

    The score (Craven & Wahba 1979, eq. 1.9) is the mean squared residual, divided by the squared mean of (1 -
    leverage). Both means are weighted.
    """
    rows = [len(signal.times) for signal in signals]
    thinning = max(1, min(sum(rows) // SETTINGS.rows.most, max(rows) // (_LEAST_BINS * LIMITS.bins)))
    while True:
        parts = [_thin(signal, thinning) for signal in signals]
        lengths = [len(signal.times) for signal, _ in parts]
        every = -(-sum(lengths) // (2 * SETTINGS.rows.most))
        best, since, span = Smoother(0, 0, math.inf), 0, SETTINGS.common.fewest_rows
        while True:
            here = _score_degrees(parts, span, every, degrees)
            since = 0 if here.score < best.score else since + 1
            best = here if here.score < best.score else best
            is_over = since >= _PATIENCE and math.isfinite(best.score)
            # a span may exceed the longest trajectory: the bandwidth still grows
            if is_over or span >= 3 * max(lengths):
                break
            span = max(span + 1, int(span * _SPAN_RATIO))
        best = replace(best, thinning=thinning)
        if thinning == 1 or (best.span >= LIMITS.bins and _is_resolved(signals, best, degrees)):
            return best
        thinning = max(1, thinning // 2)


def _is_resolved(signals: Sequence[Signal], smoother: Smoother, degrees: Sequence[int]) -> bool:
    """Tell whether thinning has kept all fast waves. For this, the fit is compared with loess of all rows with narrow
    spans."""
    if not math.isfinite(smoother.score):
        return False
    whole = [(signal, 1.0) for signal in signals]
    narrow = min(_score_degrees(whole, span, 1, degrees).score for span in _NARROW_SPANS)
    squares, count = 0.0, 0.0
    for signal in signals:
        residuals = (signal.values - smooth(signal, smoother).fits[0]).tolist()
        for residual, weight in zip(residuals, signal.weights.tolist(), strict=True):
            squares += weight * residual * residual
            count += weight
    return squares <= narrow * count


def _score_degrees(parts: Sequence[tuple[Signal, float]], span: int, every: int, degrees: Sequence[int]) -> Smoother:
    sums = np.zeros((3, DEGREES))
    for signal, share in parts:
        validate_into(sums, signal.times, signal.values, signal.weights, round(span / share), every)
    smoothers = []
    for degree in degrees:
        residuals, leverages, count = sums[:, degree].tolist()
        score = math.inf
        if count > 0.0 and math.isfinite(residuals / count) and leverages / count < _MOST_LEVERAGE:
            score = residuals / count / ((1.0 - leverages / count) * (1.0 - leverages / count))
        smoothers.append(Smoother(span, degree, score))
    return min(smoothers, key=lambda smoother: smoother.score)


# ------------------------------------------------------------------------------------------------------- robust loess


@dataclass(frozen=True, eq=False)
class RobustFit:
    """Signals with robustness weights, the smoother that was selected with these weights, and the median residual from
    which the weights follow."""

    signals: tuple[Signal, ...]
    smoother: Smoother
    median: float

    @property
    def outliers(self) -> int:
        """Number of measured rows without weight."""
        return sum(signal.measured.weights.tolist().count(0.0) for signal in self.signals)


def fit_robustly(signals: Sequence[Signal], degrees: Sequence[int]) -> RobustFit:
    """Return `signals` with robustness weights: rows far from the curve have low weights, and outliers have weight
    0."""
    fit = RobustFit(tuple(signals), select_smoother(signals, degrees), 0.0)
    least = SETTINGS.common.clean * moments(np.concatenate([signal.measured.values for signal in signals]))[1]
    for _ in range(ROUNDS):
        residuals = _residuals(fit.signals, [smooth(signal, fit.smoother) for signal in fit.signals])
        median = max(_median(residuals, signals), least)
        if not median > 0.0:
            break
        weighted = tuple(_weigh(signal, part, median) for signal, part in zip(signals, residuals, strict=True))
        before, fit = fit.outliers, RobustFit(weighted, select_smoother(weighted, degrees), median)
        if fit.outliers == before:
            break
    return fit


def weigh_by(fit: RobustFit, signal: Signal) -> Signal:
    """Return another signal with robustness weights computed by the smoother and the median residual of `fit`.

    Precondition: `fit` has outliers, so that its median residual is not zero.
    """
    for _ in range(ROUNDS):
        (residuals,) = _residuals([signal], [smooth(signal, fit.smoother)])
        signal = _weigh(signal, residuals, fit.median)
    return signal


def has_heavy_tails(signals: Sequence[Signal], smoothed: Sequence[SmoothedSignal]) -> bool:
    """Tell whether some isolated rows are so far from the curve that the noise of the other rows does not explain their
    distance."""
    residuals = _residuals(signals, smoothed)
    limit = REACH * NORMAL_DEVIATION * _median(residuals, signals)
    count = 0
    for part in residuals:
        sizes = [0.0, *np.abs(part).tolist(), 0.0]
        for before, size, after in zip(sizes, sizes[1:], sizes[2:], strict=False):
            count += size > limit and max(before, after) <= 0.5 * size
    rows = sum(len(part) for part in residuals)
    return limit > 0.0 and count >= max(_FEWEST_OUTLIERS, rows / LIMITS.rows_per_outlier)


def _residuals(signals: Sequence[Signal], smoothed: Sequence[SmoothedSignal]) -> list[FloatArray]:
    """Return the residuals, each divided by the standard deviation of the errors of its row, up to a common factor. The
    residual of a missing value is 0."""
    return [
        (signal.values - fit.fits[0]) * signal.measured_rows * np.sqrt(signal.filled_inverse_variances)
        for signal, fit in zip(signals, smoothed, strict=True)
    ]


def _median(residuals: Sequence[FloatArray], signals: Sequence[Signal]) -> float:
    measured = [part[signal.measured_rows] for part, signal in zip(residuals, signals, strict=True)]
    ordered = np.sort(np.abs(np.concatenate(measured)))
    return float(ordered[len(ordered) // 2])


def _weigh(signal: Signal, residuals: FloatArray, median: float) -> Signal:
    """Return `signal` with bisquare weights (Cleveland 1979, section 2)."""
    shares = residuals / (REACH * median)
    rest = np.maximum(1.0 - shares * shares, 0.0)
    return replace(signal, robustness_weights=rest * rest)
