"""Gaps in the times: where one is longer than what is smoothed at a time, the trajectory goes on as another. Pure.

Nothing that is measured tells what happened in between, and neither a slope nor a simulation should reach across.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Final

import numpy as np

from atoll_coordinator.data.trajectories.checks import MIN_ROWS
from atoll_coordinator.data.trajectories.measurements import Measurements
from atoll_coordinator.data.trajectories.trajectories import Range, Trajectories, distinguish
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray

MANY: Final = 5
"""So many trajectories are listed in a message."""


def find_pieces(times: FloatArray, span: int) -> list[Range]:
    """Return the half-open ranges of rows between gaps longer than `span` median steps.

    Times drawn at random come k median steps apart once in 2^k: gaps that may be chance are always bridged.
    """
    steps = np.diff(times)
    by_chance = int(1.0 / SETTINGS.quantisation.improbable).bit_length()
    longest = max(span, by_chance) * float(np.sort(steps)[len(steps) // 2])
    return list(pairwise([0, *(np.flatnonzero(steps > longest) + 1).tolist(), len(times)]))


def split_at_gaps(measurements: Measurements, span: int) -> Measurements:
    """Return `measurements` with trajectories split at gaps longer than `span` rows; the same object without gaps.

    Pieces that are too short to be differentiated are left out, unless too little would remain: then nothing is split.
    """
    assert measurements.trajectories is not None
    pieces = [find_pieces(times, span) for times in measurements.trajectories.times]
    gaps = sum(len(ranges) - 1 for ranges in pieces)
    if gaps == 0:
        return measurements
    counted = f"{gaps} gap{'s' if gaps > 1 else ''} in the times {'are' if gaps > 1 else 'is'}"
    long_enough = [[piece for piece in ranges if piece[1] - piece[0] >= MIN_ROWS] for ranges in pieces]
    rows = sum(last - first for ranges in long_enough for first, last in ranges)
    is_any_searched = any(ranges and not out for ranges, out in zip(long_enough, measurements.held_out, strict=True))
    if rows < SETTINGS.rows.least_kept * measurements.row_count or not is_any_searched:
        sentence = f"{counted} bridged although long, because the pieces between them are too short."
        return replace(measurements, warnings=(*measurements.warnings, sentence))
    return _split(measurements, long_enough, f"{counted} longer than what is smoothed at a time")


def _split(measurements: Measurements, pieces: Sequence[Sequence[Range]], reason: str) -> Measurements:
    """Return `measurements` with the `pieces` of each trajectory, which are ranges of its rows, and say so."""
    whole, split = measurements.trajectories, take_pieces(measurements, pieces)
    assert whole is not None
    assert split.trajectories is not None
    numbers = [number for number, ranges in enumerate(pieces) for _ in ranges]
    names_of: dict[int, list[str]] = {}
    for name, number in zip(split.trajectories.names, numbers, strict=True):
        names_of.setdefault(number, []).append(name)
    texts = [f"{whole.names[number]} into {', '.join(its)}" for number, its in names_of.items() if len(its) > 1]
    listed = "; ".join(texts[:MANY]) + ("; …" if len(texts) > MANY else "")
    warnings = [*measurements.warnings, f"{reason}; trajectories are split there{f': {listed}' if listed else ''}."]
    left_out = measurements.row_count - split.row_count
    if left_out:
        warnings.append(f"{left_out} rows in pieces of fewer than {MIN_ROWS} rows between gaps are left out.")
    return replace(split, warnings=tuple(warnings))


def take_pieces(measurements: Measurements, pieces: Sequence[Sequence[Range]]) -> Measurements:
    """Return `measurements` with the `pieces` of each trajectory, ranges of its rows, as trajectories of their own."""
    whole = measurements.trajectories
    assert whole is not None
    parts = [(number, slice(*piece)) for number, ranges in enumerate(pieces) for piece in ranges]
    rows = [row for number, part in parts for row in range(*measurements.ranges[number])[part]]
    ends = np.cumsum([0, *(part.stop - part.start for _, part in parts)]).tolist()
    names = distinguish([whole.names[number] for number, _ in parts])
    times = tuple(whole.times[number][part] for number, part in parts)
    states = {name: [along[number][part] for number, part in parts] for name, along in whole.states.items()}
    return replace(
        measurements,
        columns={name: values[rows] for name, values in measurements.columns.items()},
        ranges=tuple(pairwise(ends)),
        held_out=tuple(measurements.held_out[number] for number, _ in parts),
        trajectories=Trajectories(names, times, whole.offset, states),
        groups=tuple(measurements.groups[number] for number, _ in parts) if measurements.groups else (),
    )
