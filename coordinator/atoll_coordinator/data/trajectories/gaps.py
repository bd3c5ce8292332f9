"""Gaps in the times: where one is longer than what is smoothed at a time, the trajectory goes on as another. Pure.

Nothing that is measured tells what happened in between, and neither a slope nor a simulation should reach across.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Final

import numpy as np

from atoll.data.dataset import FloatArray
from atoll_coordinator.data.reading.checks import MIN_ROWS
from atoll_coordinator.data.reading.measured import Measured
from atoll_coordinator.data.trajectories.trajectories import Trajectories, distinguished

NARROWEST: Final = 20
"""A gap of so many median steps or fewer is bridged, however narrow the spans: times drawn at random come that far
apart only once in a million rows."""
MANY: Final = 5
"""So many trajectories are listed in a message."""
LEAST_KEPT: Final = 0.5
"""Share of the rows, at least, that pieces long enough to be differentiated must hold: else gaps are bridged."""


def pieces_of(times: FloatArray, span: int) -> list[tuple[int, int]]:
    """Return the half-open ranges of rows between gaps longer than `span` median steps (or `NARROWEST`)."""
    steps = np.diff(times)
    longest = max(span, NARROWEST) * float(np.sort(steps)[len(steps) // 2])
    ends = [0, *(int(row) + 1 for row in np.flatnonzero(steps > longest)), len(times)]
    return list(pairwise(ends))


def split_at_gaps(its: Measured, span: int) -> Measured:
    """Return `its` with trajectories split at gaps longer than `span` rows; `its` itself when there are none.

    Pieces that are too short to be differentiated are left out, unless too little would remain: then nothing is split.
    """
    assert its.trajectories is not None
    pieces = [pieces_of(times, span) for times in its.trajectories.times]
    if all(len(each) == 1 for each in pieces):
        return its
    gaps = sum(len(each) - 1 for each in pieces)
    counted = f"{gaps} gap{'s' if gaps > 1 else ''} in the times"
    verb = "are" if gaps > 1 else "is"
    kept = [[piece for piece in each if piece[1] - piece[0] >= MIN_ROWS] for each in pieces]
    rows = sum(last - first for each in kept for first, last in each)
    some_left = any(each and not out for each, out in zip(kept, its.held_out, strict=True))
    if rows < LEAST_KEPT * len(its.rows) or not some_left:
        sentence = f"{counted} {verb} bridged although long, because the pieces between them are too short."
        return replace(its, warnings=(*its.warnings, sentence))
    return _split(its, kept, f"{counted} {verb} longer than what is smoothed at a time", len(its.rows) - rows)


def _split(its: Measured, kept: Sequence[Sequence[tuple[int, int]]], reason: str, left_out: int) -> Measured:
    """Return `its` with the pieces `kept` of each trajectory, which are ranges of its rows."""
    assert its.trajectories is not None
    old = its.trajectories
    parts = [(run, piece) for run, each in enumerate(kept) for piece in each]
    chosen = [
        index for run, (first, last) in parts for index in range(old.runs[run][0] + first, old.runs[run][0] + last)
    ]
    rows = tuple(its.rows[index] for index in chosen)
    ends = [0, *np.cumsum([last - first for _, (first, last) in parts]).tolist()]
    runs = tuple(pairwise(ends))
    names = distinguished([old.names[run] for run, _ in parts])
    times = tuple(np.ascontiguousarray(old.times[run][first:last]) for run, (first, last) in parts)
    states = {
        name: [np.ascontiguousarray(along[run][first:last]) for run, (first, last) in parts]
        for name, along in its.states.items()
    }
    listed = _listed(old.names, names, parts)
    warnings = [*its.warnings, f"{reason}; trajectories are split there{f': {listed}' if listed else ''}."]
    if left_out:
        warnings.append(f"{left_out} rows in pieces of fewer than {MIN_ROWS} rows between gaps are left out.")
    return replace(
        its,
        rows=rows,
        runs=runs,
        held_out=tuple(its.held_out[run] for run, _ in parts),
        trajectories=Trajectories(rows, runs, times, names, old.offset),
        states=states,
        warnings=tuple(warnings),
    )


def _listed(old: Sequence[str], new: Sequence[str], parts: Sequence[tuple[int, tuple[int, int]]]) -> str:
    """Return which trajectory became which, such as ``2 into 2, 2b; 5 into 5, 5b, 5c``."""
    texts = []
    for run, name in enumerate(old):
        mine = [its for its, (whence, _) in zip(new, parts, strict=True) if whence == run]
        if len(mine) > 1:
            texts.append(f"{name} into {', '.join(mine)}")
    shown = "; ".join(texts[:MANY])
    return f"{shown}; …" if len(texts) > MANY else shown
