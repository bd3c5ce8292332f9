"""Which column plays which part: time, trajectory, states, inputs, target, given derivatives. Pure."""

import difflib
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

from atoll.config import DataConfig
from atoll.data.table import Table
from atoll.errors import DataError, UsageError

TIME_NAMES: Final = ("t", "time")
TRAJECTORY_NAME: Final = "trajectory"
_WITH_UNIT = re.compile(r"^(?P<name>.*?)\s*\[(?P<unit>[^\[\]]*)\]$", re.DOTALL)


@dataclass(frozen=True)
class Roles:
    """Column names by the part they play; `inputs` are variables without an equation.

    `target` is set in explicit regression and `derivatives` (one per state) where they are given; with neither, the
    states are differentiated in time. `weights` says how much each row counts.
    """

    time: str | None
    trajectory: str | None
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    target: str | None = None
    derivatives: tuple[str, ...] = ()
    weights: str | None = None

    @property
    def used(self) -> tuple[str, ...]:
        """Every column that is looked at, once."""
        extra = [name for name in (self.time, self.trajectory, self.target, self.weights) if name is not None]
        return tuple(dict.fromkeys((*extra, *self.states, *self.inputs, *self.derivatives)))

    @property
    def equations(self) -> tuple[str, ...]:
        """Columns for which an equation is sought."""
        return self.states if self.target is None else (self.target,)


def variable_columns(roles: Roles, order: int) -> tuple[str, ...]:
    """Return what expressions may use: states, for order 2 their velocities, and inputs."""
    return (*roles.states, *velocity_columns(roles, order), *roles.inputs)


def velocity_columns(roles: Roles, order: int) -> tuple[str, ...]:
    """Return the names of the velocities that are variables: one for each state for order 2, else none."""
    taken = (*roles.states, *roles.inputs)
    return tuple(_fresh(f"{name}_dot", taken) for name in roles.states) if order == 2 else ()


def left_hand_side(roles: Roles, name: str, order: int) -> str:
    """Return how the left-hand side of the equation `name` is printed."""
    if roles.target is not None:
        return name
    time = roles.time or "t"
    return f"d2{name}/d{time}2" if order == 2 else f"d{name}/d{time}"


def _fresh(name: str, taken: Sequence[str]) -> str:
    return _fresh(name + "_", taken) if name in taken else name


def mentioned(config: DataConfig) -> frozenset[str]:
    """Return every column name that the options mention."""
    named = (config.time, config.trajectory, config.target, config.weights)
    single = [name for name in named if name is not None]
    angles = [angle.column for angle in config.angles]
    several = (*(config.states or ()), *config.inputs, *(config.derivatives or ()), *(config.only or ()))
    return frozenset((*single, *several, *angles, *config.offsets))


def split_unit(header: str) -> tuple[str, str]:
    """Split ``name [unit]``; a header that is nothing but a unit stays whole."""
    match = _WITH_UNIT.match(header.strip())
    if match is None or not match["name"]:
        return header.strip(), ""
    return match["name"], match["unit"].strip()


def without_units(config: DataConfig, names: Iterable[str]) -> DataConfig:
    """Return `config` with ``name [unit]`` shortened to ``name`` wherever only that is among `names`."""
    known = set(names)

    def plain(name: str) -> str:
        return name if name in known or split_unit(name)[0] not in known else split_unit(name)[0]

    def several(those: Iterable[str] | None) -> tuple[str, ...] | None:
        return None if those is None else tuple(plain(name) for name in those)

    single = {part: getattr(config, part) for part in ("time", "trajectory", "target", "weights")}
    changes: dict[str, object] = {part: plain(name) for part, name in single.items() if name is not None}
    changes |= {part: several(getattr(config, part)) for part in ("states", "inputs", "derivatives", "only", "offsets")}
    if isinstance(config.holdout, str):
        name, _, value = config.holdout.rpartition("=")
        changes["holdout"] = f"{plain(name.strip())}={value.strip()}"
    changes["angles"] = tuple(angle.model_copy(update={"column": plain(angle.column)}) for angle in config.angles)
    return config.model_copy(update=changes)


def trajectory_name(names: Iterable[str], config: DataConfig) -> str | None:
    """Return the trajectory column: the one named, else one called ``trajectory`` that has no other part."""
    if config.trajectory is not None:
        return config.trajectory
    return TRAJECTORY_NAME if TRAJECTORY_NAME in names and TRAJECTORY_NAME not in mentioned(config) else None


def resolve(table: Table, config: DataConfig) -> Roles:
    """Decide the part of every column; raises UsageError for contradictory options, DataError for unknown columns."""
    check_options(config)
    for name in sorted(mentioned(config)):
        check_known(name, table)
    roles = _resolved(table.names, config)
    _check_time(roles, table)
    _check_equations(roles, config)
    _check_angles(roles, config)
    return roles


def check_known(name: str, table: Table) -> None:
    """Raise DataError when the table has no column `name`."""
    if name in table.names:
        return
    if name in table.skipped:
        raise DataError(f"column '{name}' holds text; a column of numbers is expected")
    close = difflib.get_close_matches(name, table.names, n=1, cutoff=0.6)
    hint = f"; did you mean '{close[0]}'?" if close else ""
    raise DataError(f"there is no column '{name}' in {table.files[0]}, which has {', '.join(table.names)}{hint}")


def check_options(config: DataConfig) -> None:
    """Raise UsageError when options contradict each other, whatever the data."""
    if config.target is not None and config.derivatives is not None:
        raise UsageError("--target and --derivatives exclude each other; give the one column set that is sought")
    if config.order == 2 and config.target is not None:
        raise UsageError("--order 2 and --target exclude each other; explicit regression has no time derivative")
    if config.holdout is not None and config.target is not None:
        raise UsageError(
            "--holdout and --target exclude each other; rows of an explicit regression are no trajectories"
        )
    if config.order == 2 and config.derivatives is not None:
        raise UsageError("--order 2 and --derivatives exclude each other; the velocity has to be derived from the data")
    if config.derivatives is not None and config.states is not None and len(config.derivatives) != len(config.states):
        counts = f"{len(config.states)} states and {len(config.derivatives)} derivatives"
        raise UsageError(f"{counts} were named; give one derivative per state, in the same order")
    if config.offsets and (config.target is not None or config.derivatives is not None):
        other = "--target" if config.target is not None else "--derivatives"
        raise UsageError(f"--offsets and {other} exclude each other; offsets belong to states measured in time")
    _check_parts(config)


def _check_parts(config: DataConfig) -> None:
    """Raise UsageError when one column is given two parts, or one part twice."""
    parts: list[tuple[str, Sequence[str]]] = [
        ("a state", config.states or ()),
        ("an input", config.inputs),
        ("a derivative", config.derivatives or ()),
        ("the target", [config.target] if config.target is not None else []),
        ("the trajectory column", [config.trajectory] if config.trajectory is not None else []),
        ("the time", [config.time] if config.time is not None else []),
        ("the weights", [config.weights] if config.weights is not None else []),
    ]
    owner: dict[str, str] = {}
    for part, names in parts:
        for name in names:
            if owner.get(name, part) != part and {owner[name], part} != {"an input", "the time"}:
                raise UsageError(f"column '{name}' cannot be both {owner[name]} and {part}; name it once")
            if list(names).count(name) > 1:
                raise UsageError(f"column '{name}' is named twice as {part}; name it once")
            owner[name] = part


def _resolved(names: Sequence[str], config: DataConfig) -> Roles:
    time = config.time or next((name for name in TIME_NAMES if name in names and _is_free(name, config)), None)
    trajectory = trajectory_name(names, config)
    taken = {time, trajectory, config.target, config.weights, *config.inputs, *(config.derivatives or ())}
    rest = tuple(name for name in names if name not in taken)
    if config.target is not None:
        inputs = (*(config.states or ()), *config.inputs)
        if not inputs:
            inputs = rest or ((time,) if time is not None else ())
        return Roles(None, trajectory, (), inputs, target=config.target, weights=config.weights)
    states = config.states if config.states is not None else rest
    return Roles(time, trajectory, states, config.inputs, derivatives=config.derivatives or (), weights=config.weights)


def _is_free(name: str, config: DataConfig) -> bool:
    """Say whether a column called t or time may be the time: as an input it may, with another part it may not."""
    other = (config.target, config.trajectory, config.weights, *(config.states or ()), *(config.derivatives or ()))
    return name not in other


def _check_time(roles: Roles, table: Table) -> None:
    """Raise DataError when there is a time, but as text."""
    name = next((name for name in TIME_NAMES if name in table.skipped), None)
    if name is not None and roles.time is None and roles.target is None and not roles.derivatives:
        raise DataError(f"column '{name}' of {table.files[0]} holds text, such as dates; convert it to numbers first")


def _check_equations(roles: Roles, config: DataConfig) -> None:
    if not roles.equations:
        raise DataError("no column is left to be a state; name the states with --states")
    if roles.target is not None and not roles.inputs:
        raise DataError(f"there is no column besides '{roles.target}' from which it could be computed; add one")
    if roles.derivatives and len(roles.derivatives) != len(roles.states):
        states = ", ".join(roles.states)
        counts = f"{len(roles.derivatives)} derivatives were named for the states {states}"
        raise UsageError(f"{counts}; name as many states with --states, in the same order")
    if roles.target is None and not roles.derivatives and roles.time is None:
        looked = config.time or " or ".join(TIME_NAMES)
        raise DataError(f"no time column was found (looked for {looked}); name it with --time, or use --target COLUMN")
    for name in config.only or ():
        if name not in roles.equations:
            raise UsageError(f"--only names '{name}', but equations are sought for {', '.join(roles.equations)}")
    for name in config.offsets:
        if name not in roles.states:
            raise UsageError(f"--offsets names '{name}', but the states are {', '.join(roles.states)}; remove it")


def _check_angles(roles: Roles, config: DataConfig) -> None:
    for angle in config.angles:
        if angle.column not in (*roles.states, *roles.inputs, roles.target):
            raise UsageError(f"--angle names '{angle.column}', which is neither a state nor an input; remove it")
        if roles.target is not None and angle.column == roles.target:
            raise UsageError(f"--angle names '{angle.column}', the target of an explicit regression; remove it")
