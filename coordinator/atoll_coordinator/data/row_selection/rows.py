"""Which rows the search sees: those whose derivatives can be trusted. Pure.

Interpolated states: not the ends of trajectories, and not rows of very uncertain derivatives, which are jumps and
passages by a singularity that the sampling does not resolve. Smoothed states: not rows whose doubt, standard error and
estimated bias together, is far above the typical one.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from atoll.data.dataset import FloatArray
from atoll_coordinator.data.differentiation.derivatives import END_ROWS, Estimate, end_rows
from atoll_coordinator.data.differentiation.spread import spread
from atoll_coordinator.data.reading.checks import MIN_ROWS

GOOD_ENOUGH: Final = 1e-5
"""Rows whose derivative is uncertain by less than this share of its standard deviation are always kept."""
FAR_OUT: Final = 5.0
"""Rows whose uncertainty, or doubt, is less than this many times the median one are kept as well."""
LEAST_KEPT: Final = 0.7
"""Share of the rows of interpolated states that is kept however uncertain they are."""
LEAST_UNDOUBTED: Final = 0.8
"""Share of the rows of smoothed states that is kept however doubtful they are."""
MOST_UNEVEN: Final = 2.0
"""Root mean square of the uncertainty over its mean, at most, on the rows kept."""
LEAST_SPREAD: Final = 1e-3
"""A derivative that varies less than this share of its mean is judged by the mean: it may well be constant."""
PASSES: Final = 3
"""A wild row swells the standard deviation by which rows are judged, so that they are judged again without it."""


@dataclass(frozen=True)
class Kept:
    """The rows that remain of trajectories `seen` by the search and of those `held_out`.

    `doubted` has, for each state, the seen rows that were left out for its sake, `doubtful` their numbers; `warnings`
    are sentences for the user.
    """

    seen: list[int]
    held_out: list[int]
    doubted: tuple[frozenset[int], ...]
    warnings: tuple[str, ...]

    @property
    def doubtful(self) -> tuple[int, ...]:
        """How many rows were left out for the sake of each state."""
        return tuple(map(len, self.doubted))


def kept_rows(
    estimates: Sequence[Estimate], lengths: Sequence[int], seen: list[int], held_out: list[int], *, paper: bool
) -> Kept:
    """Return the rows that all targets use.

    Args:
        estimates: one for each state.
        lengths: of the runs, in the order of the estimates' rows.
        seen: rows of the trajectories that the search sees.
        held_out: rows of the others, which are held to the same limits.
        paper: keep every row, as the paper does.
    """
    if paper:
        return Kept(seen, held_out, (frozenset(),) * len(estimates), ())
    is_clean = any(its.interpolated for its in estimates)
    ends = end_rows(lengths) if is_clean else np.zeros(sum(lengths))
    inner = [row for row in seen if ends[row] == 0.0]
    certain = _certain([its for its in estimates if its.interpolated], inner)
    kept = _undoubted([its for its in estimates if not its.interpolated], certain)
    limits = [float(np.max(_doubt(its)[kept], initial=0.0)) for its in estimates]
    doubted = [
        frozenset(row for row, value in zip(seen, _doubt(its)[seen].tolist(), strict=True) if value > limit)
        for its, limit in zip(estimates, limits, strict=True)
    ]
    within = [
        row
        for row in held_out
        if ends[row] == 0.0 and all(_doubt(its)[row] <= limit for its, limit in zip(estimates, limits, strict=True))
    ]
    return Kept(kept, within, tuple(doubted), tuple(_sentences(len(seen), len(inner), len(certain), len(kept))))


def _doubt(its: Estimate) -> FloatArray:
    return its.uncertainty if its.interpolated else its.doubt


def _sentences(seen: int, inner: int, certain: int, kept: int) -> list[str]:
    """Return what the user is told, from how many rows were left after each step."""
    sentences = []
    if inner < seen:
        rows = f"{END_ROWS} rows at each end of a trajectory"
        sentences.append(f"Data without noise are interpolated, not smoothed; {rows} are left out.")
    if certain < inner:
        sentences.append(f"{inner - certain} of {inner} rows change too fast for the sampling step and are left out.")
    if kept < certain:
        count = f"{certain - kept} of {certain} rows have doubtful derivatives (at ends and jumps)"
        sentences.append(f"{count} and are left out of the search.")
    return sentences


def _certain(estimates: Sequence[Estimate], inner: list[int]) -> list[int]:
    """Return the rows of `inner` whose relative uncertainty, the worst of all states, is small enough."""
    kept = inner
    if not estimates or not inner:
        return kept
    for _ in range(PASSES):
        worst = np.zeros(len(inner))
        for its in estimates:
            worst = np.maximum(worst, its.uncertainty[inner] / spread(its.derivative[kept], LEAST_SPREAD))
        ordered = np.sort(worst).tolist()
        limit = max(GOOD_ENOUGH, FAR_OUT * ordered[len(inner) // 2], ordered[math.ceil(LEAST_KEPT * len(inner)) - 1])
        kept = [row for row, uncertainty in zip(inner, worst.tolist(), strict=True) if uncertainty <= limit]
    return _evenly_uncertain(estimates, kept, math.ceil(LEAST_KEPT * len(inner)))


def _evenly_uncertain(estimates: Sequence[Estimate], kept: list[int], least: int) -> list[int]:
    """Return `kept` without the rows that alone would decide a mean square, at least `least` of them.

    The floor of a target is the mean uncertainty, yet equations are compared by mean squared error: where a few rows
    are far more uncertain than the others, their errors exceed the floor and a wrong term that mends them pays. So the
    most uncertain rows go until, for every state, the root mean square is at most `MOST_UNEVEN` times the mean.
    """
    for its in estimates:
        uncertainty = its.uncertainty[kept].tolist()
        ordered = sorted(uncertainty)
        total, square, enough = 0.0, 0.0, 0
        for count, value in enumerate(ordered, start=1):
            total += value
            square += value * value
            if count <= least or square * count <= (MOST_UNEVEN * total) ** 2:
                enough = count
        limit = ordered[enough - 1] if enough else math.inf
        kept = [row for row, value in zip(kept, uncertainty, strict=True) if value <= limit]
    return kept


def _undoubted(estimates: Sequence[Estimate], rows: list[int]) -> list[int]:
    """Return those of `rows` whose doubt, over its median, the worst of all states, is small enough."""
    worst = np.zeros(len(rows))
    for its in estimates:
        doubt = its.doubt[rows]
        median = float(np.sort(doubt)[len(rows) // 2]) if rows else 0.0
        if median > 0.0:
            worst = np.maximum(worst, doubt / median)
    ordered = np.sort(worst).tolist()
    least = min(max(math.ceil(LEAST_UNDOUBTED * len(rows)), MIN_ROWS), len(rows))
    limit = max(FAR_OUT, ordered[least - 1]) if rows else FAR_OUT
    return [row for row, doubt in zip(rows, worst.tolist(), strict=True) if doubt <= limit]
