"""Rows that are not used because of one state, and the reason of each. Pure."""

from collections.abc import Collection, Sequence
from typing import Final

import numpy as np

from atoll_coordinator.data.differentiation.derivatives import StateEstimate
from atoll_coordinator.data.differentiation.interpolation import END_ROWS, mark_ends
from atoll_coordinator.data.recording import ExcludedRow, Reason
from atoll_core.data.dataset import FloatArray

_GAP_STEPS: Final = 3.0
"""A step of the times this many times as long as the median one of its trajectory is told as a gap."""
_END_SHARE: Final = 0.25
"""Rows within this share of a span from the end of a trajectory have neighbours on one side, mostly."""


def explain_excluded_rows(
    times: Sequence[FloatArray], estimate: StateEstimate, uncertain: Collection[int], searched: Collection[int]
) -> tuple[ExcludedRow, ...]:
    """Return the rows of one state that the search does not see because of it, and its outliers, in order.

    Rows are counted through all trajectories, one after the other, whose `times` are given. Derivatives are too
    uncertain at the rows `uncertain`; rows `searched` are of trajectories that are not held out.
    """
    lengths = [len(part) for part in times]
    cut_off = mark_ends(lengths) if estimate.is_interpolated else np.zeros(sum(lengths))
    weights, is_known = estimate.robustness_weights, estimate.is_known
    excluded: list[ExcludedRow] = []
    first = 0
    for number, part in enumerate(times):
        known = np.flatnonzero(is_known[first : first + len(part)]).tolist()
        ends, gaps = _near_ends(len(part), known, estimate), _near_gaps(part)
        for row in range(len(part)):
            place = first + row
            is_outlier = weights is not None and weights[place] == 0.0
            is_missing = not is_known[place]
            if place not in searched or not (place in uncertain or cut_off[place] or is_outlier or is_missing):
                continue
            reasons: dict[Reason, bool] = {
                "missing": is_missing,
                "outlier": is_outlier,
                "end": cut_off[place] or ends[row],
                "gap": gaps[row],
                "jump": True,
            }
            excluded.append(ExcludedRow(number, row, next(reason for reason, holds in reasons.items() if holds)))
        first += len(part)
    return tuple(excluded)


def _near_ends(rows: int, known: Sequence[int], estimate: StateEstimate) -> list[bool]:
    """Return for each row of a trajectory whether it is near the first or the last one where the state is known."""
    low, high = (known[0], known[-1]) if known else (0, rows - 1)
    span = 0 if estimate.smoother is None else estimate.smoother.rows
    reach = max(END_ROWS, int(_END_SHARE * min(span, rows)))
    return [min(row - low, high - row) < reach for row in range(rows)]


def _near_gaps(times: FloatArray) -> list[bool]:
    """Return for each row of a trajectory whether a long step of the times is near."""
    steps = np.diff(times)
    near = np.zeros(len(times), np.bool_)
    for step in np.flatnonzero(steps > _GAP_STEPS * float(np.sort(steps)[len(steps) // 2])).tolist():
        near[max(step + 1 - END_ROWS, 0) : step + 1 + END_ROWS] = True
    return near.tolist()
