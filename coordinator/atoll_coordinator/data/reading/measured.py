"""A table whose columns have been given their parts and checked: all that is known before anything is computed. Pure.

Cheap enough for a client to meet every objection to its data before it uploads them.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from atoll.config import Angle, DataConfig
from atoll.data.dataset import FloatArray
from atoll.data.table import Table
from atoll_coordinator.data.reading import checks
from atoll_coordinator.data.reading.columns import Roles, resolve, without_units
from atoll_coordinator.data.row_selection.weights import relative_weights, weighty_rows
from atoll_coordinator.data.trajectories.holdout import held_out_runs
from atoll_coordinator.data.trajectories.trajectories import (
    Trajectories,
    in_radians,
    runs_of,
    trajectories_of,
    unwrapped,
)


@dataclass(frozen=True, eq=False)
class Measured:
    """The rows kept of a table and what its columns mean.

    `rows` are indices into the table; `runs` half-open ranges into `rows`, one per trajectory, and `held_out` says of
    each whether it is kept from the search; `trajectories` is None where the left-hand sides are given;
    `states[name][i]` is a state along trajectory i, angles unwrapped; `warnings` are sentences for the user.
    """

    table: Table
    config: DataConfig
    roles: Roles
    rows: tuple[int, ...]
    runs: tuple[tuple[int, int], ...]
    held_out: tuple[bool, ...]
    trajectories: Trajectories | None
    states: dict[str, list[FloatArray]]
    warnings: tuple[str, ...]

    @cached_property
    def weights(self) -> FloatArray | None:
        """How much each of the rows kept counts, (R,), 1 on average; None where all count alike."""
        return None if self.roles.weights is None else relative_weights(self.column(self.roles.weights))

    def indices(self, *, held_out: bool) -> list[int]:
        """Return the indices into `rows` of those that are held out, or of those that are not."""
        chosen = [run for run, is_held_out in zip(self.runs, self.held_out, strict=True) if is_held_out == held_out]
        return [index for first, last in chosen for index in range(first, last)]

    def column(self, name: str, angle_of: str | None = None) -> FloatArray:
        """Return column `name` at the rows kept, in radians if it (or the state `angle_of`) is an angle in degrees."""
        values = np.ascontiguousarray(self.table.column(name)[list(self.rows)])
        angle = _angle(self.config, angle_of or name)
        return in_radians(values, angle) if angle is not None else values

    def along(self, name: str) -> list[FloatArray]:
        """Return column `name` along each trajectory, unwrapped if it is an angle."""
        values = self.column(name)
        parts = [values[first:last] for first, last in self.runs]
        return parts if _angle(self.config, name) is None else [unwrapped(part) for part in parts]


def measured(table: Table, config: DataConfig) -> Measured:
    """Give every column its part and check what was measured.

    Raises:
        UsageError: options contradict each other.
        DataError: the measurements cannot be used as they are; the message says where and what to do.
    """
    config = without_units(config, table.names)
    roles = resolve(table, config)
    checks.check_rows(table, table.rows)
    counted, unused = weighty_rows(table, roles.weights)
    rows, dropped = checks.finite_rows(table, roles, counted, config.missing == "drop")
    runs = runs_of(table, rows, roles.trajectory)
    held_out = held_out_runs(config.holdout, table, roles, rows, runs)
    seen = [row for (first, last), out in zip(runs, held_out, strict=True) if not out for row in rows[first:last]]
    checks.check_rows(table, len(seen))
    for name in roles.derivatives or roles.equations:
        part = "state" if name in roles.states else "derivative" if roles.derivatives else "target"
        checks.check_varies(table, name, table.column(name)[seen], part)
    said = [sentence for sentence in (unused, dropped) if sentence is not None]
    warnings = (*said, *_remarks(table, roles, rows, config))
    if roles.target is not None or roles.derivatives:
        return Measured(table, config, roles, tuple(rows), runs, held_out, None, {}, warnings)
    trajectories = trajectories_of(table, roles, rows)
    states = {name: _along(table, name, trajectories, config) for name in roles.states}
    return Measured(table, config, roles, tuple(rows), runs, held_out, trajectories, states, warnings)


def _angle(config: DataConfig, name: str) -> Angle | None:
    return next((angle for angle in config.angles if angle.column == name), None)


def _along(table: Table, name: str, trajectories: Trajectories, config: DataConfig) -> list[FloatArray]:
    """Return a state along each trajectory, unwrapped if it is an angle; raises DataError if it should be."""
    parts = trajectories.split(table.column(name)[list(trajectories.rows)])
    angle = _angle(config, name)
    if angle is None:
        checks.check_no_turns(name, parts)
        return [np.ascontiguousarray(part) for part in parts]
    turned = [unwrapped(in_radians(part, angle)) for part in parts]
    checks.check_varies(table, name, np.concatenate(turned), "state")
    return turned


def _remarks(table: Table, roles: Roles, rows: list[int], config: DataConfig) -> list[str]:
    """Return sentences about choices that the user may not expect."""
    remarks = []
    if table.skipped:
        remarks.append(f"Columns of text or without a name are not used: {', '.join(table.skipped)}.")
    if roles.target is not None and config.states is None and not config.inputs:
        left = [name for name in ("t", "time") if name in table.names and name not in roles.used]
        remarks += [f"Column '{name}' is taken for time and not used; add --inputs {name} to use it." for name in left]
    degrees = [angle.column for angle in config.angles if angle.degrees]
    if degrees:
        remarks.append(f"Degrees were converted to radians: {', '.join(degrees)}.")
    variables = [name for name in (*roles.states, *roles.inputs) if name not in roles.equations or roles.derivatives]
    constant = [name for name in variables if np.all(table.column(name)[rows] == table.column(name)[rows[0]])]
    remarks += [f"Column '{name}' is constant and of no use to an equation." for name in constant]
    return remarks
