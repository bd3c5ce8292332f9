"""The rows of a table that are used, checked: all that is known before anything is smoothed. Pure.

Cheap enough for a client to meet every objection to its data before it uploads them.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from atoll_coordinator.data.roles.roles import Roles
from atoll_coordinator.data.trajectories.checks import (
    check_rates,
    check_searched_rows,
    check_sizes,
    select_usable_rows,
)
from atoll_coordinator.data.trajectories.trajectories import (
    Range,
    Trajectories,
    called,
    find_ranges,
    name_groups,
    select_held_out,
    split_trajectories,
    unwrap,
)
from atoll_core.config import DataConfig
from atoll_core.data.dataset import FloatArray, IntArray
from atoll_core.data.table import Table

RADIANS_PER_DEGREE: Final = math.pi / 180.0


@dataclass(frozen=True, eq=False)
class Measurements:
    """What was measured in the R rows of a table that are used.

    `columns[name]` (R,) are the used columns, angles in radians, states not finite where they are missing; `ranges` are
    half-open ranges of rows, one for each trajectory, and `held_out` says of each whether it is kept from the search;
    `trajectories` is None where the left-hand sides are given; `warnings` are sentences for the user; `groups` has the
    group of each trajectory where these may differ in constants, else nothing. Each row is the mean of about
    `rows_of_mean` rows of the table.
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
        """How many rows there are."""
        return self.ranges[-1][1]

    @property
    def weights(self) -> FloatArray | None:
        """The weight of each row as it was given, (R,); None without a column of weights."""
        return None if self.roles.weights is None else self.columns[self.roles.weights]

    @property
    def searched_rows(self) -> list[int]:
        """The rows of trajectories that the search may see."""
        return self._rows(held_out=False)

    @property
    def held_out_rows(self) -> list[int]:
        """The rows of held-out trajectories."""
        return self._rows(held_out=True)

    @property
    def group_names(self) -> tuple[str, ...]:
        """The groups whose constants may differ, in the order of the data; none where all share them."""
        return tuple(dict.fromkeys(self.groups))

    @property
    def group_of_row(self) -> IntArray | None:
        """The group of each row (R,), by its place among `group_names`; None where there are none."""
        if not self.groups:
            return None
        names = self.group_names
        lengths = [last - first for first, last in self.ranges]
        return np.repeat(np.array([names.index(group) for group in self.groups], np.int64), lengths)

    def _rows(self, *, held_out: bool) -> list[int]:
        places = zip(self.ranges, self.held_out, strict=True)
        return [row for (first, last), is_out in places if is_out == held_out for row in range(first, last)]

    @property
    def inputs(self) -> list[list[FloatArray]]:
        """Each input along each trajectory, unwrapped if it is an angle."""
        angles = {angle.column for angle in self.roles.angles}
        parts = {name: [self.columns[name][first:last] for first, last in self.ranges] for name in self.roles.inputs}
        return [list(map(unwrap, along)) if name in angles else along for name, along in parts.items()]


def take_measurements(table: Table, roles: Roles, config: DataConfig) -> Measurements:
    """Select the rows that are used and check what was measured; `config` names columns as `table` does.

    Raises UsageError where the column named does not tell the trajectories to hold out apart, DataError where the
    measurements cannot be used as they are: the message says where and what to do.
    """
    rows, warnings = select_usable_rows(table, roles, config)
    numbers = np.zeros(table.rows) if roles.trajectory is None else table.column(roles.trajectory)
    marks = [numbers] if roles.group is None else [numbers, table.column(roles.group)]
    ranges = find_ranges(table.starts, rows, *marks)
    first_rows = [rows[first] for first, _ in ranges]
    values = ["" if roles.trajectory is None else called(table, roles.trajectory, row) for row in first_rows]
    held_out = select_held_out(config.holdout, roles.trajectory, values)
    searched = [row for (first, last), out in zip(ranges, held_out, strict=True) if not out for row in rows[first:last]]
    check_searched_rows(table, roles, searched)
    columns = {name: table.column(name)[rows] for name in roles.used}
    check_sizes({name: columns[name] for name in (*roles.states, *roles.inputs)})
    in_degrees = {angle.column: angle.degrees for angle in roles.angles}
    degrees = {name for name, is_so in in_degrees.items() if is_so}
    rates = zip(roles.states, roles.derivatives, strict=False)
    for name in degrees | {rate for state, rate in rates if state in degrees}:
        columns[name] = columns[name] * RADIANS_PER_DEGREE
    is_given = roles.target is not None or roles.derivatives
    trajectories = None if is_given else split_trajectories(table, roles, rows, ranges, columns)
    if trajectories is not None and roles.time is not None:
        check_rates(roles.time, trajectories.times, trajectories.states, config.order)
    groups = () if trajectories is None else name_groups(table, roles, trajectories.names, first_rows, held_out)
    return Measurements(roles, columns, ranges, held_out, trajectories, tuple(warnings), groups)
