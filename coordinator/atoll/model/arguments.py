"""What Python users give as numbers: single ones, intervals, and rows by the names of columns or in order.

What is none is named in one sentence, with what was expected. Letters: D states, U inputs, N rows.

Where a simulation begins and at which times it is wanted: as users say, else as was measured.

Letters: D states, N rows or times.

Inputs of a simulation as functions of time: as users give them, else as they were recorded.

Letters: U inputs, N times.

Where a simulation of a model starts, how far it goes, and what drives it, as a data file or bounds of time say.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Final, TypeGuard

import numpy as np
import numpy.typing as npt

from atoll.model.simulation import MOST_NUMBERS, Inputs
from atoll_coordinator.data.differentiation.inputs import InputCurve
from atoll_coordinator.data.roles.columns import TRAJECTORY_NAME
from atoll_coordinator.data.trajectories.measurements import RADIANS_PER_DEGREE, unwrap
from atoll_coordinator.result.base import Number
from atoll_coordinator.result.listed_trajectories import Recorded, Simulated
from atoll_coordinator.result.result import Result
from atoll_core.config import DataConfig
from atoll_core.data.dataset import FloatArray
from atoll_core.data.frames import plain_array
from atoll_core.data.table import Table
from atoll_core.errors import Field, UsageError
from atoll_core.quoting import did_you_mean, shown

if TYPE_CHECKING:
    from atoll.model.model import Model

Columns = Mapping[str, npt.ArrayLike]
"""Measured columns by name; a frame of pandas or polars does as well."""


def numbers(given: object, what: str, expected: str = "numbers") -> FloatArray:
    """Return an array of real numbers of any shape; raises UsageError, which says `what` it was to be."""
    try:
        plain = plain_array(given)
        if given is not None and plain.dtype.kind in "biufO":
            return np.asarray(plain, dtype=np.float64)
    except (TypeError, ValueError):  # rows of different lengths, or objects that are no numbers
        pass
    raise UsageError(f"{what} must be {expected}, but {shown(given)} was given")


def number(given: object, what: str) -> float:
    """Return one number; raises UsageError."""
    value = numbers(given, what, "a number")
    if value.ndim:
        raise UsageError(f"{what} must be a number, but {shown(given)} was given")
    return float(value)


def interval(given: object, what: str) -> tuple[float, float]:
    """Return a lower and an upper bound; raises UsageError where it is no finite interval."""
    bounds = numbers(given, what, "two numbers")
    if bounds.shape != (2,):
        raise UsageError(f"{what} must be two numbers, such as (0.0, 1.0), but {shown(given)} was given")
    if not (np.isfinite(bounds).all() and bounds[0] < bounds[1]):
        raise UsageError(f"{what} must have a lower bound, then an upper one, but {shown(given)} was given")
    return float(bounds[0]), float(bounds[1])


def by_name(given: object, what: str) -> Mapping[str, object]:
    """Return a mapping from names, empty for None; raises UsageError."""
    if given is None:
        return {}
    if not isinstance(given, Mapping):
        raise UsageError(f"{what} must be given by name, such as {{'x': 1.0}}, but {shown(given)} was given")
    return given


# ---------------------------------------------------------------------------------------------- rows and columns


@dataclass(frozen=True, eq=False)
class ReadColumns(Mapping[str, npt.ArrayLike]):
    """Columns of one trajectory as a fit reads them: full turns are taken out of angles, which are in radians.

    `factors` are what columns are multiplied by, `wrapped` the names of those that are unwrapped then.
    """

    given: Columns
    factors: Mapping[str, float] = field(default_factory=dict)
    wrapped: frozenset[str] = frozenset()

    def __getitem__(self, name: str) -> FloatArray:
        if not has(self.given, name):
            raise KeyError(name)
        values = column(self.given, name)
        if name in self.factors:
            values = values * self.factors[name]
        return unwrap(values) if name in self.wrapped and values.ndim == 1 else values

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and has(self.given, name)

    def __iter__(self) -> Iterator[str]:
        return iter(getattr(self.given, "columns", self.given))

    def __len__(self) -> int:
        return sum(1 for _ in self)


def read_columns(model: "Model", part: Columns) -> ReadColumns:
    """Return the measured columns of one trajectory as the fit of the model has read them.

    All that takes a table after the fit takes it through here.
    """
    if isinstance(part, ReadColumns):
        return part
    data, symbols = DataConfig.model_validate(model.result.data_settings), model.result.symbols
    angles = {angle.column: RADIANS_PER_DEGREE if angle.degrees else 1.0 for angle in data.angles}
    wrapped = {*angles, *(symbols[name] for name in angles if name in symbols)}
    factors = {**angles, **{symbols[name]: factor for name, factor in angles.items() if name in symbols}}
    states = model.result.columns.states
    factors |= {
        rate: angles[name] for name, rate in zip(states, data.derivatives or (), strict=False) if name in angles
    }
    return ReadColumns(part, factors, frozenset(wrapped))


def rows_of(model: "Model", part: Columns) -> tuple[FloatArray, dict[str, FloatArray], dict[str, float]]:
    """Return the times (N,) of measured rows, the measured states (N,) by name, and the state of the first row.

    Velocities of equations of second order that were not measured are those of the first rows.

    Raises:
        UsageError: a column is missing, or a state of the first row is.
    """
    columns, positions = model.result.columns_by_symbol, _positions(model)
    times = column(part, model.time)
    measured = [name for name in model.states if name not in positions or has(part, columns[name])]
    values = {name: column(part, columns[name]) for name in measured}
    stacked([times, *values.values()])
    start = {}
    for name in model.states:
        if name in values:
            start[name] = float(values[name][0]) if len(times) else np.nan
        else:
            start[name] = _slope(times, column(part, columns[positions[name]]), positions[name])
    unknown = next((name for name, value in start.items() if not np.isfinite(value)), None)
    if unknown is not None:
        raise UsageError(f"the first row has no finite {unknown!r}; begin with a row that has every state")
    return times, values, start


def inputs_of(model: "Model", part: Columns) -> dict[str, FloatArray]:
    """Return those inputs (N,) of measured rows that have a column, by name."""
    columns = model.result.columns_by_symbol
    return {name: column(part, columns[name]) for name in model.inputs if has(part, columns[name])}


def points_of(model: "Model", given: object, names: Sequence[str]) -> FloatArray:
    """Return rows (N, len(names)) from an array or from columns by name."""
    if has_columns(given):
        columns = model.result.columns_by_symbol
        return stacked([column(given, columns.get(name, name), name) for name in names]).T
    rows = numbers(given, f"rows of {', '.join(names)}")
    rows = rows[:, np.newaxis] if rows.ndim == 1 and len(names) == 1 else np.atleast_2d(rows)
    if rows.ndim != 2 or rows.shape[1] != len(names):
        raise UsageError(f"rows of {len(names)} numbers ({', '.join(names)}) are expected, found {rows.shape}")
    return rows


def has_columns(given: object) -> TypeGuard[Columns]:
    """Tell whether something has columns by name: a mapping, or a frame of pandas or polars."""
    return isinstance(given, Mapping) or hasattr(given, "columns")


def has(given: Mapping[str, object], name: str) -> bool:
    """Tell whether there is a column of this name."""
    return name in getattr(given, "columns", given) or _is_index(given, name)


def column(given: Columns, *names: str) -> FloatArray:
    """Return the column of the first of these names that there is; raises UsageError."""
    name = next((name for name in names if has(given, name)), None)
    if name is None:
        raise UsageError(f"the data have no column {names[0]!r}; give one, by that name")
    values = getattr(given, "index", None) if _is_index(given, name) else given[name]
    return numbers(values, f"column {name!r}")


def stacked(columns: Sequence[FloatArray]) -> FloatArray:
    """Return columns (N,) as one array (K, N); raises UsageError where their lengths differ."""
    shapes = {values.shape for values in columns}
    if len(shapes) > 1 or any(values.ndim != 1 for values in columns):
        lengths = sorted(str(values.shape[0] if values.ndim == 1 else values.shape) for values in columns)
        raise UsageError(f"columns have {', '.join(lengths)} rows; one number of rows is expected")
    return np.stack(columns)


def _is_index(given: object, name: str) -> bool:
    """Tell whether a name is that of the index of a pandas frame."""
    index = getattr(given, "index", None)
    return index is not None and not callable(index) and getattr(index, "name", None) == name


def _positions(model: "Model") -> dict[str, str]:
    """Return the position of each velocity of equations of second order, by name; empty for other models."""
    half = len(model.states) // 2
    is_second = all(equation.lhs.startswith(f"d2{equation.variable}/") for equation in model.result.equations)
    return dict(zip(model.states[half:], model.states[:half], strict=True)) if is_second else {}


def _slope(times: FloatArray, position: FloatArray, name: str) -> float:
    """Return the slope of a position (N,) at the first row, NaN where it is not known there; raises UsageError."""
    stacked([times, position])
    if len(times) < 3:
        raise UsageError(f"a velocity is estimated from 3 rows of {name!r} or more, but the data have {len(times)}")
    return float(np.gradient(position, times, edge_order=2)[0])


ROWS: Final = 501
"""Times of a simulation whose end alone is given."""

Given = Mapping[str, float] | Sequence[float] | FloatArray
"""Numbers by name, or in the order of the states or inputs."""


@dataclass(frozen=True, eq=False)
class InitialConditions:
    """The beginning of a trajectory: its `name`, its initial state by column, its `times` (N,); empty where unknown."""

    name: str | None = None
    start: Mapping[str, float] = field(default_factory=dict)
    times: FloatArray = field(default_factory=lambda: np.empty(0))


def beginning_of(model: "Model") -> InitialConditions:
    """Return that of the first simulated trajectory, of the ensemble of a process, else of the first measured one."""
    result = model.result
    for part in result.simulated:
        if part.start:
            return InitialConditions(part.name, _known(part.start), values_of_curve(part.times))
    if result.process is not None and result.process.ensemble is not None:
        ensemble = result.process.ensemble
        start = {name: curve[0] for name, curve in ensemble.mean.items() if curve}
        return InitialConditions(ensemble.trajectory, _known(start), values_of_curve(ensemble.times))
    measured = (measured_beginning(model, part) for part in result.recorded)
    return next(filter(None, measured), InitialConditions())


def measured_beginning(model: "Model", part: Recorded | Simulated) -> InitialConditions | None:
    """Return that of the whole rows of a measured trajectory; None where no row has all states."""
    columns = {name: values_of_curve(curve) for name, curve in part.measured.items()}
    times = values_of_curve(part.times)
    known = np.flatnonzero(np.isfinite([times, *columns.values()]).all(axis=0))
    if not len(known):
        return None
    rows = {name: values[known] for name, values in {model.time: times, **columns}.items()}
    names = model.result.columns_by_symbol
    start = {names[name]: value for name, value in rows_of(model, rows)[2].items()}
    return InitialConditions(part.name, start, rows[model.time])


def recorded_inputs(model: "Model") -> dict[str, InputCurve]:
    """Return the inputs recorded along the first trajectory, by symbol."""
    name = beginning_of(model).name
    part = next((part for part in model.result.recorded if part.name == name), None)
    return {} if part is None else input_curves(model.result, part)


def input_curves(result: Result, part: Recorded) -> dict[str, InputCurve]:
    """Return the inputs recorded along a trajectory, by symbol, between rows as the fit has taken them."""
    times, symbols, curves = values_of_curve(part.times), result.symbols, {}
    for column, values in part.inputs.items():
        known = np.isfinite(measured := values_of_curve(values))
        kind, slopes = result.columns.input_kinds.get(column), (part.input_slopes or {}).get(column)
        if not known.any():
            continue
        fitted = None if slopes is None else values_of_curve(slopes)[known]
        is_fitted = fitted is not None and (kind == "held" or np.isfinite(fitted).all())
        curve = InputCurve.through(times[known], measured[known], kind)
        curves[symbols.get(column, column)] = (
            replace(curve, slopes=fitted) if is_fitted and fitted is not None else curve
        )
    return curves


def start_of(model: "Model", x0: Given | None) -> FloatArray:
    """Return the initial state (D,) that is given, else the one that was measured; raises UsageError."""
    given = beginning_of(model).start if x0 is None else x0
    if x0 is None and not given:
        example = model.states[0]
        raise UsageError(
            "the result has no fitted initial state",
            python=f"give one, such as x0={{{example!r}: 1.0}}",
            command=f"give one, such as --initial {example}=1",
        )
    if not isinstance(given, Mapping):
        values = numbers(given, "an initial state")
        if values.shape != (len(model.states),):
            raise UsageError(f"an initial state has one number for each of {', '.join(model.states)}")
        return values
    symbols = model.result.symbols
    named = {symbols.get(name, name): value for name, value in given.items()}
    _require_states(model, named)
    return np.array([number(named[name], f"the initial value of {name!r}") for name in model.states])


def _require_states(model: "Model", named: Mapping[str, object]) -> None:
    unknown = next((name for name in named if name not in model.states), None)
    missing = next((name for name in model.states if name not in named), None)
    known = f"the states are {', '.join(model.states)}"
    if unknown is not None:
        hint = did_you_mean(unknown, model.states)
        raise UsageError(f"the initial state names {unknown!r}; {known}{hint}")
    if missing is not None:
        raise UsageError(f"the initial state lacks {missing!r}; {known}")


def times_of(model: "Model", t: npt.ArrayLike | float | None) -> FloatArray:
    """Return the times (N,) that are given, else those that were measured; raises UsageError."""
    first = beginning_of(model).times
    if t is None:
        if not len(first):
            raise UsageError(
                "the result has no simulated trajectory",
                python="give the times, such as t=10.0",
                command="give the last time, such as --until 10",
            )
        return first
    times = numbers(t, "times")
    if times.ndim:
        return times
    begin = float(first[0]) if len(first) else 0.0
    if not float(times) > begin:
        raise UsageError(f"a simulation begins at {model.time} = {begin:g} and ends later, but {t!r} was given")
    return np.linspace(begin, float(times), ROWS)


def values_of_curve(curve: Sequence[Number]) -> FloatArray:
    """Return a curve as an array, NaN where it is not known."""
    return np.array(curve, dtype=np.float64)


def _known(start: Mapping[str, float | None]) -> dict[str, float]:
    return {name: value for name, value in start.items() if value is not None}


_Course = Callable[[float], npt.ArrayLike]
_ByName = Mapping[str, npt.ArrayLike | _Course]
GivenInputs = _ByName | npt.ArrayLike | _Course | None
"""By name numbers, arrays or functions of time; an array (N, U); or a function of time that returns U numbers."""


@dataclass(frozen=True, eq=False)
class Driving:
    """All inputs (U,) of a simulation as one function of time."""

    courses: Sequence[Callable[[float], float]]

    def __call__(self, t: float) -> FloatArray:
        """Return the inputs at a time."""
        return np.array([course(t) for course in self.courses], dtype=np.float64)

    @cached_property
    def jumps(self) -> FloatArray:
        """The times at which a held input changes, ascending."""
        parts = [course.jumps for course in self.courses if isinstance(course, InputCurve)]
        return np.unique(np.concatenate(parts)) if parts else np.zeros(0)


def require_inputs(model: "Model", names: Iterable[str]) -> None:
    """Raise UsageError where one of `names`, symbols or columns, is no input."""
    symbols = model.result.symbols
    unknown = next((name for name in names if symbols.get(name, name) not in model.inputs), None)
    if unknown is not None:
        hint = did_you_mean(str(unknown), model.inputs)
        raise UsageError(f"there is no input {unknown!r}; the inputs are {', '.join(model.inputs) or 'none'}{hint}")


def inputs_along(
    model: "Model", u: GivenInputs, times: FloatArray, recorded: Mapping[str, InputCurve]
) -> Inputs | None:
    """Return all inputs as one function of time, those that `u` lacks as `recorded`; None of a model without inputs.

    Raises:
        UsageError: a name is no input, an input is not known, or a number of values does not fit.
    """
    if isinstance(u, Mapping):
        require_inputs(model, u)
    if not model.inputs:
        return None
    if callable(u):
        return lambda t: np.atleast_1d(numbers(u(t), "what u returns"))
    given: _ByName = {}
    if has_columns(u):
        given = u
    elif u is not None:
        given = dict(zip(model.inputs, _rows(model, u, times).T, strict=True))
    return Driving([_input(model, name, given, times, recorded.get(name)) for name in model.inputs])


def _rows(model: "Model", u: object, times: FloatArray) -> FloatArray:
    values = numbers(u, "inputs")
    values = values.reshape(len(times), -1) if values.ndim and len(values) == len(times) else values
    if values.shape != (len(times), len(model.inputs)):
        shape = f"({len(times)}, {len(model.inputs)})"
        raise UsageError(f"inputs have the shape {values.shape}, expected {shape}: rows by {model.inputs}")
    return values


def _input(
    model: "Model", name: str, given: _ByName, times: FloatArray, recorded: InputCurve | None
) -> Callable[[float], float]:
    column = model.result.columns_by_symbol[name]
    key = next((key for key in (name, column) if has(given, key)), None)
    if key is None:
        if column == model.time:
            return lambda t: t
        if recorded is not None:
            return recorded
        raise UsageError(
            f"the model has the input {name!r}, of which nothing is given",
            python="name it in u",
            command=f"give a number, such as --hold {name}=1, or a file with its column as --initial",
        )
    value = given[key]
    if isinstance(value, InputCurve):
        return value
    if callable(value):
        return lambda t: number(value(t), f"what the function of the input {name!r} returns")
    values = numbers(value, f"the input {name!r}")
    if values.ndim == 0:
        return lambda _: float(values)
    if values.shape != times.shape:
        raise UsageError(f"the input {name!r} has {values.size} values for {len(times)} times; give one for each")
    return InputCurve.through(times, values, model.input_kind(name))


_SLACK: Final = 1e-9
"""Share of a step by which rounding may shift the last time."""


@dataclass(frozen=True)
class FileStart:
    """An initial state by symbol, and of a file also times (N,) and inputs by symbol; None: as measured."""

    state: Mapping[str, float] | None = None
    times: FloatArray | None = None
    inputs: Mapping[str, InputCurve] = field(default_factory=dict)


def start_of_file(model: "Model", path: Path) -> FileStart:
    """Return the first row, the times and the inputs of the first trajectory of a data file.

    Raises:
        DataError: it cannot be read.
        UsageError: it has no column for a state.
    """
    from atoll_coordinator.data.reading.files import read_table

    config, symbols = model.result.data_settings, model.result.symbols
    table = read_table(
        [path], DataConfig.model_validate({"time": config.get("time")}), model.result.units
    )  # dates in the model's unit
    rows = _rows_of_first(table, str(config.get("trajectory") or TRAJECTORY_NAME))
    columns = {name: table.column(name)[:rows] for name in table.names}
    columns = {name: np.asarray(values) for name, values in read_columns(model, columns).items()}
    times = columns.get(model.time)
    driving = [name for name in columns if symbols.get(name) in model.inputs and name != model.time]
    inputs = {} if times is None else {symbols[name]: _curve(model, name, times, columns[name]) for name in driving}
    return FileStart(_state_of(model, columns, path), times, inputs)


def _curve(model: "Model", name: str, times: FloatArray, values: FloatArray) -> InputCurve:
    """Return an input of a file between its rows, as the fit has taken it; rows without a value are passed over."""
    known = np.isfinite(values)
    if not known.any():
        raise UsageError(f"the input {name!r} has no number in the file of the initial state; give one")
    return InputCurve.through(times[known], values[known], model.input_kind(name))


def times_until(model: "Model", start: FileStart, end: float | None, step: float | None) -> FloatArray:
    """Return the times (N,) of a simulation: up to `end` by `step`, where they are given; raises UsageError."""
    known = start.times if start.times is not None else beginning_of(model).times
    if end is None and step is None and len(known):
        return known
    if end is None and not len(known):
        raise UsageError("nothing tells how long to simulate; give %s", Field("until"))
    first = float(known[0]) if len(known) else 0.0
    last = float(known[-1]) if end is None else end
    if last <= first:
        raise UsageError(
            "%s must be after the first time, %s, but %s was given", Field("until"), f"{first:g}", f"{last:g}"
        )
    if step is None:
        return np.linspace(first, last, ROWS)
    if step <= 0.0 or (last - first) / step > MOST_NUMBERS:
        limits = f"above 0 and give at most {MOST_NUMBERS} times"
        raise UsageError("%s must be %s, but %s was given", Field("step"), limits, f"{step:g}")
    return np.asarray(first + step * np.arange(math.floor((last - first) / step + _SLACK) + 1), dtype=np.float64)


def _rows_of_first(table: Table, trajectory: str) -> int:
    """Return the number of rows of the first trajectory."""
    end = (*table.starts, table.rows)[1]
    if trajectory not in table.names:
        return end
    numbers = table.column(trajectory)[:end]
    return int(np.append(np.flatnonzero(numbers != numbers[0]), end)[0])


def _state_of(model: "Model", columns: Mapping[str, FloatArray], path: Path) -> dict[str, float]:
    """Return the state of the first row; velocities that are not there are estimated."""
    symbols = model.result.symbols
    row = {symbols.get(name, name): float(values[0]) for name, values in columns.items() if len(values)}
    lacking = [state for state in model.states if state not in row]
    if lacking and model.time in columns:
        names = model.result.columns_by_symbol
        part = {names.get(symbols.get(name, name), name): values for name, values in columns.items()}
        return rows_of(model, part)[2]
    if lacking:
        raise UsageError(f"{path} has no column for {', '.join(lacking)}; an initial state names every state")
    return {state: row[state] for state in model.states}
