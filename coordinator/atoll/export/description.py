"""The content of an export, independent of the language. Letters: D states, N times."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Literal

import numpy as np
import numpy.typing as npt

from atoll.model.arguments import Given, inputs_along, recorded_inputs, require_inputs, start_of, times_of
from atoll.model.equations import Parameter, numbers_of, observation_text
from atoll.model.given_sides import GivenSides, fitted_parameters, program_of
from atoll.model.simulation import state_sizes
from atoll_coordinator.data.differentiation.inputs import InputCurve
from atoll_core import VERSION
from atoll_core.data.dataset import FloatArray
from atoll_core.errors import UsageError
from atoll_core.expression.operators import VARIABLE
from atoll_core.expression.program import Program, constant_places
from atoll_core.expression.text.parsing import from_infix

if TYPE_CHECKING:
    from atoll.model.core import ModelCore

Times = npt.ArrayLike | None
"""Ascending times, only the last time, or the measured times."""
HeldInputs = Mapping[str, npt.ArrayLike | InputCurve] | None
"""Numbers, arrays (N,) at the times, or curves, by name."""

_MOST_EVALUATIONS: Final = 20_000
"""Largest number of evaluations of the rates to find the sizes of the states; they take a fraction of a second."""


@dataclass(frozen=True, eq=False)
class Formula:
    """An expression: its program over the symbols of the description, and the names of its named constants."""

    program: Program
    constants: Mapping[int, str]


@dataclass(frozen=True, eq=False)
class ExportedState:
    """A state: its `name` in expressions, its `column` in the data ("" if it has no column), its `unit`.

    `rate` is its derivative, `start` its initial value. `size` scales absolute tolerances; it is above 0 for an
    ordinary differential equation, and 0 for a stochastic process.
    """

    name: str
    column: str
    unit: str
    rate: Formula
    start: float
    size: float


@dataclass(frozen=True, eq=False)
class ExportedColumn:
    """A measured `column` that is computed from states: its `value`; its `unit`."""

    column: str
    unit: str
    value: Formula

    @property
    def name(self) -> str:
        """The name by which it is known; a space keeps it apart from the names of variables."""
        return f"column {self.column}"


@dataclass(frozen=True, eq=False)
class ExportedInput:
    """A variable without an equation.

    Its `kind` is the time itself, a constant `value`, or a `table` of piecewise cubics (M, 5). A row of the table is
    the first time of a piece, then the coefficients of the powers 0 to 3 of the time since this first time. `until` is
    the end of the last piece. For an input that is set to 0, `status` gives the reason: its values are unknown, or its
    recorded table was dropped.
    """

    name: str
    column: str
    unit: str
    kind: Literal["time", "value", "table"]
    value: float = 0.0
    table: FloatArray | None = None
    until: float = 0.0
    status: Literal["known", "unknown", "dropped"] = "known"


@dataclass(frozen=True, eq=False)
class Description:
    """The content of an exported model.

    `symbols` are the variables of all formulas. The simulation goes from `begin` to `end` in `steps` equal time steps.
    For order 2, `states` has the positions, then the velocities. For a process dx = f dt + g dW, `covariance` has the
    entries of g gᵀ by row and column. A regression has a `value` and no states. `constants` are the constants with a
    name. `origin` has lines about the origin of the model. `zeros` has sentences about inputs that are set to 0 because
    their values are not known. `observed` are measured columns that are computed from states.
    """

    symbols: tuple[str, ...]
    states: tuple[ExportedState, ...]
    inputs: tuple[ExportedInput, ...]
    constants: tuple[Parameter, ...]
    value: Formula | None
    covariance: Mapping[tuple[int, int], Formula]
    begin: float
    end: float
    steps: int
    time: str
    time_unit: str
    target: str
    origin: tuple[str, ...]
    zeros: tuple[str, ...]
    observed: tuple[ExportedColumn, ...] = ()

    @property
    def variables(self) -> "tuple[ExportedState | ExportedInput, ...]":
        """All states and inputs except the time."""
        return (*self.states, *(variable for variable in self.inputs if variable.kind != "time"))

    @property
    def tables(self) -> tuple[ExportedInput, ...]:
        """The inputs with a table of values."""
        return tuple(variable for variable in self.inputs if variable.kind == "table")

    @property
    def held(self) -> tuple[ExportedInput, ...]:
        """The inputs with a constant value."""
        return tuple(variable for variable in self.inputs if variable.kind == "value")

    @property
    def depends_on_time(self) -> bool:
        """Whether the time itself is an input."""
        return any(variable.kind == "time" for variable in self.inputs)


def describe(
    model: "ModelCore", x0: Given | None = None, t: Times = None, u: HeldInputs = None, without_tables: str = ""
) -> Description:
    """Return the description of `model`. The initial state, the times and the inputs are as in `Model.simulate`.

    Inputs that are neither given nor recorded are set to 0. If the format has no tables (`without_tables` is then its
    name), recorded inputs that change are set to 0 too. Times are exported as first time, last time and number.

    Raises:
        UsageError: the initial state or the times are not known, an argument is invalid, or constants differ between
            groups of trajectories.
    """
    model.require_one_group()
    given = u or {}
    require_inputs(model, given)
    formulas = _formulas(model)
    components = {} if model.is_regression else model.components
    times = np.zeros(1) if model.is_regression else times_of(model, t)
    recorded = {} if model.is_regression or x0 is not None else recorded_inputs(model)
    inputs = tuple(
        _exported_input(model, name, given, times, recorded.get(name), has_tables=not without_tables)
        for name in model.inputs
    )
    states: tuple[ExportedState, ...] = ()
    if not model.is_regression:
        start = start_of(model, x0)
        sizes = np.zeros(len(start))
        if not components:  # sizes as in simulations, with unknown inputs set to 0
            zeros = {variable.name: 0.0 for variable in inputs if variable.status == "unknown"}
            course = inputs_along(model, {**zeros, **given}, times, recorded)
            sizes = state_sizes(model.field, start, times, course, _MOST_EVALUATIONS)
        states = _states(model, formulas, start, sizes)
    return Description(
        symbols=model.result.names,
        states=states,
        inputs=inputs,
        constants=_constants(model),
        value=next(iter(formulas.values())) if model.is_regression else None,
        covariance={pair: formulas[name] for name, pair in components.items()},
        begin=float(times[0]),
        end=float(times[-1]),
        steps=max(len(times) - 1, 1),
        time=model.time,
        time_unit=model.result.units.get(model.time, ""),
        target=model.equations[0].variable if model.is_regression else "",
        origin=_origin(model),
        zeros=() if model.is_regression else _zeros(inputs, without_tables),
        observed=_observed(model),
    )


def _constants(model: "ModelCore") -> tuple[Parameter, ...]:
    """Return the constants with a name; parameters of given sides always have one. A parameter by run is a state."""
    given, by_run = fitted_parameters(model.result), model.result.by_run
    shared = (one for one in model.params.values() if one.variable not in by_run)
    return tuple(one for one in shared if one.name in given or _is_named(one))


def _observed(model: "ModelCore") -> tuple[ExportedColumn, ...]:
    """Return the measured columns that are computed from states."""
    columns = []
    for one in model.result.observations:
        program = program_of(one, model.result.names)
        places = constant_places(program)
        formula = Formula(program, {places[number]: name for name, number in one.given.parameters.items()})
        columns.append(ExportedColumn(one.column, model.result.units.get(one.column, ""), formula))
    return tuple(columns)


def _is_named(constant: Parameter) -> bool:
    """Tell whether a constant gets a name: an integer without a fitted error, such as the 2 in 2*x, gets none."""
    return constant.stderr is not None or constant.bounds is not None or not constant.value.is_integer()


def _formulas(model: "ModelCore") -> dict[str, Formula]:
    """Return the right-hand sides by variable, with the names of constants in `Model.params`."""
    formulas, numbers, names = {}, numbers_of(model.result), model.result.names
    known = {constant.name for constant in _constants(model)}
    sides = GivenSides.of(model.result)
    for place, equation in enumerate(model.equations):
        program = sides.programs[place] if sides.is_given(place) else from_infix(equation.exact, names)
        called = zip(constant_places(program), numbers[equation.variable], strict=True)
        formulas[equation.variable] = Formula(program, {node: one.name for node, one in called if one.name in known})
    return formulas


def _states(
    model: "ModelCore", formulas: Mapping[str, Formula], start: FloatArray, sizes: FloatArray
) -> tuple[ExportedState, ...]:
    """Return the states; for order 2, the rates of the positions are the velocities."""
    symbols, names = model.result.symbols, model.result.names
    rates = {symbols[variable]: formula for variable, formula in formulas.items() if variable in symbols}
    if len(rates) < len(model.states):
        half = len(model.states) // 2
        for position, velocity in zip(model.states[:half], model.states[half:], strict=True):
            rates[velocity] = rates[position]
            rates[position] = Formula(Program.of([(VARIABLE, names.index(velocity), 0, 0.0)]), {})
    return tuple(
        ExportedState(name, model.result.columns_by_symbol[name], _unit(model, name), rates[name], first, size)
        for name, first, size in zip(model.states, start.tolist(), sizes.tolist(), strict=True)
    )


def _unit(model: "ModelCore", symbol: str) -> str:
    return model.result.units.get(model.result.columns_by_symbol[symbol], "")


def _exported_input(
    model: "ModelCore",
    name: str,
    given: Mapping[str, npt.ArrayLike | InputCurve],
    times: FloatArray,
    recorded: InputCurve | None,
    *,
    has_tables: bool,
) -> ExportedInput:
    column, unit = model.result.columns_by_symbol[name], _unit(model, name)
    value = next((given[key] for key in (name, column) if key in given), None)
    if value is None and column == model.time and not model.is_regression:
        return ExportedInput(name, column, unit, "time")
    if value is None:
        if recorded is None:
            return ExportedInput(name, column, unit, "value", status="unknown")
        value = recorded
    if isinstance(value, InputCurve):
        if (value.values == value.values[0]).all():
            return ExportedInput(name, column, unit, "value", float(value.values[0]))
        if not has_tables and recorded is value:
            return ExportedInput(name, column, unit, "value", status="dropped")
        return ExportedInput(name, column, unit, "table", 0.0, value.pieces, value.until)
    if callable(value):
        raise UsageError(f"the input {name!r} is a function, which cannot be exported; give its values at the times t")
    values = np.asarray(value, dtype=np.float64)
    if values.ndim == 0:
        return ExportedInput(name, column, unit, "value", float(values))
    if values.shape != times.shape or len(times) < 2:
        raise UsageError(f"the input {name!r} has {values.size} values for {times.size} times; give one value per time")
    curve = InputCurve.through(times, values, model.input_kind(name))
    return ExportedInput(name, column, unit, "table", 0.0, curve.pieces, curve.until)


def _zeros(inputs: tuple[ExportedInput, ...], without_tables: str) -> tuple[str, ...]:
    reasons = {
        "dropped": f"and not to the recorded values, because {without_tables} has no tables",
        "unknown": "because no value is given",
    }
    columns = {status: [variable.column for variable in inputs if variable.status == status] for status in reasons}
    return tuple(
        f"inputs set to 0, {reasons[status]}: {', '.join(names)}" for status, names in columns.items() if names
    )


def _origin(model: "ModelCore") -> tuple[str, ...]:
    result, data = model.result, model.result.data
    lines = [f"Written by Atoll {VERSION}. Result: job {result.job}, seed {result.seed}, digest {result.digest}."]
    if data and data.digest:
        lines.append(f"Data: {', '.join(data.files or ())}, {data.rows} rows, sha256 {data.digest}.")
    lines += ["", "Equations, with rounded constants:", *([f"  {model.remark}"] if model.remark else [])]
    for equation in model.equations:
        lines.append(f"  {equation}")
        if equation.verdict is not None:
            lines.append(f"    {equation.verdict}: {equation.reason}")
    lines += [f"  {observation_text(one, result.names)}" for one in result.observations]
    return tuple(lines)
