"""Selects the rows of the search by the uncertainty of derivatives, or by weight; reasons for excluded rows. Pure.

For interpolated states, two kinds of rows are excluded: the ends of trajectories, and rows with very uncertain
derivatives (jumps, and passages near a singularity that the sampling does not resolve). For smoothed states, rows are
excluded if their total uncertainty (standard error and estimated bias) is far above the median.

Letters: R rows of one trajectory, S states.
"""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from atoll_coordinator.data.differentiation.derivatives import ROUNDING, StateEstimate, bounded_standard_deviation
from atoll_coordinator.data.differentiation.interpolation import END_ROWS, mark_ends
from atoll_coordinator.data.differentiation.kernels.stencils import moments
from atoll_coordinator.data.differentiation.smoothing import ROUNDS
from atoll_coordinator.data.recording import ExcludedRow, Reason
from atoll_coordinator.data.trajectories.measurements import Measurements
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.data.notes import Note

LIMITS = SETTINGS.rows
FAR_OUT = LIMITS.over_median_uncertainty
_GAP_STEPS: Final = 3.0
"""A time step counts as a gap if it is this many times as long as the median time step of its trajectory."""
_END_SHARE: Final = 0.25
"""Rows closer to the end of a trajectory than this share of a span have most neighbours on one side."""


@dataclass(frozen=True)
class SelectedRows:
    """The selected rows: `searched` for the search, `held_out` of held-out trajectories.

    For each state, `uncertain` has the rows of searched trajectories whose derivative of this state is too uncertain,
    and `excluded` the rows that are not used because of it, with the reasons; `warnings` are sentences for the user.
    """

    searched: list[int]
    held_out: list[int]
    uncertain: tuple[frozenset[int], ...]
    excluded: tuple[tuple[ExcludedRow, ...], ...]
    warnings: tuple[str, ...]


def select_searched_rows(
    measurements: Measurements, estimates: Sequence[StateEstimate], *, paper: bool
) -> SelectedRows:
    """Return the rows that all targets use (all rows for `paper`); the same limits apply to held-out rows."""
    assert measurements.trajectories is not None
    times = measurements.trajectories.times
    is_known = np.all([estimate.is_known for estimate in estimates], axis=0)
    every = measurements.searched_rows
    searched = [row for row in every if is_known[row]]
    held_out = [row for row in measurements.held_out_rows if is_known[row]]
    selected, within, warnings = searched, held_out, list[str]()
    uncertain = [frozenset[int]()] * len(estimates)
    if not paper:
        interpolated = [estimate for estimate in estimates if estimate.is_interpolated]
        smoothed = [estimate for estimate in estimates if not estimate.is_interpolated]
        ends = mark_ends([len(part) for part in times]) if interpolated else np.zeros(measurements.row_count)
        inner = [row for row in searched if ends[row] == 0.0]
        certain = _certain_interpolated(interpolated, inner)
        selected = _certain_smoothed(smoothed, certain)
        totals = [estimate.total_uncertainty for estimate in estimates]
        limits = [float(np.max(total[selected], initial=0.0)) for total in totals]
        pairs = list(zip(totals, limits, strict=True))
        uncertain = [frozenset(row for row in every if limit < total[row] < math.inf) for total, limit in pairs]
        within = [row for row in held_out if ends[row] == 0.0 and all(total[row] <= limit for total, limit in pairs)]
        if len(inner) < len(searched):
            rows = f"{END_ROWS} rows at each end of a trajectory"
            warnings.append(Note(f"Data without noise are interpolated, not smoothed; {rows} are left out."))
        if len(certain) < len(inner):
            count = f"{len(inner) - len(certain)} of {len(inner)} rows"
            warnings.append(f"{count} change too fast for the sampling interval and are left out.")
        if len(selected) < len(certain):
            count = f"{len(certain) - len(selected)} of {len(certain)} rows"
            at = "(at ends and jumps)"
            warnings.append(f"{count} have uncertain derivatives {at} and are left out of the search.")
    excluded = [
        explain_excluded_rows(times, estimate, own, frozenset(every))
        for estimate, own in zip(estimates, uncertain, strict=True)
    ]
    return SelectedRows(selected, within, tuple(uncertain), tuple(excluded), tuple(warnings))


def _certain_interpolated(estimates: Sequence[StateEstimate], inner: list[int]) -> list[int]:
    """Return the rows of `inner` whose relative uncertainty is small enough for every state.

    The uncertainty of a target is the mean over its rows, but equations are compared by mean squared error. If a few
    rows are far more uncertain than the others, their errors dominate the squares, and a wrong term that fits these
    errors looks like an improvement. So the most uncertain rows are left out until, for every state, the root mean
    square of the uncertainty is at most `most_uneven` times its mean.
    """
    if not estimates or not inner:
        return inner
    selected = inner
    least = math.ceil(LIMITS.least_kept * len(inner))
    for _ in range(ROUNDS):
        worst = np.zeros(len(inner))
        for estimate in estimates:
            deviation = bounded_standard_deviation(estimate.derivative[selected], SETTINGS.common.negligible)
            worst = np.maximum(worst, estimate.uncertainty[inner] / deviation)
        ordered = np.sort(worst).tolist()
        limit = max(SETTINGS.common.clean, FAR_OUT * ordered[len(inner) // 2], ordered[least - 1])
        selected = [row for row, uncertainty in zip(inner, worst.tolist(), strict=True) if uncertainty <= limit]
    for estimate in estimates:
        uncertainty = estimate.uncertainty[selected].tolist()
        ordered = sorted(uncertainty)
        total, square, enough = 0.0, 0.0, 0
        for count, value in enumerate(ordered, start=1):
            total += value
            square += value * value
            if count <= least or square * count <= (LIMITS.most_uneven * total) ** 2:
                enough = count
        limit = ordered[enough - 1] if enough else math.inf
        selected = [row for row, value in zip(selected, uncertainty, strict=True) if value <= limit]
    return selected


def _certain_smoothed(estimates: Sequence[StateEstimate], rows: list[int]) -> list[int]:
    """Return the rows whose total uncertainty, relative to its median, is small enough for every state."""
    worst = np.zeros(len(rows))
    for estimate in estimates:
        uncertainty = estimate.total_uncertainty[rows]
        median = float(np.sort(uncertainty)[len(rows) // 2]) if rows else 0.0
        if median > 0.0:
            worst = np.maximum(worst, uncertainty / median)
    ordered = np.sort(worst).tolist()
    least = min(max(math.ceil(LIMITS.least_kept * len(rows)), SETTINGS.common.fewest_rows), len(rows))
    limit = max(FAR_OUT, ordered[least - 1]) if rows else FAR_OUT
    return [row for row, value in zip(rows, worst.tolist(), strict=True) if value <= limit]


def explain_excluded_rows(
    times: Sequence[FloatArray], estimate: StateEstimate, uncertain: Collection[int], searched: Collection[int]
) -> tuple[ExcludedRow, ...]:
    """Return the rows that the search does not see because of one state, and its outliers, in order.

    Row numbers and `times` run through all trajectories, one after the other. Derivatives are too uncertain at the rows
    `uncertain`; the rows `searched` belong to trajectories that are not held out.
    """
    lengths = [len(part) for part in times]
    cut_off = mark_ends(lengths) if estimate.is_interpolated else np.zeros(sum(lengths))
    span = 0 if estimate.smoother is None else estimate.smoother.rows
    weights, is_known = estimate.robustness_weights, estimate.is_known
    excluded: list[ExcludedRow] = []
    first = 0
    for number, part in enumerate(times):
        rows, steps = len(part), np.diff(part)
        known = np.flatnonzero(is_known[first : first + rows]).tolist() or [0, rows - 1]
        reach = max(END_ROWS, int(_END_SHARE * min(span, rows)))
        is_near_gap = np.zeros(rows, np.bool_)
        for step in np.flatnonzero(steps > _GAP_STEPS * float(np.sort(steps)[len(steps) // 2])).tolist():
            is_near_gap[max(step + 1 - END_ROWS, 0) : step + 1 + END_ROWS] = True
        for row in range(rows):
            place = first + row
            is_outlier = weights is not None and weights[place] == 0.0
            is_missing = not is_known[place]
            if place not in searched or not (place in uncertain or cut_off[place] or is_outlier or is_missing):
                continue
            reasons: dict[Reason, bool] = {
                "missing": is_missing,
                "outlier": is_outlier,
                "end": cut_off[place] or min(row - known[0], known[-1] - row) < reach,
                "gap": bool(is_near_gap[row]),
                "jump": True,
            }
            excluded.append(ExcludedRow(number, row, next(reason for reason, holds in reasons.items() if holds)))
        first += rows
    return tuple(excluded)


def thin_searched_rows(selected: SelectedRows, states: Sequence[FloatArray], most: int = LIMITS.most) -> SelectedRows:
    """Return the selection, reduced to about `most` rows for the search if it has more; `states` are (R,) each.

    Derivatives of neighbouring rows come from the same measurements, so little information is lost. The kept rows are
    spread evenly over the row numbers and over the path length of each state, so that fast motion keeps enough rows.
    """
    rows = selected.searched
    if len(rows) <= most:
        return selected
    place = evenly = np.arange(len(rows)) / (len(rows) - 1)
    for state in states:
        way = np.cumsum(np.abs(np.diff(state[rows], prepend=state[rows[0]])))  # summed one after another, not in pairs
        place = place + (way / way[-1] if way[-1] > 0.0 else evenly)
    numbers = np.floor(place * ((most - 1) / (len(states) + 1)))
    is_kept = np.diff(numbers, prepend=-1.0) > 0.0
    kept = [row for row, keep in zip(rows, is_kept.tolist(), strict=True) if keep]
    sentence = Note(f"The search sees {len(kept)} of {len(rows)} rows, spread evenly; models are judged by all.")
    return replace(selected, searched=kept, warnings=(*selected.warnings, sentence))


def normalize_weights(weights: FloatArray | None) -> FloatArray | None:
    """Return positive weights (inverse variances) over their mean; None if there are none, or if all are equal."""
    if weights is None:
        return None
    scaled = weights / float(np.max(weights))
    mean, deviation = moments(scaled)
    return None if deviation <= ROUNDING * mean else np.ascontiguousarray(scaled / mean)


def select_weighty_rows(weights: FloatArray | None, rows: list[int]) -> list[int]:
    """Return the `rows` whose weight is not far below the median weight; at least a fixed share of the rows is kept.

    The search gives all rows equal weight (ADR 0027), so rows with far larger errors have to be left out of it.
    """
    if weights is None:
        return rows
    ordered = np.sort(weights[rows]).tolist()
    least = ordered[len(rows) - max(1, math.ceil(LIMITS.least_kept * len(rows)))]
    limit = min(ordered[len(rows) // 2] / LIMITS.over_median_uncertainty**2, least)
    return [row for row in rows if weights[row] >= limit]
