"""Trajectories: rows of a table that belong to one continuous measurement, their times, states and names. Pure.

Times are centred over the whole data set, and made exactly even where they are even within their own precision, so
that an offset of 1900 or of 10**9 costs no precision. Angles are unwrapped.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from atoll_coordinator.data.roles.roles import Roles
from atoll_coordinator.data.trajectories.checks import check_no_turns, check_trajectory, check_varies
from atoll_core.data.dataset import FloatArray
from atoll_core.data.table import Table
from atoll_core.errors import DataError, UsageError

_TIME_ROUNDING: Final = 4.0
"""Times are even when they are so within this many units in the last place of the largest one, and steps are this many
times as long as that: rounding."""

MANY: Final = 10
"""So many values of a trajectory column are listed in a message."""

LARGEST_PLAIN: Final = 1e15
"""Whole numbers below this are written without an exponent."""
Range = tuple[int, int]


@dataclass(frozen=True, eq=False)
class Trajectories:
    """States along trajectories.

    `names[i]` is what the user knows trajectory i by; `times[i]` are its times less `offset`, the centre of all times,
    ascending strictly; `states[name][i]` is a state along it, angles unwrapped and in radians, NaN where it is missing.
    """

    names: tuple[str, ...]
    times: tuple[FloatArray, ...]
    offset: float
    states: Mapping[str, Sequence[FloatArray]]


def find_ranges(starts: Sequence[int], rows: Sequence[int], *marks: FloatArray) -> tuple[Range, ...]:
    """Return the half-open ranges into the used `rows`, one for each trajectory.

    `starts` are rows of the table at which a file begins or blank rows end, the first one 0. Where one of the `marks`,
    numbers at all rows of the table, changes, another trajectory begins.
    """
    segments = np.searchsorted(starts, rows, side="right")
    is_break = segments[1:] != segments[:-1]
    for numbers in marks:
        is_break = is_break | (numbers[rows[1:]] != numbers[rows[:-1]])
    return tuple(pairwise([0, *(np.flatnonzero(is_break) + 1).tolist(), len(rows)]))


def split_trajectories(
    table: Table, roles: Roles, rows: list[int], ranges: Sequence[Range], columns: Mapping[str, FloatArray]
) -> Trajectories:
    """Return names, times and states along each trajectory.

    `ranges` are half-open ranges into the `rows` of the table that are used; `columns` are at these rows, angles in
    radians. Raises DataError where a trajectory is too short, its times do not ascend, or a state looks like a wrapped
    angle.
    """
    assert roles.time is not None
    times = table.column(roles.time)[rows]
    for number, (first, last) in enumerate(ranges, start=1):
        check_trajectory(table, roles.time, times[first:last], rows[first:last], number)
    known = {name: np.where(np.isfinite(columns[name]), columns[name], np.nan) for name in roles.states}
    states = {name: [values[first:last] for first, last in ranges] for name, values in known.items()}
    for name, parts in states.items():
        if name in {angle.column for angle in roles.angles}:
            states[name] = [unwrap(part) for part in parts]
            check_varies(table, name, np.concatenate(states[name]), "state")
        else:
            check_no_turns(name, parts)
    names = tuple(str(number) for number, _ in enumerate(ranges, start=1))
    if roles.trajectory is not None:
        names = distinguish([called(table, roles.trajectory, rows[first]) for first, _ in ranges])
    centre = 0.5 * (float(np.min(times)) + float(np.max(times)))
    centred = tuple(_center_times(times[first:last], centre) for first, last in ranges)
    return Trajectories(names, centred, centre, states)


def name_groups(
    table: Table, roles: Roles, names: Sequence[str], first_rows: Sequence[int], held_out: Sequence[bool]
) -> tuple[str, ...]:
    """Return the group of each trajectory, nothing where constants are the same for all.

    `first_rows` are rows of the table. Raises DataError where there is one group only, or one that is held out.
    """
    if roles.group is None and not roles.is_by_trajectory:
        return ()
    option = f"--group {roles.group}" if roles.group is not None else "--per-trajectory"
    groups = tuple(names)
    if roles.group is not None:
        groups = tuple(called(table, roles.group, row) for row in first_rows)
    if len(set(groups)) < 2:
        raise DataError(f"{option} needs constants of two groups at least, but there is one only; leave it out")
    searched = {group for group, is_out in zip(groups, held_out, strict=True) if not is_out}
    unseen = next((group for group in groups if group not in searched), None)
    if unseen is not None:
        raise DataError(f"--holdout keeps all trajectories of group {unseen}, so its constants are unknown; keep fewer")
    return groups


def select_held_out(holdout: int | str | None, trajectory: str | None, values: Sequence[str]) -> tuple[bool, ...]:
    """Return for each trajectory whether it is held out: kept from every choice, so that equations can be judged by it.

    `holdout` is how many of the last trajectories, or ``COLUMN=VALUE``; `values` has that of the column `trajectory`
    for each, as `called` returns it. Raises UsageError where they are not told apart by COLUMN, DataError where there
    are too few, or none with that value.
    """
    count = len(values)
    if isinstance(holdout, str):
        held_out = _with_value(holdout, trajectory, values)
    else:
        held_out = [place >= count - (holdout or 0) for place in range(count)]
    if all(held_out):
        there = "is only one trajectory" if count == 1 else f"are {count} trajectories"
        raise DataError(f"--holdout {holdout} would keep everything from the search: there {there}; leave at least one")
    return tuple(held_out)


def _with_value(holdout: str, trajectory: str | None, values: Sequence[str]) -> list[bool]:
    """Return for each trajectory whether it has the value that ``COLUMN=VALUE`` names."""
    name, _, text = holdout.rpartition("=")
    if name != trajectory:
        by = "blank rows or files" if trajectory is None else f"column '{trajectory}'"
        advice = f"add --trajectory {name}, or give the number of trajectories to hold out"
        raise UsageError(f"--holdout names column '{name}', but trajectories are told apart by {by}; {advice}")
    held_out = [value == _plain(text) for value in values]
    if not any(held_out):
        distinct = [*dict.fromkeys(values)]
        known = ", ".join(distinct[:MANY])
        more = ", …" if len(distinct) > MANY else ""
        raise DataError(f"--holdout {holdout}: no trajectory has this value; there are {known}{more}")
    return held_out


def _plain(text: str) -> str:
    """Return a number as `format_number` writes it, a name as it is."""
    try:
        return format_number(float(text) + 0.0)
    except ValueError:
        return text.strip()


def called(table: Table, name: str, row: int) -> str:
    """Return what a row has in a column of trajectories or groups: a name, or a number as a person would write it."""
    value = float(table.column(name)[row]) + 0.0
    label = table.label(name, value)
    return format_number(value) if label is None else label


def format_number(value: float) -> str:
    """Return a number as a person would write it: without a needless fraction."""
    return f"{value:.0f}" if value.is_integer() and abs(value) < LARGEST_PLAIN else repr(value)


def distinguish(names: Sequence[str]) -> tuple[str, ...]:
    """Return `names`, those that came before with a letter, 2, 2b, 2c, …, 2z, 2aa, or a number: a, a 2, a 3."""
    distinct: list[str] = []
    taken: set[str] = set()
    for name in names:
        number = 0
        while (distinct_name := name + _ending(name, number)) in taken:
            number += 1
        distinct.append(distinct_name)
        taken.add(distinct[-1])
    return tuple(distinct)


def _ending(name: str, number: int) -> str:
    """Return what follows a name that came `number` times before."""
    return f" {number + 1}" if number and name[:1].isalpha() else _letters(number)


def _letters(number: int) -> str:
    """Return what follows a name that came `number` times before: nothing, b, c, …, z, aa, ab, …"""
    text, rest = "", number + 1 if number else 0
    while rest:
        rest, letter = divmod(rest - 1, 26)
        text = chr(ord("a") + letter) + text
    return text


def _center_times(times: FloatArray, centre: float) -> FloatArray:
    """Return times - centre, exactly even when they are even to within their last bits."""
    precision = _TIME_ROUNDING * float(np.spacing(np.max(np.abs(times))))
    step = _round_step(float(times[-1]) - float(times[0]), len(times) - 1, precision)
    is_resolved = _TIME_ROUNDING * precision < step
    steps: FloatArray = step * np.arange(len(times), dtype=np.float64)
    if np.all(np.abs(times - (float(times[0]) + steps)) <= precision) and is_resolved:
        return (float(times[0]) - centre) + steps
    return times - centre


def _round_step(length: float, steps: int, precision: float) -> float:
    """Return the step with the fewest digits that spans `length` in `steps` to within `precision`."""
    step = length / steps
    rounded = (float(f"{step:.{digits}g}") for digits in range(1, 17))
    return next((candidate for candidate in rounded if abs(candidate * steps - length) <= precision), step)


def unwrap(values: FloatArray) -> FloatArray:
    """Return an angle (radians) of one trajectory with jumps of more than half a turn taken out, NaN passed over."""
    turn = 2.0 * math.pi
    result = values.copy()
    turns = 0
    for before, index in pairwise(np.flatnonzero(np.isfinite(values)).tolist()):
        turns -= round((float(values[index]) - float(values[before])) / turn)
        result[index] = float(values[index]) + turns * turn
    return result
