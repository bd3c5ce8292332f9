"""Trajectories: rows of a table that belong to one continuous measurement, and what is done to them before smoothing.

Times are centred over the whole data set, and made exactly even where they are even within their own precision, so
that an offset of 1900 or of 10**9 costs nothing. Angles are unwrapped. Pure.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from atoll.config import Angle
from atoll.data.dataset import FloatArray
from atoll.data.table import Table
from atoll_coordinator.data.reading.checks import check_length, check_times
from atoll_coordinator.data.reading.columns import Roles

RADIANS_PER_DEGREE: Final = math.pi / 180.0
LARGEST_PLAIN: Final = 1e15
"""Whole numbers below this are written without an exponent."""


@dataclass(frozen=True, eq=False)
class Trajectories:
    """Where the rows kept of a table lie: `rows` table rows in order, `runs` half-open ranges into `rows`.

    `times[i]` are the times of run i less `offset`, the centre of all times, ascending strictly; `names[i]` is what the
    user knows run i by.
    """

    rows: tuple[int, ...]
    runs: tuple[tuple[int, int], ...]
    times: tuple[FloatArray, ...]
    names: tuple[str, ...]
    offset: float

    def split(self, values: FloatArray) -> list[FloatArray]:
        """Return the part of `values` (one per kept row) that belongs to each run."""
        return [values[first:last] for first, last in self.runs]


def runs_of(table: Table, rows: Sequence[int], trajectory: str | None) -> tuple[tuple[int, int], ...]:
    """Return the half-open ranges into `rows` between which a new trajectory begins."""
    numbers = table.column(trajectory) if trajectory is not None else np.zeros(table.rows)
    segment = np.zeros(table.rows, dtype=np.int64)
    for start in table.starts[1:]:
        segment[start:] += 1
    breaks = [
        place
        for place, (row, after) in enumerate(pairwise(rows), start=1)
        if segment[row] != segment[after] or numbers[row] != numbers[after]
    ]
    return tuple(pairwise([0, *breaks, len(rows)]))


def trajectories_of(table: Table, roles: Roles, rows: Sequence[int]) -> Trajectories:
    """Return the trajectories among `rows`; raises DataError when one is too short or its times do not ascend."""
    assert roles.time is not None
    raw = table.column(roles.time)[list(rows)]
    runs = runs_of(table, rows, roles.trajectory)
    for number, (first, last) in enumerate(runs, start=1):
        check_times(table, roles.time, raw[first:last], rows[first:last])
        check_length(table, rows[first:last], number)
    centre = 0.5 * (float(np.min(raw)) + float(np.max(raw)))
    times = tuple(_evened(raw[first:last], centre) for first, last in runs)
    return Trajectories(tuple(rows), runs, times, _names(table, rows, runs, roles.trajectory), centre)


def _names(
    table: Table, rows: Sequence[int], runs: Sequence[tuple[int, int]], trajectory: str | None
) -> tuple[str, ...]:
    """Return numbers from 1, or values of the trajectory column; one that comes again is followed by b, c, …"""
    if trajectory is None:
        return tuple(str(number) for number, _ in enumerate(runs, start=1))
    numbers = table.column(trajectory)
    return distinguished([plain_number(float(numbers[rows[first]])) for first, _ in runs])


def plain_number(value: float) -> str:
    """Return a number as a person would write it: without a needless fraction."""
    return f"{value:.0f}" if value.is_integer() and abs(value) < LARGEST_PLAIN else repr(value)


def distinguished(names: Sequence[str]) -> tuple[str, ...]:
    """Return `names` with a letter behind each that came before: 2, 2b, 2c, …, 2z, 2aa."""
    result: list[str] = []
    taken: set[str] = set()
    for name in names:
        number = 0
        while name + _letters(number) in taken:
            number += 1
        result.append(name + _letters(number))
        taken.add(result[-1])
    return tuple(result)


def _letters(number: int) -> str:
    """Return what follows a name that came `number` times before: nothing, b, c, …, z, aa, ab, …"""
    text, rest = "", number + 1 if number else 0
    while rest:
        rest, letter = divmod(rest - 1, 26)
        text = chr(ord("a") + letter) + text
    return text


def _evened(times: FloatArray, centre: float) -> FloatArray:
    """Return times - centre, exactly even when they are even to within their last bits."""
    precision = 4.0 * float(np.spacing(np.max(np.abs(times))))
    step = _plainest(float(times[-1]) - float(times[0]), len(times) - 1, precision)
    steps: FloatArray = step * np.arange(len(times), dtype=np.float64)
    if np.all(np.abs(times - (float(times[0]) + steps)) <= precision) and precision < 0.1 * step:
        return (float(times[0]) - centre) + steps
    return times - centre


def _plainest(length: float, steps: int, precision: float) -> float:
    """Return the step with the fewest digits that spans `length` in `steps` to within `precision`."""
    step = length / steps
    rounded = (float(f"{step:.{digits}g}") for digits in range(1, 17))
    return next((each for each in rounded if abs(each * steps - length) <= precision), step)


def in_radians(values: FloatArray, angle: Angle) -> FloatArray:
    """Return an angle's values in radians: sin and cos of expressions need them."""
    return values * RADIANS_PER_DEGREE if angle.degrees else values


def unwrapped(values: FloatArray) -> FloatArray:
    """Return an angle (radians) of one run with jumps of more than half a turn taken out."""
    turn = 2.0 * math.pi
    result = values.copy()
    turns = 0
    for index in range(1, len(values)):
        turns -= round((float(values[index]) - float(values[index - 1])) / turn)
        result[index] = float(values[index]) + turns * turn
    return result
