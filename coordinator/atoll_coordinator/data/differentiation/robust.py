"""Robust loess: rows far from the curve, outliers, lose their weight (Cleveland 1979, section 2). Pure.

Unlike there, span and degree are chosen anew with every set of weights, since outliers make the wide spans look good.
Medians are taken by sorting.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from atoll.data.dataset import FloatArray
from atoll_coordinator.data.differentiation.kernels.stencils import moments
from atoll_coordinator.data.differentiation.smoothing import Choice, Run, Smoothed, choose, smooth

ROUNDS: Final = 6
"""Most rounds of smoothing and weighing; with fewer outliers it ends earlier."""
REACH: Final = 6.0
"""Residuals beyond this many times the median one have no weight (Cleveland 1979)."""
DEVIATION: Final = 1.4826
"""Standard deviation of normal residuals over the median of their size."""
FINEST: Final = 1e-5
"""Share of the state's standard deviation that the median residual counts as at least: of data without noise, bias and
rounding must not be taken for outliers."""
ISOLATED: Final = 0.5
"""An outlier's neighbours have at most this share of its residual; at a jump that is not resolved they have more."""
FEWEST: Final = 3
SPARSEST: Final = 150
"""Residuals are heavy-tailed when `FEWEST` of them, and one of this many, are isolated and far out: measured with
noise of 0.2 to 10 % there were at most 2 in 400 without outliers."""


@dataclass(frozen=True, eq=False)
class Trusted:
    """Runs with a trust in every row, the smoother chosen with it, and the median residual by which it was measured."""

    runs: tuple[Run, ...]
    choice: Choice
    median: float


def trusted(runs: Sequence[Run], degrees: Sequence[int]) -> Trusted:
    """Return `runs` with less trust in rows far from the curve, none in outliers."""
    its = Trusted(tuple(runs), choose(runs, degrees), 0.0)
    least = FINEST * moments(np.concatenate([run.values for run in runs]))[1]
    for _ in range(ROUNDS):
        residuals = _residuals(its.runs, [smooth(run, its.choice) for run in its.runs])
        median = max(_median(residuals), least)
        if not median > 0.0:
            break
        weighed = tuple(_weighed(run, part, median) for run, part in zip(runs, residuals, strict=True))
        is_settled = outliers(weighed) == outliers(its.runs)
        its = Trusted(weighed, choose(weighed, degrees), median)
        if is_settled:
            break
    return its


def retrusted(run: Run, its: Trusted) -> Run:
    """Return another run with the trust that the same smoother and the same median residual give its rows."""
    for _ in range(ROUNDS if its.median > 0.0 else 0):
        (residuals,) = _residuals([run], [smooth(run, its.choice)])
        run = _weighed(run, residuals, its.median)
    return run


def outliers(runs: Sequence[Run]) -> int:
    """Return how many rows have no trust."""
    return sum(run.weights.tolist().count(0.0) for run in runs)


def has_heavy_tails(runs: Sequence[Run], smoothed: Sequence[Smoothed]) -> bool:
    """Say whether some rows lie so far from the curve, and so alone, that they cannot be noise like the others'."""
    residuals = _residuals(runs, smoothed)
    limit = REACH * DEVIATION * _median(residuals)
    count = sum(_isolated(np.abs(part).tolist(), limit) for part in residuals)
    return limit > 0.0 and count >= max(FEWEST, sum(len(part) for part in residuals) / SPARSEST)


def _isolated(sizes: list[float], limit: float) -> int:
    """Return how many of `sizes` exceed `limit` and are at least twice those beside them."""
    padded = [0.0, *sizes, 0.0]
    return sum(
        size > limit and max(before, after) <= ISOLATED * size
        for before, size, after in zip(padded, sizes, padded[2:], strict=False)
    )


def _residuals(runs: Sequence[Run], smoothed: Sequence[Smoothed]) -> list[FloatArray]:
    """Return measured minus smoothed values, over the deviation that a row of this precision has."""
    parts = [run.values - its.fits[0] for run, its in zip(runs, smoothed, strict=True)]
    return [
        part if run.precision is None else part * np.sqrt(run.precision) for part, run in zip(parts, runs, strict=True)
    ]


def _median(residuals: Sequence[FloatArray]) -> float:
    """Return the median size of the residuals."""
    ordered = np.sort(np.abs(np.concatenate(residuals)))
    return float(ordered[len(ordered) // 2])


def _weighed(run: Run, residuals: FloatArray, median: float) -> Run:
    """Return `run` with bisquare weights (Cleveland 1979, section 2)."""
    shares = residuals / (REACH * median)
    rest = np.maximum(1.0 - shares * shares, 0.0)
    return replace(run, trust=rest * rest)
