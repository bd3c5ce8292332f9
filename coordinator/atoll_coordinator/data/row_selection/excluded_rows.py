"""Rows that a state does not offer to the search, or that smoothing passed over, and the reason of each. Pure."""

from collections.abc import Collection, Sequence
from typing import Final

import numpy as np

from atoll.data.dataset import FloatArray
from atoll_coordinator.data.differentiation.derivatives import END_ROWS, Estimate, end_rows
from atoll_coordinator.data.recording import ExcludedRow, Reason

LONG_STEP: Final = 3.0
"""A step of the times this many times as long as the median one of its trajectory is a gap."""
END_SHARE: Final = 0.25
"""Rows within this share of a span from the end of a trajectory have neighbours on one side, mostly."""


def doubts_of(
    times: Sequence[FloatArray], its: Estimate, doubted: Collection[int], seen: Collection[int]
) -> tuple[ExcludedRow, ...]:
    """Return the rows of one state that the search does not see for its sake, and its outliers, in order.

    Args:
        times: of each trajectory, ascending strictly.
        its: the state's values and derivatives over all rows, one trajectory after another.
        doubted: rows whose derivative cannot be trusted.
        seen: rows of the trajectories that are not held out.
    """
    lengths = [len(each) for each in times]
    left_out = end_rows(lengths) if its.interpolated else np.zeros(sum(lengths))
    found: list[ExcludedRow] = []
    first = 0
    for number, part in enumerate(times):
        ends, gaps = _near_ends(len(part), its), _near_gaps(part)
        for row in range(len(part)):
            place = first + row
            is_outlier = its.trust is not None and its.trust[place] == 0.0
            if place not in seen or not (place in doubted or left_out[place] or is_outlier):
                continue
            reason: Reason = "jump"
            if is_outlier:
                reason = "outlier"
            elif left_out[place] or ends[row]:
                reason = "end"
            elif gaps[row]:
                reason = "gap"
            found.append(ExcludedRow(number, row, reason))
        first += len(part)
    return tuple(found)


def _near_ends(rows: int, its: Estimate) -> list[bool]:
    """Return for each row of a trajectory whether it is near an end of it."""
    reach = END_ROWS if its.choice is None else max(END_ROWS, int(END_SHARE * min(its.choice.rows, rows)))
    return [min(row, rows - 1 - row) < reach for row in range(rows)]


def _near_gaps(times: FloatArray) -> list[bool]:
    """Return for each row of a trajectory whether a long step of the times is near."""
    steps = np.diff(times)
    long = np.flatnonzero(steps > LONG_STEP * float(np.sort(steps)[len(steps) // 2])).tolist()
    near = [False] * len(times)
    for step in long:
        for row in range(max(step + 1 - END_ROWS, 0), min(step + 1 + END_ROWS, len(times))):
            near[row] = True
    return near
