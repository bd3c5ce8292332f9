"""The role of every column (time, trajectory, state, input, target, derivative, weight) and its symbol. Pure."""

import keyword
import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain, count
from typing import Final, Literal

import numpy as np

from atoll_coordinator.data.roles.names_and_options import (
    TIME_NAMES,
    check_options,
    find_time_column,
    find_trajectory_column,
    named_columns,
    strip_units,
)
from atoll_coordinator.settings import SETTINGS
from atoll_coordinator.units import parse_unit
from atoll_core.config import Angle, DataConfig
from atoll_core.data.table import Table
from atoll_core.errors import DataError, UsageError
from atoll_core.quoting import did_you_mean

RESERVED: Final = frozenset(
    {"sin", "cos", "tan", "cot", "sec", "csc", "asin", "acos", "atan", "sinh", "cosh", "tanh", "exp", "log", "ln"}
    | {"sqrt", "abs", "Abs", "pow", "Pow", "inverse", "square", "neg", "sign"}
    | {"Symbol", "Function", "Integer", "Float", "Rational", "Number"}
)
"""Functions of expressions, and the names that sympy's parser itself inserts into the code that it evaluates."""


@dataclass(frozen=True)
class Roles:
    """Column names by their role; `inputs` are variables without an equation.

    `target` is set in explicit regression, `derivatives` (one for each state) if columns hold them; otherwise the
    states are differentiated in time, `order` times. `weights` is the column of the weights of rows. `held` are the
    inputs that keep their value from one row to the next. `angles` are the states and inputs that are angles, with
    their unit; `offsets` are the states measured up to an offset. Trajectories with different values in column `group`
    may have different constants; if `is_by_trajectory`, each trajectory may. `hidden` states have no column; `observed`
    are the columns among `states` that are computed from states and have no equation of their own. `by_run` are the
    parameters, among the hidden states, of which each trajectory has a value of its own.
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
    hidden: tuple[str, ...] = ()
    observed: tuple[str, ...] = ()
    by_run: tuple[str, ...] = ()

    @property
    def used(self) -> tuple[str, ...]:
        """Every used column, without repetition."""
        single = (self.time, self.trajectory, self.group, self.target, self.weights)
        every = (*single, *self.states, *self.inputs, *self.derivatives)
        return tuple(dict.fromkeys(name for name in every if name is not None))

    @property
    def is_given(self) -> bool:
        """Whether columns hold the left-hand sides: a target or derivatives."""
        return self.target is not None or bool(self.derivatives)

    @property
    def equations(self) -> tuple[str, ...]:
        """Columns and hidden states whose equations are searched."""
        if self.target is not None:
            return (self.target,)
        return (*(name for name in self.states if name not in self.observed), *self.hidden)

    def left_hand_side(self, name: str) -> str:
        """Return the left-hand side of an equation, or of a component of a diffusion, as it is printed."""
        if self.target is not None:
            return self.target
        power = "2" if self.order == 2 else ""
        return f"d{power}{name}/d{self.time or 't'}{power}"

    @property
    def velocities(self) -> tuple[str, ...]:
        """Names of the velocities that are variables: one for each state for order 2, otherwise empty."""
        names = []
        for state in self.states if self.order == 2 else ():
            name = f"{state}_dot"
            while name in (*self.states, *self.inputs):
                name += "_"
            names.append(name)
        return tuple(names)

    @property
    def variables(self) -> tuple[str, ...]:
        """Names that expressions may use: states, for order 2 their velocities, and inputs."""
        states = (name for name in self.states if name not in self.observed)
        return (*states, *self.hidden, *self.velocities, *self.inputs)


def assign_roles(table: Table, config: DataConfig) -> tuple[Roles, DataConfig]:
    """Return the role of every column, and `config` with column names as in the table, without units.

    `assign_roles_by_name` assigns the roles; this function checks names, options and the columns with an equation.
    Raises UsageError if options contradict each other, DataError for a column that does not exist or holds text.
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
    roles = assign_roles_by_name(table.names, config, trajectory)
    text_time = next((name for name in TIME_NAMES if name in table.skipped), None)
    if roles.time is None and not roles.is_given and text_time is not None:
        reason = f"column '{text_time}' of {table.files[0]} holds text that is neither a number nor a date"
        raise DataError(f"{reason}; write numbers, or dates as year-month-day")
    _check_hidden_states(roles, config, table.names)
    _check_equations(roles, config, table)
    _check_named_roles(roles, config)
    return roles, config


def assign_roles_by_name(names: Sequence[str], config: DataConfig, trajectory: str | None) -> Roles:
    """Return the roles of columns by their names, without any checks."""
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
        name_hidden_states(config.hidden_count, names) if config.hidden_count else config.hidden,
        tuple(name for name in states if name in config.observe),
    )


def name_hidden_states(count: int, columns: Sequence[str]) -> tuple[str, ...]:
    """Return names of hidden states that no column has: h, or h1, h2 and so on."""
    for letter in ("h", "hidden", *(f"hidden_{number}" for number in range(len(columns)))):
        names = (letter,) if count == 1 else tuple(f"{letter}{number + 1}" for number in range(count))
        if not {name.casefold() for name in names} & {name.casefold() for name in columns}:
            return names
    raise AssertionError("there are more names than columns")


def _check_known(name: str, table: Table, *, may_be_text: bool = False) -> None:
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


def _check_equations(roles: Roles, config: DataConfig, table: Table) -> None:
    if not roles.equations:
        used = [f"'{name}'" for name in roles.used if name in table.names]
        besides = f" besides {' and '.join(used)}" if used else ""
        raise DataError(
            f"no column of numbers is left in {table.files[0]} to be a state{besides}; add one for each state"
        )
    clash = next((name for name in roles.states if roles.order == 2 and f"{name}_dot" in roles.states), None)
    if clash is not None:
        reason = f"'{clash}_dot' is a state and with --order 2 also the name of the velocity of '{clash}'"
        raise DataError(f"{reason}; name the states without it, as --states {clash}, or leave --order 2 out")
    if roles.target is not None and not roles.inputs:
        raise DataError(f"there is no column besides '{roles.target}' from which it could be computed; add a column")
    if roles.derivatives and len(roles.derivatives) != len(roles.states):
        states = ", ".join(roles.states)
        counts = f"{len(roles.derivatives)} derivatives were named for the states {states}"
        raise UsageError(f"{counts}; name as many states with --states, in the same order")
    if roles.time is None and not roles.is_given:
        raise _missing_time_error(table, roles.states, config)


def _check_hidden_states(roles: Roles, config: DataConfig, columns: Sequence[str]) -> None:
    """Raise UsageError if a hidden state has a column, or if an observed column is no state column."""
    if config.hidden_count == 0:
        raise UsageError("--hidden gives the number 0; leave it out if every state is measured")
    for name in roles.hidden:
        if name in columns:
            raise UsageError(f"--hidden names '{name}', which is a column; a hidden state has none, so remove it")
        if not is_symbol(name):
            advice = "write a name such as h, or a number of states from 1 to 9"
            raise UsageError(f"--hidden names '{name}', which cannot be the name of a state; {advice}")
    twice = next((name for name in config.hidden if config.hidden.count(name) > 1), None)
    if twice is not None:
        raise UsageError(f"--hidden names '{twice}' twice; name it once")
    for name in config.observe:
        if name not in roles.states:
            known = ", ".join(roles.states)
            raise UsageError(
                f"--observe names '{name}', but the measured columns are {known}{did_you_mean(name, roles.states)}"
            )


def _check_named_roles(roles: Roles, config: DataConfig) -> None:
    """Raise UsageError if an option names a column without the role that the option needs."""
    for name in config.only or ():
        if name not in roles.equations:
            sought = f"equations are searched for {', '.join(roles.equations)}{did_you_mean(name, roles.equations)}"
            raise UsageError(f"--only names '{name}', but {sought}")
    for name in config.offsets:
        if name not in roles.states:
            raise UsageError(f"--offsets names '{name}', but the states are {', '.join(roles.states)}; remove it")
    for angle in roles.angles:
        if angle.column not in (*roles.states, *roles.inputs):
            is_target = angle.column == roles.target
            what = "the target of an explicit regression" if is_target else "which is neither a state nor an input"
            raise UsageError(f"--angle names '{angle.column}', {what}; remove it")
    for name in roles.held:
        if name not in roles.inputs:
            known = ", ".join(roles.inputs) or "none; name it with --inputs"
            raise UsageError(f"--hold names '{name}', but the inputs are {known}")
        if name == roles.time:
            raise UsageError(f"--hold names '{name}', the time, which is not constant between rows; remove it")


def _missing_time_error(table: Table, states: Sequence[str], config: DataConfig) -> DataError:
    """Return the error for a table without a time; its message names a state that may be the time."""
    breaks = {name: number for name in states if (number := _restarts(table, name)) is not None}
    ascending = next((name for name, number in breaks.items() if number == 0), None)
    restarting = next((name for name, number in breaks.items() if number > 0), None)
    advice = []
    if len(states) > 1 and ascending is not None:
        advice.append(f"name it with --time (perhaps {ascending})")
    elif len(states) > 1 and restarting is not None:
        restart = "it restarts: add --trajectory COLUMN, or blank rows"
        advice.append(f"name it with --time (perhaps {restarting}; {restart})")
    advice.append("give the time between rows, as --step 0.1, if it is always the same")
    advice += ["use --target COLUMN, for one column as a function of the others"] if len(states) > 1 else []
    names = config.time or " or ".join(TIME_NAMES[:2])
    return DataError(f"no time column was found (looked for {names}); {', or '.join(advice)}")


def _restarts(table: Table, name: str) -> int | None:
    """Return how many numbers of a column are not above the previous number, as at a restart of the time.

    Steps between two trajectories do not count. The result is None if the numbers cannot be times, because two restarts
    have too few rows between them for a trajectory.
    """
    steps = np.delete(np.diff(table.column(name)), [start - 1 for start in table.starts if start])
    ends = np.flatnonzero(~(steps > 0.0))
    stretches = np.diff(np.concatenate([[-1], ends, [len(steps)]]))
    is_long = not len(ends) or int(stretches.min()) >= SETTINGS.common.fewest_rows
    return len(ends) if len(steps) and is_long else None


# ------------------------------------------------------------------------------------------------------------ symbols


def assign_symbols(columns: Sequence[str]) -> dict[str, str]:
    """Return the unique symbol of each column in expressions: its name if possible, else a rewritten name.

    A symbol must stay the same when an expression is written as text and read by sympy's parser, with a ``local_dict``
    of these symbols. S, I, N, E and beta are possible; Python's keywords and names of functions are not.
    """
    symbols = {column: column for column in columns if is_symbol(column)}
    taken = set(symbols.values())
    for column in columns:
        if column not in symbols:
            text = re.sub(r"\W+", "_", unicodedata.normalize("NFKC", column)).strip("_") or "x"
            if not text.isidentifier():
                text = "x" + text
            if not text.isidentifier():
                text = re.sub(r"[^A-Za-z0-9_]+", "_", text)
            name = text if is_symbol(text) else text + "_"
            candidates = chain([name], (f"{name}_{number}" for number in count(2)))
            symbols[column] = next(symbol for symbol in candidates if symbol not in taken)
            taken.add(symbols[column])
    return {column: symbols[column] for column in columns}


def is_symbol(name: str) -> bool:
    """Tell whether `name` is one identifier for Python, which normalises to NFKC, and for sympy's tokenizer."""
    is_plain = unicodedata.normalize("NFKC", name) == name and re.fullmatch(r"\w+", name) is not None
    return is_plain and name.isidentifier() and not keyword.iskeyword(name) and name not in RESERVED
