"""Loess: local polynomials with tricube weights, their span and degree chosen by cross-validation (pure).

Schmidt & Lipson 2008 take the slope of such a fit as the derivative. Here span and degree are chosen per state by
generalised cross-validation pooled over its trajectories.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from common.dataset import FloatArray
from coordinator.data.kernels_smoothing import DEGREES, loess_into, validate_into

SPAN_RATIO: Final = 1.25
SMALLEST_SPAN: Final = 5
LARGEST_SPAN: Final = 1001
PATIENCE: Final = 5
"""Spans without a better score, each a quarter wider than the last, after which wider ones are not tried."""
JUDGED_ROWS: Final = 2000
"""Of more rows than this, every k-th one is judged when span and degree are chosen."""


@dataclass(frozen=True, eq=False)
class Run:
    """One state along one trajectory: strictly ascending `times` and `values`, both (R,)."""

    times: FloatArray
    values: FloatArray


@dataclass(frozen=True)
class Choice:
    """A loess smoother: the `span` in rows, the `degree` of its polynomials, and its score (lower is better)."""

    span: int
    degree: int
    score: float


@dataclass(frozen=True, eq=False)
class Smoothed:
    """Loess of one run: `fits` (3, R) value, slope, curvature; `gains` (4, R) their noise gains and the leverage."""

    fits: FloatArray
    gains: FloatArray


def choose(runs: Sequence[Run], degrees: Sequence[int]) -> Choice:
    """Return span and degree of least generalised cross-validation score, pooled over `runs`.

    Craven & Wahba 1979, eq. 1.9: mean squared residual over the squared mean of (1 - leverage).
    """
    longest = max(len(run.times) for run in runs)
    every = -(-sum(len(run.times) for run in runs) // JUDGED_ROWS)
    best = Choice(0, 0, math.inf)
    since = 0
    for span in _spans(longest):
        here = _scored(runs, span, every, degrees)
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


def _scored(runs: Sequence[Run], span: int, every: int, degrees: Sequence[int]) -> Choice:
    """Return the best of `degrees` at one span."""
    sums = np.zeros((3, DEGREES))
    for run in runs:
        validate_into(sums, run.times, run.values, span, every)
    count = sum(-(-len(run.times) // every) for run in runs)
    choices = (Choice(span, degree, _score(sums[:, degree], count)) for degree in degrees)
    return min(choices, key=lambda each: each.score)


def _score(sums: FloatArray, count: int) -> float:
    residuals, leverages = float(sums[0]) / count, float(sums[1]) / count
    if not math.isfinite(residuals) or not leverages < 0.999:
        return math.inf
    return residuals / ((1.0 - leverages) * (1.0 - leverages))


def smooth(run: Run, choice: Choice) -> Smoothed:
    """Return loess of one run by `choice`; a short run bears a lower degree only."""
    fits, gains = np.empty((3, len(run.times))), np.empty((4, len(run.times)))
    degree = min(choice.degree, len(run.times) - 2)
    loess_into(fits, gains, run.times, run.values, max(choice.span, degree + 2), degree + 1)
    return Smoothed(fits, gains)


def noise_of(runs: Sequence[Run], smoothed: Sequence[Smoothed]) -> float:
    """Return the estimated standard deviation of the noise: residuals over their degrees of freedom.

    Cleveland & Devlin 1988, section 3: rows minus twice the trace of the smoother plus the trace of its square.
    """
    squares, freedom = 0.0, 0.0
    for run, its in zip(runs, smoothed, strict=True):
        for row in range(len(run.times)):
            residual = float(run.values[row]) - float(its.fits[0, row])
            squares += residual * residual
            gain = float(its.gains[0, row])
            freedom += 1.0 - 2.0 * float(its.gains[3, row]) + gain * gain
    return math.sqrt(squares / max(freedom, 1.0))
