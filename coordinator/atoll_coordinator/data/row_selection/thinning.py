"""Fewer rows for the search where there are many: neighbours' derivatives come from the same measurements. Pure."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from atoll_coordinator.data.row_selection.selected_rows import SelectedRows
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray


def thin_searched_rows(
    selected: SelectedRows, states: Sequence[FloatArray], most: int = SETTINGS.rows.most
) -> SelectedRows:
    """Return the selection with about `most` rows for the search, if there were more; `states` are (R,) each.

    The rows are spread evenly over the rows and over the way that each state goes, so that a quick passage keeps rows.
    """
    rows = selected.searched
    if len(rows) <= most:
        return selected
    place = np.arange(len(rows)) / (len(rows) - 1)
    for state in states:
        way = np.cumsum(np.abs(np.diff(state[rows], prepend=state[rows[0]])))  # one after another: no pairwise sums
        place = place + (way / way[-1] if way[-1] > 0.0 else np.arange(len(rows)) / (len(rows) - 1))
    numbers = np.floor(place * ((most - 1) / (len(states) + 1)))
    is_kept = np.diff(numbers, prepend=-1.0) > 0.0
    kept = [row for row, keep in zip(rows, is_kept.tolist(), strict=True) if keep]
    sentence = f"The search sees {len(kept)} of {len(rows)} rows, spread evenly; models are judged by all."
    return replace(selected, searched=kept, warnings=(*selected.warnings, sentence))
