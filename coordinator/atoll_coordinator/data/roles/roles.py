"""The role of every column: time, trajectory, state, input, target, derivative, weight. Pure."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from atoll_coordinator.data.roles.column_options import check_options, named_columns, strip_units
from atoll_coordinator.data.roles.time_column import TIME_NAMES, find_time_column
from atoll_coordinator.data.roles.trajectory_column import find_trajectory_column
from atoll_coordinator.settings import SETTINGS
from atoll_coordinator.units import parse_unit
from atoll_core.config import Angle, DataConfig
from atoll_core.data.table import Table
from atoll_core.errors import DataError, UsageError
from atoll_core.quoting import did_you_mean


@dataclass(frozen=True)
class Roles:
    """Column names by their role; `inputs` are variables without an equation.

    `target` is set in explicit regression and `derivatives` (one per state) where they are given; with neither, the
    states are differentiated in time, `order` times. `weights` is the column that says how much each row counts.
    `held` are the inputs that keep their value from one row to the next.
    `angles` are the states and inputs that are angles, with their unit; `offsets` the states measured up to an offset.
    Trajectories with different values in column `group` may differ in constants; so may all where this
    `is_by_trajectory`.
    """

    time: str | None
    trajectory: str | None
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    target: str | None = None
    derivatives: tuple[str, ...] = ()
    weights: str | None = None
    order: Literal[1, 2] = 1
    angles: tuple[Angle, ...] = ()
    offsets: tuple[str, ...] = ()
    group: str | None = None
    is_by_trajectory: bool = False
    held: tuple[str, ...] = ()

    @property
    def used(self) -> tuple[str, ...]:
        """Every column that is used, once."""
        single = (self.time, self.trajectory, self.group, self.target, self.weights)
        every = (*single, *self.states, *self.inputs, *self.derivatives)
        return tuple(dict.fromkeys(name for name in every if name is not None))

    @property
    def equations(self) -> tuple[str, ...]:
        """Columns for which an equation is sought."""
        return self.states if self.target is None else (self.target,)

    @property
    def left_hand_sides(self) -> dict[str, str]:
        """The left-hand side of each equation as it is printed."""
        if self.target is not None:
            return {self.target: self.target}
        time, power = self.time or "t", "2" if self.order == 2 else ""
        return {name: f"d{power}{name}/d{time}{power}" for name in self.states}

    def left_hand_side(self, name: str) -> str:
        """Return the left-hand side of one equation, which may be that of a component of a diffusion."""
        return self.left_hand_sides.get(name) or f"d{name}/d{self.time or 't'}"

    @property
    def velocities(self) -> tuple[str, ...]:
        """Names of the velocities that are variables: one for each state for order 2, else none."""
        taken = (*self.states, *self.inputs)
        return tuple(_unused(f"{name}_dot", taken) for name in self.states) if self.order == 2 else ()

    @property
    def variables(self) -> tuple[str, ...]:
        """What expressions may use: states, for order 2 their velocities, and inputs."""
        return (*self.states, *self.velocities, *self.inputs)


def _unused(name: str, taken: Sequence[str]) -> str:
    return _unused(name + "_", taken) if name in taken else name


def assign_roles(table: Table, config: DataConfig) -> tuple[Roles, DataConfig]:
    """Return the role of every column, and `config` with columns named as the table does, without units.

    Raises UsageError where options contradict each other, DataError for a column that does not exist or holds text.
    """
    config = strip_units(config, table.names)
    check_options(config)
    trajectory = find_trajectory_column(table.names, config)
    for name in sorted(named_columns(config)):
        _check_known(name, table, may_be_text=name in (config.trajectory, config.group))
    if isinstance(config.holdout, str):
        _check_known(config.holdout.rpartition("=")[0], table)
    for name, unit in config.units.items():
        _check_known(name, table)
        try:
            parse_unit(unit)
        except UsageError as error:
            raise UsageError(f"--unit for '{name}': {error}") from error
    roles = assigned(table.names, config, trajectory)
    if not _has_time_or_slopes(roles):
        _check_no_text_time(table)
    _check_equations(roles, config, table)
    _check_angles(roles)
    _check_held(roles)
    return roles, config


def _check_known(name: str, table: Table, *, may_be_text: bool = False) -> None:
    """Raise DataError when the table has no column `name`."""
    if name in table.names:
        return
    if name in table.skipped:
        raise DataError(f"column '{name}' holds text; a column of numbers is expected")
    texts = table.skipped if may_be_text else ()
    of_text = f", and with text {', '.join(texts)}" if texts else ""
    hint = did_you_mean(name, (*table.names, *texts))
    raise DataError(
        f"there is no column '{name}' in {table.files[0]}, which has {', '.join(table.names)}{of_text}{hint}"
    )


def assigned(names: Sequence[str], config: DataConfig, trajectory: str | None) -> Roles:
    """Return the roles of columns by their names alone; nothing is checked."""
    time = find_time_column(names, config)
    taken = {time, trajectory, config.group, config.target, config.weights, *config.inputs, *(config.derivatives or ())}
    rest = tuple(name for name in names if name not in taken)
    states, inputs = config.states if config.states is not None else rest, config.inputs
    if config.target is not None:
        inputs = (*(config.states or ()), *config.inputs) or rest or ((time,) if time is not None else ())
        time, states = None, ()
    return Roles(
        time,
        trajectory,
        states,
        inputs,
        config.target,
        config.derivatives or (),
        config.weights,
        config.order,
        config.angles,
        config.offsets,
        config.group,
        config.per_trajectory,
        config.hold,
    )


def _has_time_or_slopes(roles: Roles) -> bool:
    """Say whether left-hand sides can be had: given in columns, or as derivatives in the time."""
    return roles.time is not None or roles.target is not None or bool(roles.derivatives)


def _check_equations(roles: Roles, config: DataConfig, table: Table) -> None:
    if not roles.equations:
        used = [f"'{name}'" for name in roles.used if name in table.names]
        beside = f" besides {' and '.join(used)}" if used else ""
        raise DataError(
            f"no column of numbers is left in {table.files[0]} to be a state{beside}; add one for each state"
        )
    clash = next((name for name in roles.states if roles.order == 2 and f"{name}_dot" in roles.states), None)
    if clash is not None:
        reason = f"'{clash}_dot' is a state and with --order 2 also the name of the velocity of '{clash}'"
        raise DataError(f"{reason}; name the states without it, as --states {clash}, or leave --order 2 out")
    if roles.target is not None and not roles.inputs:
        raise DataError(f"there is no column besides '{roles.target}' from which it could be computed; add one")
    if roles.derivatives and len(roles.derivatives) != len(roles.states):
        states = ", ".join(roles.states)
        counts = f"{len(roles.derivatives)} derivatives were named for the states {states}"
        raise UsageError(f"{counts}; name as many states with --states, in the same order")
    if not _has_time_or_slopes(roles):
        raise _missing_time(table, roles.states, config)
    for name in config.only or ():
        if name not in roles.equations:
            sought = f"equations are sought for {', '.join(roles.equations)}{did_you_mean(name, roles.equations)}"
            raise UsageError(f"--only names '{name}', but {sought}")
    for name in config.offsets:
        if name not in roles.states:
            raise UsageError(f"--offsets names '{name}', but the states are {', '.join(roles.states)}; remove it")


def _check_angles(roles: Roles) -> None:
    for angle in roles.angles:
        if angle.column == roles.target:
            raise UsageError(f"--angle names '{angle.column}', the target of an explicit regression; remove it")
        if angle.column not in (*roles.states, *roles.inputs):
            raise UsageError(f"--angle names '{angle.column}', which is neither a state nor an input; remove it")


def _check_held(roles: Roles) -> None:
    for name in roles.held:
        if name not in roles.inputs:
            known = ", ".join(roles.inputs) or "none; name it with --inputs"
            raise UsageError(f"--hold names '{name}', but the inputs are {known}")
        if name == roles.time:
            raise UsageError(f"--hold names '{name}', the time, which does not stay the same between rows; remove it")


def _check_no_text_time(table: Table) -> None:
    """Raise DataError when a column is called as the time is, but holds text; for a table without a time."""
    name = next((name for name in TIME_NAMES if name in table.skipped), None)
    if name is not None:
        reason = f"column '{name}' of {table.files[0]} holds text that is neither a number nor a date"
        raise DataError(f"{reason}; write numbers, or dates as year-month-day")


def _missing_time(table: Table, states: Sequence[str], config: DataConfig) -> DataError:
    """Return the error of a table without a time; it names a state that may be the time."""
    looked = config.time or " or ".join(TIME_NAMES[:2])
    has_others = len(states) > 1
    breaks = {name: _breaks(table, name) for name in states} if has_others else {}
    ascending = next((name for name, count in breaks.items() if count == 0), None)
    restarting = next((name for name, count in breaks.items() if count is not None and count > 0), None)
    advice = [] if ascending is None else [f"name it with --time (perhaps {ascending})"]
    if ascending is None and restarting is not None:
        advice = [f"name it with --time (perhaps {restarting}; it begins anew: add --trajectory COLUMN, or blank rows)"]
    advice.append("give the time between rows, as --step 0.1, if it is always the same")
    advice += ["use --target COLUMN, for one column as a function of the others"] if has_others else []
    return DataError(f"no time column was found (looked for {looked}); {', or '.join(advice)}")


def _breaks(table: Table, name: str) -> int | None:
    """Return how often the numbers of a column do not grow within a trajectory, as times that begin anew do not.

    None where that is no time: stretches between two such rows are too short for a trajectory.
    """
    steps = np.delete(np.diff(table.column(name)), [start - 1 for start in table.starts if start])
    ends = np.flatnonzero(~(steps > 0.0))
    stretches = np.diff(np.concatenate([[-1], ends, [len(steps)]]))
    is_long = not len(ends) or int(stretches.min()) >= SETTINGS.checks.min_rows
    return len(ends) if len(steps) and is_long else None
