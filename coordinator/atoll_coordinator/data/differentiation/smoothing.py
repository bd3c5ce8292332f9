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

from atoll.data.dataset import FloatArray
from atoll_coordinator.data.differentiation.kernels.loess import (
    DEGREES,
    loess_into,
    spread_into,
    thin_into,
    validate_into,
)

SPAN_RATIO: Final = 1.25
SMALLEST_SPAN: Final = 5
LARGEST_SPAN: Final = 1001
"""Widest span tried, in bins."""
PATIENCE: Final = 5
"""Spans without a better score, each a quarter wider than the last, after which wider ones are not tried."""
MANY_ROWS: Final = 2000
"""More rows than this are thinned if possible, to half as many bins or more."""
LEAST_BINS: Final = 40
"""Bins in the narrowest span for which rows may be thinned: means over a fortieth of a span have lost nothing."""
FEWEST_BINS: Final = 20
"""A run of no more rows than this is never thinned, a longer one never to fewer bins."""
REFINING: Final = 4
"""By so much less rows are thinned when the span that was chosen has too few bins."""
NARROW_SPANS: Final = (9, 18, 36)
"""Spans in rows, by which it is judged whether thinning has lost a fast wave."""
JUDGED_ROWS: Final = 4000
"""Of more bins than this, one in k is judged when span and degree are chosen."""


@dataclass(frozen=True, eq=False)
class Run:
    """One state along one trajectory: strictly ascending `times` and `values`, both (R,).

    `trust` (R,) says between 0 and 1 how much a row is believed, `precision` (R,), positive, by what the variance of
    its noise is divided; None: all rows wholly, or all alike.
    """

    times: FloatArray
    values: FloatArray
    trust: FloatArray | None = None
    precision: FloatArray | None = None

    @cached_property
    def precisions(self) -> FloatArray:
        """The precision of each row, (R,)."""
        return np.ones(len(self.times)) if self.precision is None else self.precision

    @cached_property
    def weights(self) -> FloatArray:
        """How much each row counts, (R,)."""
        return self.precisions if self.trust is None else self.trust * self.precisions


@dataclass(frozen=True)
class Choice:
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
class Smoothed:
    """Loess of one run: `fits` (3, R) value, slope, curvature; `gains` (4, R) their noise gains and the leverage."""

    fits: FloatArray
    gains: FloatArray


def choose(runs: Sequence[Run], degrees: Sequence[int]) -> Choice:
    """Return span and degree of least generalised cross-validation score, pooled over `runs`.

    Craven & Wahba 1979, eq. 1.9: mean squared residual over the squared mean of (1 - leverage), rows weighed by trust.
    """
    rows = [len(run.times) for run in runs]
    thinning = max(1, min(sum(rows) // MANY_ROWS, max(rows) // (FEWEST_BINS * LEAST_BINS)))
    while True:
        best = _chosen([_binned(run, thinning) for run in runs], degrees)
        best = replace(best, thinning=thinning)
        if thinning == 1 or (best.span >= LEAST_BINS and _has_lost_nothing(runs, best, degrees)):
            return best
        thinning = max(1, thinning // REFINING)


def _has_lost_nothing(runs: Sequence[Run], choice: Choice, degrees: Sequence[int]) -> bool:
    """Say whether thinned rows are followed as well as rows are by narrow spans: a fast wave may vanish in means."""
    if not math.isfinite(choice.score):
        return False
    whole = [_Bins(run, 1.0) for run in runs]
    narrow = min(_scored(whole, span, 1, degrees).score for span in NARROW_SPANS)
    squares, count = 0.0, 0.0
    for run in runs:
        residuals = (run.values - smooth(run, choice).fits[0]).tolist()
        for residual, weight in zip(residuals, run.weights.tolist(), strict=True):
            squares += weight * residual * residual
            count += weight
    return squares <= narrow * count


@dataclass(frozen=True, eq=False)
class _Bins:
    """A run thinned to bins, `share` (at most 1) times as wide as asked for: a short run is thinned less."""

    run: Run
    share: float

    def span(self, span: int) -> int:
        """Return what a span in bins as wide as asked for is here."""
        return round(span / self.share)


def _binned(run: Run, thinning: int) -> _Bins:
    """Return means over bins of `thinning` rows; for 1 the run itself."""
    if thinning == 1:
        return _Bins(run, 1.0)
    rows = len(run.times)
    bins = max(rows // thinning, min(rows, FEWEST_BINS))
    share = rows / bins / thinning if bins > rows // thinning else 1.0
    times, values, weights = np.empty(bins), np.empty(bins), np.empty(bins)
    precision = np.empty(bins) if run.precision is not None else None
    if run.precision is not None and precision is not None:
        thin_into(times, values, precision, run.times, run.values, run.precision)
    thin_into(times, values, weights, run.times, run.values, run.weights)
    trust = share * weights if precision is None else share * weights / precision
    return _Bins(Run(times, values, trust, precision), share)


def _chosen(parts: Sequence[_Bins], degrees: Sequence[int]) -> Choice:
    longest = max(len(part.run.times) for part in parts)
    every = -(-sum(len(part.run.times) for part in parts) // JUDGED_ROWS)
    best = Choice(0, 0, math.inf)
    since = 0
    for span in _spans(longest):
        here = _scored(parts, span, every, degrees)
        since = 0 if here.score < best.score else since + 1
        best = here if here.score < best.score else best
        if since >= PATIENCE and math.isfinite(best.score):
            break
    return best


def _spans(longest: int) -> list[int]:
    """Return the spans tried: beyond the longest trajectory the bandwidth goes on growing for a while."""
    spans = [SMALLEST_SPAN]
    while spans[-1] < min(3 * longest, LARGEST_SPAN):
        spans.append(max(spans[-1] + 1, int(spans[-1] * SPAN_RATIO)))
    return spans


def _scored(parts: Sequence[_Bins], span: int, every: int, degrees: Sequence[int]) -> Choice:
    """Return the best of `degrees` at one span."""
    sums = np.zeros((3, DEGREES))
    for part in parts:
        run = part.run
        validate_into(sums, run.times, run.values, run.weights, part.span(span), every)
    choices = (Choice(span, degree, _score(sums[:, degree])) for degree in degrees)
    return min(choices, key=lambda each: each.score)


def _score(sums: FloatArray) -> float:
    count = float(sums[2])
    if not count > 0.0:
        return math.inf
    residuals, leverages = float(sums[0]) / count, float(sums[1]) / count
    if not math.isfinite(residuals) or not leverages < 0.999:
        return math.inf
    return residuals / ((1.0 - leverages) * (1.0 - leverages))


def smooth(run: Run, choice: Choice) -> Smoothed:
    """Return loess of one run by `choice`; a short run bears a lower degree only."""
    part = _binned(run, choice.thinning)
    of_bins = _loess(part.run, part.span(choice.span), choice.degree)
    if choice.thinning == 1:
        return of_bins
    its = Smoothed(np.empty((3, len(run.times))), np.empty((4, len(run.times))))
    spread_into(its.fits, its.gains, run.times, part.run.times, of_bins.fits, of_bins.gains)
    return its


def _loess(run: Run, span: int, degree: int) -> Smoothed:
    its = Smoothed(np.empty((3, len(run.times))), np.empty((4, len(run.times))))
    degree = min(degree, len(run.times) - 2)
    span = max(span, degree + 2)
    loess_into(its.fits, its.gains, run.times, run.values, run.weights, run.precisions, span, degree + 1)
    return its


def noise_of(runs: Sequence[Run], smoothed: Sequence[Smoothed]) -> float:
    """Return the estimated standard deviation of the noise in a row of precision 1: residuals over degrees of freedom.

    Cleveland & Devlin 1988, section 3: rows minus twice the trace of the smoother plus the trace of its square. Rows
    without trust do not count.
    """
    squares, freedom = 0.0, 0.0
    for run, its in zip(runs, smoothed, strict=True):
        residuals, weights = (run.values - its.fits[0]).tolist(), run.weights.tolist()
        freedoms = (1.0 - 2.0 * its.gains[3] + run.precisions * its.gains[0] * its.gains[0]).tolist()
        precisions = run.precisions.tolist()
        for residual, weight, precision, free in zip(residuals, weights, precisions, freedoms, strict=True):
            if weight > 0.0:
                squares += precision * residual * residual
                freedom += free
    return math.sqrt(squares / max(freedom, 1.0))
