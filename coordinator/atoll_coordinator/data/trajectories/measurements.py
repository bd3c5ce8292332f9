"""The usable rows of a table as checked trajectories: the input of smoothing. Pure.

A trajectory is one continuous measurement. Times are centred over the whole data set, so that an offset of 1900 or of
10**9 does not reduce the precision. If times are evenly spaced within their precision, they are made exactly even.
Angles are unwrapped. If a gap in the times is longer than the span of smoothing, the trajectory is split there: the
motion within the gap is unknown, and no slope or simulation should cross it.

The checks are fast enough to run in a client, before it uploads the data.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np

from atoll_coordinator.data.roles.roles import Roles
from atoll_coordinator.data.trajectories.table_checks import (
    MIN_ROWS,
    check_no_turns,
    check_rates,
    check_searched_rows,
    check_sizes,
    check_trajectory,
    check_varies,
    drop_incomplete_rows,
)
from atoll_coordinator.settings import SETTINGS
from atoll_core.config import DataConfig
from atoll_core.data.dataset import FloatArray, IntArray
from atoll_core.data.table import Table
from atoll_core.errors import DataError, UsageError

RADIANS_PER_DEGREE: Final = math.pi / 180.0
MANY: Final = 10
"""Most values of a trajectory column that a message lists."""
MANY_SPLIT: Final = 5
"""Most split trajectories that a message lists."""
LARGEST_PLAIN: Final = 1e15
"""Whole numbers below this are written without an exponent."""
_TIME_ROUNDING: Final = 4.0
"""Times count as even under two conditions, in units in the last place of the largest time: they are even within this
many units, and each step is longer than this many units."""
Range = tuple[int, int]


@dataclass(frozen=True, eq=False)
class Trajectories:
    """States along trajectories.

    `names[i]` is the user's name of trajectory i; `times[i]` are its strictly ascending times minus `offset`, the
    centre of all times; `states[name][i]` is a state along the trajectory; a missing value is NaN. Angles are unwrapped
    and in radians.
    """

    names: tuple[str, ...]
    times: tuple[FloatArray, ...]
    offset: float
    states: Mapping[str, Sequence[FloatArray]]


@dataclass(frozen=True, eq=False)
class Measurements:
    """The used rows of a table: R rows, V columns.

    `columns` are the used columns (R,) by name. Angles are in radians; missing values of states are not finite.
    `ranges` are half-open ranges of rows, one for each trajectory, and `held_out` tells for each trajectory whether it
    is held out of the search. `trajectories` is None if columns hold the left-hand sides. `warnings` are sentences for
    the user. `groups` has the group of each trajectory if groups may have different constants; if not, it is empty.
    Each row is the mean of about `rows_of_mean` rows of the table.
    """

    roles: Roles
    columns: Mapping[str, FloatArray]
    ranges: tuple[Range, ...]
    held_out: tuple[bool, ...]
    trajectories: Trajectories | None
    warnings: tuple[str, ...]
    groups: tuple[str, ...] = ()
    rows_of_mean: int = 1

    @property
    def row_count(self) -> int:
        """Number of rows."""
        return self.ranges[-1][1]

    @property
    def weights(self) -> FloatArray | None:
        """The weight of each row (R,), from the column of weights; None if there is no such column."""
        return None if self.roles.weights is None else self.columns[self.roles.weights]

    @property
    def searched_rows(self) -> list[int]:
        """The rows of trajectories that the search may see."""
        return [row for (first, last), out in self._places() if not out for row in range(first, last)]

    @property
    def held_out_rows(self) -> list[int]:
        """The rows of held-out trajectories."""
        return [row for (first, last), out in self._places() if out for row in range(first, last)]

    def _places(self) -> list[tuple[Range, bool]]:
        return [*zip(self.ranges, self.held_out, strict=True)]

    @property
    def group_names(self) -> tuple[str, ...]:
        """The groups whose constants may differ, in the order of the data.

        Empty if all trajectories share the constants.
        """
        return tuple(dict.fromkeys(self.groups))

    @property
    def group_of_row(self) -> IntArray | None:
        """The group of each row (R,), as an index into `group_names`; None if there are no groups."""
        if not self.groups:
            return None
        names = self.group_names
        lengths = [last - first for first, last in self.ranges]
        return np.repeat(np.array([names.index(group) for group in self.groups], np.int64), lengths)

    @property
    def inputs(self) -> list[list[FloatArray]]:
        """Each input along each trajectory, unwrapped if it is an angle."""
        angles = {angle.column for angle in self.roles.angles}
        parts = {name: [self.columns[name][first:last] for first, last in self.ranges] for name in self.roles.inputs}
        return [list(map(unwrap, along)) if name in angles else along for name, along in parts.items()]


def take_measurements(table: Table, roles: Roles, config: DataConfig) -> Measurements:
    """Select the usable rows and check the measurements. `config` uses the column names of `table`.

    Raises UsageError if the column of ``--holdout`` does not distinguish trajectories. Raises DataError if the
    measurements cannot be used; the message names the place and gives advice.
    """
    rows, warnings = drop_incomplete_rows(table, roles, config)
    numbers = np.zeros(table.rows) if roles.trajectory is None else table.column(roles.trajectory)
    marks = [numbers] if roles.group is None else [numbers, table.column(roles.group)]
    segments = np.searchsorted(table.starts, rows, side="right")
    is_break = segments[1:] != segments[:-1]
    for values in marks:
        is_break = is_break | (values[rows[1:]] != values[rows[:-1]])
    ranges = tuple(pairwise([0, *(np.flatnonzero(is_break) + 1).tolist(), len(rows)]))
    first_rows = [rows[first] for first, _ in ranges]
    labels = ["" if roles.trajectory is None else _label(table, roles.trajectory, row) for row in first_rows]
    held_out = select_held_out(config.holdout, roles.trajectory, labels)
    searched = [row for (first, last), out in zip(ranges, held_out, strict=True) if not out for row in rows[first:last]]
    check_searched_rows(table, roles, searched)
    columns = {name: table.column(name)[rows] for name in roles.used}
    check_sizes({name: columns[name] for name in (*roles.states, *roles.inputs)})
    degrees = {angle.column for angle in roles.angles if angle.degrees}
    rates = zip(roles.states, roles.derivatives, strict=False)
    for name in degrees | {rate for state, rate in rates if state in degrees}:
        columns[name] = columns[name] * RADIANS_PER_DEGREE
    if roles.is_given:
        return Measurements(roles, columns, ranges, held_out, None, tuple(warnings))
    trajectories = _trajectories_of_ranges(table, roles, rows, ranges, columns)
    if roles.time is not None:
        check_rates(roles.time, trajectories.times, trajectories.states, config.order)
    groups = _name_groups(table, roles, trajectories.names, first_rows, held_out)
    return Measurements(roles, columns, ranges, held_out, trajectories, tuple(warnings), groups)


def _trajectories_of_ranges(
    table: Table, roles: Roles, rows: list[int], ranges: Sequence[Range], columns: Mapping[str, FloatArray]
) -> Trajectories:
    """Return names, times and states along each trajectory. `rows` are the used rows of the table, and `ranges` are
    half-open ranges of places in `rows`.

    `columns` have the values at these rows, with angles in radians. Raises DataError if a trajectory is too short, if
    its times do not ascend, or if a state looks like a wrapped angle.
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
        names = distinguish([_label(table, roles.trajectory, rows[first]) for first, _ in ranges])
    centre = 0.5 * (float(np.min(times)) + float(np.max(times)))
    centred = tuple(_center_times(times[first:last], centre) for first, last in ranges)
    return Trajectories(names, centred, centre, states)


def _name_groups(
    table: Table, roles: Roles, names: Sequence[str], first_rows: Sequence[int], held_out: Sequence[bool]
) -> tuple[str, ...]:
    """Return the group of each trajectory; empty if all trajectories share the constants.

    `first_rows` are rows of the table. Raises DataError if there is only one group, or if all trajectories of a group
    are held out.
    """
    if roles.group is None and not roles.is_by_trajectory:
        return ()
    option = f"--group {roles.group}" if roles.group is not None else "--per-trajectory"
    groups = tuple(names)
    if roles.group is not None:
        groups = tuple(_label(table, roles.group, row) for row in first_rows)
    if len(set(groups)) < 2:
        raise DataError(f"{option} needs at least two groups, but there is only one; leave it out")
    searched = {group for group, is_out in zip(groups, held_out, strict=True) if not is_out}
    unseen = next((group for group in groups if group not in searched), None)
    if unseen is not None:
        raise DataError(f"--holdout takes all trajectories of group {unseen}, so its constants are unknown; take fewer")
    return groups


def select_held_out(holdout: int | str | None, trajectory: str | None, values: Sequence[str]) -> tuple[bool, ...]:
    """Return, for each trajectory, whether it is held out. Held-out trajectories are used to judge equations, and do
    not influence any choice.

    `holdout` is the number of trajectories to hold out, from the end, or ``COLUMN=VALUE``; `values` has the value of
    the column `trajectory` for each trajectory. Raises UsageError if COLUMN does not distinguish trajectories. Raises
    DataError if there are too few trajectories, or if no trajectory has this value.
    """
    count = len(values)
    if isinstance(holdout, str):
        name, _, text = holdout.rpartition("=")
        if name != trajectory:
            by = "blank rows or files" if trajectory is None else f"column '{trajectory}'"
            advice = f"add --trajectory {name}, or give the number of trajectories to hold out"
            raise UsageError(f"--holdout names column '{name}', but trajectories are distinguished by {by}; {advice}")
        try:
            wanted = format_number(float(text) + 0.0)
        except ValueError:
            wanted = text.strip()
        held_out = [value == wanted for value in values]
        if not any(held_out):
            distinct = [*dict.fromkeys(values)]
            known = ", ".join(distinct[:MANY]) + (", …" if len(distinct) > MANY else "")
            raise DataError(f"--holdout {holdout}: no trajectory has this value; there are {known}")
    else:
        held_out = [place >= count - (holdout or 0) for place in range(count)]
    if all(held_out):
        there = "is only one trajectory" if count == 1 else f"are {count} trajectories"
        raise DataError(f"--holdout {holdout} would leave nothing for the search: there {there}; leave at least one")
    return tuple(held_out)


def _label(table: Table, name: str, row: int) -> str:
    """Return the value of a row in a column of trajectories or groups: a name, or a number."""
    value = float(table.column(name)[row]) + 0.0
    label = table.label(name, value)
    return format_number(value) if label is None else label


def format_number(value: float) -> str:
    """Return a number as text, without a fraction if it is whole."""
    return f"{value:.0f}" if value.is_integer() and abs(value) < LARGEST_PLAIN else repr(value)


def distinguish(names: Sequence[str]) -> tuple[str, ...]:
    """Return unique names. Repeated names get a letter or a number, as in 2, 2b, 2c, …, 2z, 2aa, or as in a, a 2, a
    3."""
    distinct: list[str] = []
    taken: set[str] = set()
    for name in names:
        number = 0
        while (distinct_name := name + _suffix(name, number)) in taken:
            number += 1
        distinct.append(distinct_name)
        taken.add(distinct_name)
    return tuple(distinct)


def _suffix(name: str, number: int) -> str:
    """Return the suffix of a name that occurred `number` times before: "", b, c, …, z, aa, ab, …, or a number."""
    if number and name[:1].isalpha():
        return f" {number + 1}"
    text, rest = "", number + 1 if number else 0
    while rest:
        rest, letter = divmod(rest - 1, 26)
        text = chr(ord("a") + letter) + text
    return text


def _center_times(times: FloatArray, centre: float) -> FloatArray:
    """Return `times` minus `centre`. If these differences are even to within their last bits, they are made exactly
    even."""
    precision = _TIME_ROUNDING * float(np.spacing(np.max(np.abs(times))))
    length, count = float(times[-1]) - float(times[0]), len(times) - 1
    step = length / count
    rounded = (float(f"{step:.{digits}g}") for digits in range(1, 17))  # the fewest digits that cover the length
    step = next((candidate for candidate in rounded if abs(candidate * count - length) <= precision), step)
    steps: FloatArray = step * np.arange(len(times), dtype=np.float64)
    is_even = np.all(np.abs(times - (float(times[0]) + steps)) <= precision)
    return (float(times[0]) - centre) + steps if is_even and _TIME_ROUNDING * precision < step else times - centre


def unwrap(values: FloatArray) -> FloatArray:
    """Return an angle (radians) along one trajectory, after removing jumps of more than half a turn. NaN is ignored."""
    turn = 2.0 * math.pi
    result = values.copy()
    turns = 0
    for before, index in pairwise(np.flatnonzero(np.isfinite(values)).tolist()):
        turns -= round((float(values[index]) - float(values[before])) / turn)
        result[index] = float(values[index]) + turns * turn
    return result


# -------------------------------------------------------------------------------------------------- gaps in the times


def find_pieces(times: FloatArray, span: int) -> list[Range]:
    """Return the half-open ranges of rows between gaps longer than `span` median steps.

    If the times are random, a gap of k median steps has the probability 2^-k. A gap that may be due to chance does not
    end a range.
    """
    steps = np.diff(times)
    by_chance = int(1.0 / SETTINGS.common.improbable).bit_length()
    longest = max(span, by_chance) * float(np.sort(steps)[len(steps) // 2])
    return list(pairwise([0, *(np.flatnonzero(steps > longest) + 1).tolist(), len(times)]))


def split_at_gaps(measurements: Measurements, span: int) -> Measurements:
    """Return `measurements` with trajectories split at gaps longer than `span` median steps. If there are no such gaps,
    return the same object.

    Pieces that are too short to be differentiated are left out. If too few rows would remain, no trajectory is split.
    """
    whole = measurements.trajectories
    assert whole is not None
    pieces = [find_pieces(times, span) for times in whole.times]
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
    split = take_pieces(measurements, long_enough)
    assert split.trajectories is not None
    names = iter(split.trajectories.names)
    names_of = {whole.names[number]: [next(names) for _ in its] for number, its in enumerate(long_enough)}
    texts = [f"{name} into {', '.join(its)}" for name, its in names_of.items() if len(its) > 1]
    listed = "; ".join(texts[:MANY_SPLIT]) + ("; …" if len(texts) > MANY_SPLIT else "")
    listed = f": {listed}" if listed else ""
    warning = f"{counted} longer than the span of smoothing; trajectories are split there{listed}."
    warnings = [*measurements.warnings, warning]
    left_out = measurements.row_count - split.row_count
    if left_out:
        warnings.append(f"{left_out} rows in pieces of fewer than {MIN_ROWS} rows between gaps are left out.")
    return replace(split, warnings=tuple(warnings))


def take_pieces(measurements: Measurements, pieces: Sequence[Sequence[Range]]) -> Measurements:
    """Return `measurements` in which each of the `pieces` is a separate trajectory. The pieces of a trajectory are
    ranges of its rows."""
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
