"""Arguments that users give: numbers, columns of a table, initial states, times and inputs of a simulation.

Missing arguments default to the measurements of the result. Invalid values raise a UsageError with the found and the
expected value. Letters: D states, U inputs, N rows or times.
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
from atoll_coordinator.data.roles.names_and_options import TRAJECTORY_NAME
from atoll_coordinator.data.trajectories.measurements import RADIANS_PER_DEGREE, unwrap
from atoll_coordinator.result.base import Number
from atoll_coordinator.result.listed_trajectories import Recorded, Simulated
from atoll_coordinator.result.result import Result
from atoll_core.config import DataConfig
from atoll_core.data.dataset import FloatArray
from atoll_core.data.frames import plain_array
from atoll_core.errors import Field, UsageError
from atoll_core.quoting import did_you_mean, shown

if TYPE_CHECKING:
    from atoll.model.core import ModelCore

Columns = Mapping[str, npt.ArrayLike]
"""Measured columns by name, or a frame of pandas or polars."""

Given = Mapping[str, float] | Sequence[float] | FloatArray
"""Numbers by name, or in the order of the states."""

_TimeFunction = Callable[[float], npt.ArrayLike]
_InputsByName = Mapping[str, npt.ArrayLike | _TimeFunction]
GivenInputs = _InputsByName | npt.ArrayLike | _TimeFunction | None
"""Numbers, arrays (N,) or functions of time by name; an array (N, U); or a function of time that returns U numbers."""

ROWS: Final = 501
"""Number of times of a simulation if the user gives only the last time."""

_TIME_ROUNDING: Final = 1e-9
"""Largest rounding error of the last time, as a share of a step."""


# ------------------------------------------------------------------------------------------------------------ numbers


def numbers(given: object, what: str, expected: str = "numbers") -> FloatArray:
    """Return an array of real numbers of any shape; raises UsageError, whose message calls the argument `what`."""
    try:
        plain = plain_array(given)
        if given is not None and plain.dtype.kind in "biufO":
            return np.asarray(plain, dtype=np.float64)
    except (TypeError, ValueError):  # rows of different lengths, or objects that are not numbers
        pass
    raise UsageError(f"{what} must be {expected}, but {shown(given)} was given")


def number(given: object, what: str) -> float:
    """Return one number; raises UsageError."""
    value = numbers(given, what, "a number")
    if value.ndim:
        raise UsageError(f"{what} must be a number, but {shown(given)} was given")
    return float(value)


def interval(given: object, what: str) -> tuple[float, float]:
    """Return a lower and an upper bound; raises UsageError if they are not a finite interval."""
    bounds = numbers(given, what, "two numbers")
    if bounds.shape != (2,):
        raise UsageError(f"{what} must be two numbers, such as (0.0, 1.0), but {shown(given)} was given")
    if not (np.isfinite(bounds).all() and bounds[0] < bounds[1]):
        raise UsageError(f"{what} must be a finite lower bound and a larger upper bound, but {shown(given)} was given")
    return float(bounds[0]), float(bounds[1])


def by_name(given: object, what: str) -> Mapping[str, object]:
    """Return a mapping from names, empty for None; raises UsageError."""
    if given is None:
        return {}
    if not isinstance(given, Mapping):
        raise UsageError(f"{what} must be given by name, such as {{'x': 1.0}}, but {shown(given)} was given")
    return given


# --------------------------------------------------------------------------------------------------- rows and columns


@dataclass(frozen=True, eq=False)
class ReadColumns(Mapping[str, npt.ArrayLike]):
    """Columns of one trajectory as the fit reads them: angles are unwrapped and in radians.

    `factors` are the factors by which columns are multiplied, `wrapped` are the names of the columns to unwrap.
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


def read_columns(model: "ModelCore", part: Columns) -> ReadColumns:
    """Return the measured columns of one trajectory as the fit of the model has read them."""
    if isinstance(part, ReadColumns):
        return part
    data, symbols = DataConfig.model_validate(model.result.data_settings), model.result.symbols
    angles = {angle.column: RADIANS_PER_DEGREE if angle.degrees else 1.0 for angle in data.angles}
    named = {symbols[name]: factor for name, factor in angles.items() if name in symbols}
    rates = zip(model.result.columns.states, data.derivatives or (), strict=False)
    velocities = {rate: angles[name] for name, rate in rates if name in angles}
    return ReadColumns(part, {**angles, **named, **velocities}, frozenset([*angles, *named]))


def rows_of(model: "ModelCore", part: Columns) -> tuple[FloatArray, dict[str, FloatArray], dict[str, float]]:
    """Return the times (N,) of measured rows, the measured states (N,) by name, and the state of the first row.

    For equations of second order, a velocity that was not measured is the slope of its position. Hidden states begin
    with the initial values of the first simulated trajectory of the result.

    Raises:
        UsageError: a column is missing, or the first row lacks a state.
    """
    columns, half = model.result.columns_by_symbol, len(model.states) // 2
    is_second = all(equation.lhs.startswith(f"d2{equation.variable}/") for equation in model.result.equations)
    positions = dict(zip(model.states[half:], model.states[:half], strict=True)) if is_second else {}
    times = column(part, model.time)
    hidden = {name for name in model.states if columns[name] in model.result.unmeasured}
    known = initial_conditions(model).start if hidden else {}
    measured = [
        name for name in model.states if name not in hidden and (name not in positions or has(part, columns[name]))
    ]
    values = {name: column(part, columns[name]) for name in measured}
    stack_columns([times, *values.values()])
    start = {}
    for name in model.states:
        if name in values:
            start[name] = float(values[name][0]) if len(times) else np.nan
            continue
        if name in hidden:
            if columns[name] not in known:
                raise UsageError(f"the result has no initial value of the hidden state {columns[name]!r}; give one")
            start[name] = known[columns[name]]
            continue
        position = column(part, columns[positions[name]])
        stack_columns([times, position])
        if len(times) < 3:
            needed = f"the velocity of {positions[name]!r} is estimated from 3 or more rows"
            raise UsageError(f"{needed}, but the data have {len(times)}")
        start[name] = float(np.gradient(position, times, edge_order=2)[0])
    unknown = next((name for name, value in start.items() if not np.isfinite(value)), None)
    if unknown is not None:
        raise UsageError(f"the first row has no finite {unknown!r}; begin with a row that has every state")
    return times, values, start


def points_of(model: "ModelCore", given: object, names: Sequence[str]) -> FloatArray:
    """Return rows (N, len(names)) from an array or from columns by name."""
    if has_columns(given):
        columns = model.result.columns_by_symbol
        return stack_columns([column(given, columns.get(name, name), name) for name in names]).T
    rows = numbers(given, f"rows of {', '.join(names)}")
    rows = rows[:, np.newaxis] if rows.ndim == 1 and len(names) == 1 else np.atleast_2d(rows)
    if rows.ndim != 2 or rows.shape[1] != len(names):
        raise UsageError(f"rows have the shape {rows.shape}, expected (N, {len(names)}): {', '.join(names)}")
    return rows


def has_columns(given: object) -> TypeGuard[Columns]:
    """Tell whether an object has columns by name: a mapping, or a frame of pandas or polars."""
    return isinstance(given, Mapping) or hasattr(given, "columns")


def has(given: Mapping[str, object], name: str) -> bool:
    """Tell whether there is a column of this name."""
    return name in getattr(given, "columns", given) or _is_index(given, name)


def column(given: Columns, *names: str) -> FloatArray:
    """Return the first of these columns that exists; raises UsageError."""
    name = next((name for name in names if has(given, name)), None)
    if name is None:
        raise UsageError(f"the data have no column {names[0]!r}; add a column of this name")
    values = getattr(given, "index", None) if _is_index(given, name) else given[name]
    return numbers(values, f"column {name!r}")


def stack_columns(columns: Sequence[FloatArray]) -> FloatArray:
    """Return columns (N,) as one array (K, N); raises UsageError if their lengths differ."""
    shapes = {values.shape for values in columns}
    if len(shapes) > 1 or any(values.ndim != 1 for values in columns):
        lengths = sorted(str(values.shape[0] if values.ndim == 1 else values.shape) for values in columns)
        raise UsageError(f"columns have {', '.join(lengths)} rows; all columns must have the same number of rows")
    return np.stack(columns)


def _is_index(given: object, name: str) -> bool:
    """Tell whether a name is the name of the index of a pandas frame."""
    index = getattr(given, "index", None)
    return index is not None and not callable(index) and getattr(index, "name", None) == name


def values_of_curve(curve: Sequence[Number]) -> FloatArray:
    """Return the values (N,) of a curve; unknown values are NaN."""
    return np.array(curve, dtype=np.float64)


# -------------------------------------------------------------------------------------------- initial states and times


@dataclass(frozen=True, eq=False)
class InitialConditions:
    """The `name` of a trajectory, its initial state `start` by column and its `times` (N,); empty if unknown."""

    name: str | None = None
    start: Mapping[str, float] = field(default_factory=dict)
    times: FloatArray = field(default_factory=lambda: np.empty(0))


def initial_conditions(model: "ModelCore") -> InitialConditions:
    """Return the initial conditions of the first simulated trajectory.

    If no trajectory was simulated, these are the initial conditions of the ensemble of a stochastic process, or of the
    first measured trajectory with a complete row.
    """
    result = model.result
    for part in result.simulated:
        if part.start:
            known = {name: value for name, value in part.start.items() if value is not None}
            return InitialConditions(part.name, known, values_of_curve(part.times))
    if result.process is not None and result.process.ensemble is not None:
        ensemble = result.process.ensemble
        first = {name: curve[0] for name, curve in ensemble.mean.items() if curve}
        known = {name: value for name, value in first.items() if value is not None}
        return InitialConditions(ensemble.trajectory, known, values_of_curve(ensemble.times))
    measured = (measured_conditions(model, part) for part in result.recorded)
    return next(filter(None, measured), InitialConditions())


def measured_conditions(model: "ModelCore", part: Recorded | Simulated) -> InitialConditions | None:
    """Return the initial conditions from the complete rows of a trajectory; None if no row has all states."""
    if model.result.unmeasured:
        return None
    columns = {name: values_of_curve(curve) for name, curve in part.measured.items()}
    times = values_of_curve(part.times)
    known = np.flatnonzero(np.isfinite([times, *columns.values()]).all(axis=0))
    if not len(known):
        return None
    rows = {name: values[known] for name, values in {model.time: times, **columns}.items()}
    names = model.result.columns_by_symbol
    start = {names[name]: value for name, value in rows_of(model, rows)[2].items()}
    return InitialConditions(part.name, start, rows[model.time])


def start_of(model: "ModelCore", x0: Given | None) -> FloatArray:
    """Return the given initial state (D,), by default the measured initial state; raises UsageError."""
    given = initial_conditions(model).start if x0 is None else x0
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
            needed = f"an initial state has one number for each of {', '.join(model.states)}"
            raise UsageError(f"{needed}, but the shape is {values.shape}")
        return values
    symbols, known = model.result.symbols, f"the states are {', '.join(model.states)}"
    named = {symbols.get(name, name): value for name, value in given.items()}
    for name in named:
        if name not in model.states:
            raise UsageError(f"the initial state has {name!r}, but {known}{did_you_mean(name, model.states)}")
    for name in model.states:
        if name not in named:
            raise UsageError(f"the initial state lacks {name!r}; {known}")
    return np.array([number(named[name], f"the initial value of {name!r}") for name in model.states])


def times_of(model: "ModelCore", t: npt.ArrayLike | float | None) -> FloatArray:
    """Return the given times (N,), by default the measured times; raises UsageError."""
    first = initial_conditions(model).times
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
        raise UsageError(f"the last time must be after the first time, {model.time} = {begin:g}, but {t!r} was given")
    return np.linspace(begin, float(times), ROWS)


# ------------------------------------------------------------------------------------------------------------- inputs


@dataclass(frozen=True, eq=False)
class InputFunctions:
    """All inputs (U,) of a simulation as one function of time."""

    functions: Sequence[Callable[[float], float]]

    def __call__(self, t: float) -> FloatArray:
        """Return the inputs (U,) at a time."""
        return np.array([function(t) for function in self.functions], dtype=np.float64)

    @cached_property
    def jumps(self) -> FloatArray:
        """The times at which a held input changes, ascending."""
        parts = [function.jumps for function in self.functions if isinstance(function, InputCurve)]
        return np.unique(np.concatenate(parts)) if parts else np.zeros(0)


def recorded_inputs(model: "ModelCore") -> dict[str, InputCurve]:
    """Return the inputs recorded along the first trajectory, by symbol."""
    name = initial_conditions(model).name
    part = next((part for part in model.result.recorded if part.name == name), None)
    return {} if part is None else input_curves(model.result, part)


def input_curves(result: Result, part: Recorded) -> dict[str, InputCurve]:
    """Return the inputs recorded along a trajectory, by symbol, with the interpolation of the fit."""
    times, curves = values_of_curve(part.times), {}
    for name, values in part.inputs.items():
        known = np.isfinite(measured := values_of_curve(values))
        if not known.any():
            continue
        kind, slopes = result.columns.input_kinds.get(name), (part.input_slopes or {}).get(name)
        curve = InputCurve.through(times[known], measured[known], kind)
        fitted = None if slopes is None else values_of_curve(slopes)[known]
        if fitted is not None and (kind == "held" or np.isfinite(fitted).all()):
            curve = replace(curve, slopes=fitted)
        curves[result.symbols.get(name, name)] = curve
    return curves


def require_inputs(model: "ModelCore", names: Iterable[str]) -> None:
    """Raise UsageError if one of the `names` (symbols or columns) is not an input."""
    symbols = model.result.symbols
    unknown = next((name for name in names if symbols.get(name, name) not in model.inputs), None)
    if unknown is not None:
        hint = did_you_mean(str(unknown), model.inputs)
        raise UsageError(f"there is no input {unknown!r}; the inputs are {', '.join(model.inputs) or 'none'}{hint}")


def inputs_along(
    model: "ModelCore", u: GivenInputs, times: FloatArray, recorded: Mapping[str, InputCurve]
) -> Inputs | None:
    """Return all inputs as one function of time; None for a model without inputs.

    An input that is missing in `u` is taken from the `recorded` inputs.

    Raises:
        UsageError: a name is not an input, an input has no values, or the number of values is wrong.
    """
    if isinstance(u, Mapping):
        require_inputs(model, u)
    if not model.inputs:
        return None
    if callable(u):
        return lambda t: np.atleast_1d(numbers(u(t), "the return value of u"))
    given: _InputsByName = {}
    if has_columns(u):
        given = u
    elif u is not None:
        values = numbers(u, "inputs")
        values = values.reshape(len(times), -1) if values.ndim and len(values) == len(times) else values
        if values.shape != (len(times), len(model.inputs)):
            shape = f"({len(times)}, {len(model.inputs)})"
            columns = f"one row per time, one column for each of {', '.join(model.inputs)}"
            raise UsageError(f"inputs have the shape {values.shape}, expected {shape}: {columns}")
        given = dict(zip(model.inputs, values.T, strict=True))
    return InputFunctions([_input_function(model, name, given, times, recorded.get(name)) for name in model.inputs])


def _input_function(
    model: "ModelCore", name: str, given: _InputsByName, times: FloatArray, recorded: InputCurve | None
) -> Callable[[float], float]:
    column = model.result.columns_by_symbol[name]
    key = next((key for key in (name, column) if has(given, key)), None)
    if key is None:
        if column == model.time:
            return lambda t: t
        if recorded is not None:
            return recorded
        raise UsageError(
            f"the model has the input {name!r}, but no values of it are given",
            python="add it to u",
            command=f"give a number, such as --hold {name}=1, or pass a file with this column to --initial",
        )
    value = given[key]
    if isinstance(value, InputCurve):
        return value
    if callable(value):
        return lambda t: number(value(t), f"the return value of the function of the input {name!r}")
    values = numbers(value, f"the input {name!r}")
    if values.ndim == 0:
        return lambda _: float(values)
    if values.shape != times.shape:
        raise UsageError(f"the input {name!r} has {values.size} values for {len(times)} times; give one value per time")
    return InputCurve.through(times, values, model.input_kind(name))


# ------------------------------------------------------------------------------------------------- for the command line


@dataclass(frozen=True)
class FileStart:
    """An initial state by symbol; if it was read from a file, also its times (N,) and inputs.

    None stands for the measured state or times.
    """

    state: Mapping[str, float] | None = None
    times: FloatArray | None = None
    inputs: Mapping[str, InputCurve] = field(default_factory=dict)


def start_of_file(model: "ModelCore", path: Path) -> FileStart:
    """Return the first row, the times and the inputs of the first trajectory of a data file.

    Raises:
        DataError: the file cannot be read.
        UsageError: the file has no column for a state.
    """
    symbols, columns = model.result.symbols, _columns_of_file(model, path)
    times, inputs = columns.get(model.time), _curves_of_file(model, columns, path)
    state = {symbols.get(name, name): float(values[0]) for name, values in columns.items() if len(values)}
    lacking = [name for name in model.states if name not in state]
    if lacking and model.time in columns:  # velocities are estimated
        by_symbol = model.result.columns_by_symbol
        part = {by_symbol.get(symbols.get(name, name), name): values for name, values in columns.items()}
        state, lacking = rows_of(model, part)[2], []
    if lacking:
        raise UsageError(f"{path} has no column for {', '.join(lacking)}; an initial state needs every state")
    return FileStart({name: state[name] for name in model.states}, times, inputs)


def inputs_of_file(model: "ModelCore", path: Path) -> dict[str, InputCurve]:
    """Return the inputs of the first trajectory of a data file, by symbol.

    Raises:
        DataError: the file cannot be read.
        UsageError: the file has no times or no input of the model.
    """
    columns = _columns_of_file(model, path)
    inputs = _curves_of_file(model, columns, path)
    if not inputs:
        needed = f"a time column {model.time!r} and a column of an input ({', '.join(model.inputs) or 'none'})"
        raise UsageError(f"{path} has {', '.join(columns)}, but {needed} are needed")
    return inputs


def _columns_of_file(model: "ModelCore", path: Path) -> dict[str, FloatArray]:
    """Return the columns (N,) of the first trajectory of a file, as the fit of the model reads them."""
    from atoll_coordinator.data.reading.files import read_table

    config = model.result.data_settings
    # dates are converted to the time unit of the model
    table = read_table([path], DataConfig.model_validate({"time": config.get("time")}), model.result.units)
    rows, trajectory = (*table.starts, table.rows)[1], str(config.get("trajectory") or TRAJECTORY_NAME)
    if trajectory in table.names:
        names = table.column(trajectory)[:rows]
        rows = int(np.append(np.flatnonzero(names != names[0]), rows)[0])
    given = {name: table.column(name)[:rows] for name in table.names}
    return {name: np.asarray(values) for name, values in read_columns(model, given).items()}


def _curves_of_file(model: "ModelCore", columns: Mapping[str, FloatArray], path: Path) -> dict[str, InputCurve]:
    """Return the inputs among the columns (N,) of a file, by symbol; none without times."""
    times, symbols = columns.get(model.time), model.result.symbols
    inputs = {}
    for name in columns if times is not None else ():
        if symbols.get(name) in model.inputs and name != model.time:
            known = np.isfinite(columns[name])
            if not known.any():
                raise UsageError(f"the input {name!r} has no value in {path}; give at least one number")
            assert times is not None
            inputs[symbols[name]] = InputCurve.through(times[known], columns[name][known], model.input_kind(name))
    return inputs


def times_until(model: "ModelCore", start: FileStart, end: float | None, step: float | None) -> FloatArray:
    """Return the times (N,) of a simulation, up to `end` in steps of `step`; raises UsageError.

    Without `end` the simulation ends at the last known time, without `step` it has `ROWS` times.
    """
    known = start.times if start.times is not None else initial_conditions(model).times
    if end is None and step is None and len(known):
        return known
    if end is None and not len(known):
        raise UsageError("the last time of the simulation is not known; give %s", Field("until"))
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
    return np.asarray(
        first + step * np.arange(math.floor((last - first) / step + _TIME_ROUNDING) + 1), dtype=np.float64
    )
