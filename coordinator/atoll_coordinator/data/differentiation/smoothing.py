"""Loess: local polynomials with tricube weights, their span and degree chosen by cross-validation (pure).

Schmidt & Lipson 2008 take the slope of such a fit as the derivative. Here span and degree are chosen per state by
generalised cross-validation pooled over its trajectories. Many rows are thinned first, where the span is so wide that
means of neighbours tell as much as they do: every row counts, and the work does not grow with the span.
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
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray

LIMITS = SETTINGS.smoothing
_LEAST_BINS: Final = LIMITS.least_bins_in_span // 2
"""A signal of no more rows than this is never thinned, a longer one never to fewer bins: spans may be wider."""
_NARROW_SPANS: Final = tuple(LIMITS.least_bins_in_span // part for part in (4, 2, 1))
"""Spans in rows, by which it is judged whether thinning has lost a fast wave."""
_MOST_LEVERAGE: Final = 0.999
"""Guard: from this mean leverage on a smoother reproduces the data and has no score."""


@dataclass(frozen=True, eq=False)
class Signal:
    """One state along one trajectory: strictly ascending `times` and `values`, both (R,).

    `robustness_weights` (R,), from 0 to 1, are low where a row is far from the curve of the others; `inverse_variances`
    (R,), positive, are those of the errors of each row, up to a factor; `is_measured` (R,) is 0 where a value is
    missing, and some number stands in for it, else 1; None: all are 1.
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
        """The rows that were measured; the same object where none is missing."""
        if self.is_measured is None:
            return self
        rows, factors = self.measured_rows, (self.robustness_weights, self.inverse_variances)
        return Signal(self.times[rows], self.values[rows], *(part if part is None else part[rows] for part in factors))

    @cached_property
    def filled_inverse_variances(self) -> FloatArray:
        """The inverse variance of each row's errors, (R,)."""
        return np.ones(len(self.times)) if self.inverse_variances is None else self.inverse_variances

    @cached_property
    def weights(self) -> FloatArray:
        """The weight of each row, (R,): its inverse variance times its robustness weight, 0 where it is missing."""
        weights = self.filled_inverse_variances
        for factor in (self.robustness_weights, self.is_measured):
            weights = weights if factor is None else factor * weights
        return weights


@dataclass(frozen=True)
class Smoother:
    """A loess smoother: the `span` in bins, the `degree` of its polynomials, its score (lower is better).

    A bin is `thinning` rows on average: 1 unless there are many.
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
    """Loess of one signal: `fits` (3, R) value, slope, curvature; `gains` (4, R) their noise gains and the leverage.

    A noise gain is the standard error of a fit over the standard deviation of the errors in a row of weight 1.
    """

    fits: FloatArray
    gains: FloatArray


def select_smoother(signals: Sequence[Signal], degrees: Sequence[int]) -> Smoother:
    """Return the smoother of least generalised cross-validation score, pooled over `signals`.

    Craven & Wahba 1979, eq. 1.9: mean squared residual over the squared mean of (1 - leverage), both weighted.
    """
    rows = [len(signal.times) for signal in signals]
    thinning = max(1, min(sum(rows) // SETTINGS.rows.most, max(rows) // (_LEAST_BINS * LIMITS.least_bins_in_span)))
    while True:
        best = _best_smoother([_thin(signal, thinning) for signal in signals], degrees)
        best = replace(best, thinning=thinning)
        if thinning == 1 or (best.span >= LIMITS.least_bins_in_span and _is_resolved(signals, best, degrees)):
            return best
        thinning = max(1, thinning // 2)


def _is_resolved(signals: Sequence[Signal], smoother: Smoother, degrees: Sequence[int]) -> bool:
    """Say whether thinned rows are followed as well as rows are by narrow spans: a fast wave may vanish in means."""
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


def _thin(signal: Signal, thinning: int) -> tuple[Signal, float]:
    """Return means over bins of `thinning` rows, for 1 the signal itself, and how wide they are as a share of that.

    A short signal is thinned less: there the share is below 1, and a span of so many bins as asked for has more.
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


def _best_smoother(parts: Sequence[tuple[Signal, float]], degrees: Sequence[int]) -> Smoother:
    lengths = [len(signal.times) for signal, _ in parts]
    every = -(-sum(lengths) // (2 * SETTINGS.rows.most))
    best = Smoother(0, 0, math.inf)
    since = 0
    for span in _spans(max(lengths)):
        here = _score_degrees(parts, span, every, degrees)
        since = 0 if here.score < best.score else since + 1
        best = here if here.score < best.score else best
        if since >= LIMITS.patience and math.isfinite(best.score):
            break
    return best


def _spans(longest: int) -> list[int]:
    """Return the spans tried: beyond the longest trajectory the bandwidth goes on growing for a while."""
    spans = [SETTINGS.checks.min_rows]
    while spans[-1] < 3 * longest:
        spans.append(max(spans[-1] + 1, int(spans[-1] * LIMITS.span_ratio)))
    return spans


def _score_degrees(parts: Sequence[tuple[Signal, float]], span: int, every: int, degrees: Sequence[int]) -> Smoother:
    """Return the best of `degrees` at one span."""
    sums = np.zeros((3, DEGREES))
    for signal, share in parts:
        validate_into(sums, signal.times, signal.values, signal.weights, round(span / share), every)
    smoothers = (Smoother(span, degree, _score(sums[:, degree])) for degree in degrees)
    return min(smoothers, key=lambda smoother: smoother.score)


def _score(sums: FloatArray) -> float:
    count = float(sums[2])
    if not count > 0.0:
        return math.inf
    residuals, leverages = float(sums[0]) / count, float(sums[1]) / count
    if not math.isfinite(residuals) or not leverages < _MOST_LEVERAGE:
        return math.inf
    return residuals / ((1.0 - leverages) * (1.0 - leverages))


def smooth(signal: Signal, smoother: Smoother) -> SmoothedSignal:
    """Return loess of one signal by `smoother`; a short signal bears a lower degree only."""
    bins, share = _thin(signal, smoother.thinning)
    of_bins = _empty(len(bins.times))
    degree = min(smoother.degree, len(bins.times) - 2)
    window = max(round(smoother.span / share), degree + 2), degree + 1
    weights = bins.weights, bins.filled_inverse_variances
    loess_into(of_bins.fits, of_bins.gains, bins.times, bins.values, *weights, *window)
    if smoother.thinning == 1:
        return of_bins
    smoothed = _empty(len(signal.times))
    spread_into(smoothed.fits, smoothed.gains, signal.times, bins.times, of_bins.fits, of_bins.gains)
    return smoothed


def _empty(rows: int) -> SmoothedSignal:
    return SmoothedSignal(np.empty((3, rows)), np.empty((4, rows)))
