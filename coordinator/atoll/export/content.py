"""What an export writes down, in no language yet: equations, constants, inputs, an initial state, times, a heading.

Letters: D states, N times.
"""

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np

from atoll.export.naming import Naming, harmless, spelled
from atoll.model.beginnings import recorded_inputs, start_of, times_of
from atoll.model.driving import inputs_along, require_inputs
from atoll.model.parameters import Parameter
from atoll.model.simulation import followed_sizes
from atoll_core import VERSION
from atoll_core.data.dataset import FloatArray
from atoll_core.errors import UsageError
from atoll_core.expression.operators import SQRT, VARIABLE
from atoll_core.expression.program import Program, constant_places
from atoll_core.expression.text.infix import to_code
from atoll_core.expression.text.notation import Notation
from atoll_core.expression.text.parsing import from_infix

if TYPE_CHECKING:
    from atoll.model.model import Model

WIDTH: Final = 100
"""Columns of a heading."""
_MOST_EVALUATIONS: Final = 20_000
"""Of the rates, to see how small states become: a part of a second."""
_UNDEFINED: Final = (
    "Arithmetic is that of doubles. Where the mathematics has no value (a division by zero, the logarithm or a broken "
    "power of a negative number)"
)
_LARGE_ANGLES: Final = "sin and cos of more than 1e5, which Atoll's search takes for undefined, have values here."


@dataclass(frozen=True)
class Variable:
    """A state: its `name` in expressions, its `column` in the data ("" where it has none), its `unit`."""

    name: str
    column: str
    unit: str


@dataclass(frozen=True, eq=False)
class Input:
    """A variable without an equation.

    It is the time itself, is held at a `value`, or goes along a `table`: pieces of cubics, (N - 1, 5), each the time
    from which it holds and the coefficients of the powers 0 to 3 of the time since then; `until` is the last time.
    """

    name: str
    column: str
    unit: str
    kind: Literal["time", "value", "table"]
    value: float = 0.0
    table: FloatArray | None = None
    until: float = 0.0


@dataclass(frozen=True, eq=False)
class Formula:
    """An expression: its program over the symbols of the content, and the names of those constants that have one."""

    program: Program
    constants: Mapping[int, str]


@dataclass(frozen=True, eq=False)
class Content:
    """A model as it is exported.

    `symbols` are the variables of all formulas. dx/dt of the D `states` are `rates`, from `start` (D,) at `begin` to
    `end` in `steps` equal steps; velocities are states behind the positions for order 2. `sizes` (D,), above 0, are
    those beside which errors of the states are to be small; of a process there are none. `covariance` has the entries
    of g g' of a process dx = f dt + g dW by the places of two states. A regression has no state, and one rate: its
    value. `constants` are those with a name, `lines` say where the model comes from.
    """

    symbols: tuple[str, ...]
    states: tuple[Variable, ...]
    inputs: tuple[Input, ...]
    constants: tuple[Parameter, ...]
    rates: tuple[Formula, ...]
    covariance: Mapping[tuple[int, int], Formula]
    start: tuple[float, ...]
    sizes: tuple[float, ...]
    begin: float
    end: float
    steps: int
    time: str
    time_unit: str
    target: str
    lines: tuple[str, ...]

    @property
    def variables(self) -> "tuple[Variable | Input, ...]":
        """States and inputs, the time left out."""
        return (*self.states, *(each for each in self.inputs if each.kind != "time"))

    @property
    def tables(self) -> tuple[Input, ...]:
        """The inputs that go along a table."""
        return tuple(each for each in self.inputs if each.kind == "table")

    @property
    def held(self) -> tuple[Input, ...]:
        """The inputs that are held at a value."""
        return tuple(each for each in self.inputs if each.kind == "value")


Times = tuple[float, float, int]
"""First time, last time, steps between."""


def content_of(
    model: "Model",
    x0: Any = None,
    t: Any = None,
    u: Mapping[str, Any] | None = None,
    without_tables: str = "",
) -> Content:
    """Return what `model` is, with an initial state, times and inputs as `Model.simulate` takes them.

    Inputs of which nothing is given and nothing was recorded are held at 0, and so are those recorded as they change
    where a format has no tables, `without_tables` being its name. Times are written as their first, their last and
    their number.

    Raises:
        UsageError: nothing tells the initial state or the times, what is given does not fit, or constants differ
            between groups of trajectories.
    """
    model.require_one_group()
    require_inputs(model, u or {})
    names = model.result.names
    formulas = _formulas(model, names)
    components = {} if model.is_regression else model.components
    by_name = dict(zip((equation.variable for equation in model.equations), formulas, strict=True))
    times = np.zeros(1) if model.is_regression else times_of(model, t)
    held = held_at_zero(model, x0, u, without_tables)
    recorded = _recorded(model, x0, without_tables)
    return Content(
        names,
        tuple(_variable(model, name) for name in model.states),
        tuple(_input(model, name, u or {}, times, recorded.get(name)) for name in model.inputs),
        tuple(each for each in model.params.values() if _is_named(each)),
        tuple(formulas[:1]) if model.is_regression else _rates(model, formulas, names),
        {pair: by_name[name] for name, pair in components.items()},
        () if model.is_regression else tuple(start_of(model, x0).tolist()),
        () if model.is_regression or components else _sizes(model, x0, times, u),
        float(times[0]),
        float(times[-1]),
        max(len(times) - 1, 1),
        model.time,
        model.result.units.get(model.time, ""),
        model.equations[0].variable if model.is_regression else "",
        (*_origin(model), *([""] if held else []), *held),
    )


def _sizes(model: "Model", x0: Any, times: FloatArray, u: Mapping[str, Any] | None) -> tuple[float, ...]:
    """Return how large simulations take the states to be, inputs of which nothing is known held at 0 as here."""
    known = {*(u or {}), *(_recorded(model, x0))}
    left = {name: 0.0 for name, column in inputs_beside_time(model).items() if not {name, column} & known}
    recorded = recorded_inputs(model) if x0 is None else {}
    inputs = inputs_along(model, {**left, **(u or {})}, times, recorded)
    return tuple(followed_sizes(model.field, start_of(model, x0), times, inputs, _MOST_EVALUATIONS).tolist())


def held_at_zero(model: "Model", x0: Any, u: Mapping[str, Any] | None, without_tables: str = "") -> tuple[str, ...]:
    """Return sentences on the inputs that an export holds at 0, by arguments of `content_of`."""
    if model.is_regression:
        return ()
    left = {name: its for name, its in inputs_beside_time(model).items() if not {name, its} & set(u or {})}
    known, kept = _recorded(model, x0), _recorded(model, x0, without_tables)
    lost = ", ".join(its for name, its in left.items() if name in known and name not in kept)
    unknown = ", ".join(its for name, its in left.items() if name not in known)
    return (
        *((f"inputs held at 0, not as recorded, since {without_tables} has no tables: {lost}",) if lost else ()),
        *((f"inputs held at 0, since nothing is given of them: {unknown}",) if unknown else ()),
    )


def inputs_beside_time(model: "Model") -> dict[str, str]:
    """Return the columns of the inputs that are not the time itself, by symbol."""
    columns = {name: _column(model, name) for name in model.inputs}
    return {name: column for name, column in columns.items() if column != model.time}


def _recorded(model: "Model", x0: Any, without_tables: str = "") -> dict[str, tuple[FloatArray, FloatArray]]:
    """Return times and values of recorded inputs as far as an export holds them; of another state than x0 none."""
    if x0 is not None or model.is_regression:
        return {}
    return {name: rows for name, rows in recorded_inputs(model).items() if not without_tables or _is_constant(rows[1])}


def _is_constant(values: FloatArray) -> bool:
    return bool((values == values[0]).all())


def _is_named(its: Parameter) -> bool:
    """Tell whether a constant gets a name: not a whole number that no fit has given an error, as the 2 of 2*x."""
    return its.stderr is not None or its.bounds is not None or not its.value.is_integer()


def _formulas(model: "Model", names: Sequence[str]) -> list[Formula]:
    """Return the right-hand sides of all equations; constants are counted as `Model.params` counts them."""
    found, count = [], 0
    for each in model.equations:
        program = from_infix(each.exact, names)
        places = constant_places(program)
        numbers = [f"c{count + index}" for index in range(1, len(places) + 1)]
        named = {place: name for place, name in zip(places, numbers, strict=True) if _is_named(model.params[name])}
        found.append(Formula(program, named))
        count += len(places)
    return found


def _rates(model: "Model", formulas: Sequence[Formula], names: Sequence[str]) -> tuple[Formula, ...]:
    """Return the rates in the order of the states: for order 2 those of positions are the velocities."""
    symbols = model.result.symbols
    of = {
        symbols[each.variable]: its
        for each, its in zip(model.equations, formulas, strict=True)
        if each.variable in symbols
    }
    if len(of) == len(model.states):
        return tuple(of[name] for name in model.states)
    half = len(model.states) // 2
    velocities = [Formula(Program.of([(VARIABLE, names.index(name), 0, 0.0)]), {}) for name in model.states[half:]]
    return (*velocities, *(of[name] for name in model.states[:half]))


def _column(model: "Model", symbol: str) -> str:
    return model.result.columns_by_symbol[symbol]


def _variable(model: "Model", name: str) -> Variable:
    column = _column(model, name)
    return Variable(name, column, model.result.units.get(column, ""))


def _input(
    model: "Model",
    name: str,
    given: Mapping[str, Any],
    times: FloatArray,
    recorded: tuple[FloatArray, FloatArray] | None,
) -> Input:
    column = _column(model, name)
    unit = model.result.units.get(column, "")
    its = next((given[each] for each in (name, column) if each in given), None)
    if its is None and column == model.time and not model.is_regression:
        return Input(name, column, unit, "time")
    if its is None and recorded is not None:
        times, its = recorded[0], recorded[1][0] if _is_constant(recorded[1]) else recorded[1]
    if callable(its):
        raise UsageError(f"the input {name!r} is a function, which no export can hold; give its values at the times t")
    values = np.asarray(0.0 if its is None else its, dtype=np.float64)
    if values.ndim == 0:
        return Input(name, column, unit, "value", float(values))
    if values.shape != times.shape or len(times) < 2:
        raise UsageError(f"the input {name!r} has {values.size} values for {times.size} times; give one for each")
    return Input(name, column, unit, "table", 0.0, _pieces(times, values), float(times[-1]))


def _pieces(times: FloatArray, values: FloatArray) -> FloatArray:
    """Return the pieces of the curve that simulations take (`atoll.model.simulation.interpolated`)."""
    from scipy.interpolate import PchipInterpolator

    curve = PchipInterpolator(times, values)
    return np.column_stack([curve.x[:-1], curve.c[::-1].T])


def _origin(model: "Model") -> list[str]:
    """Return lines on where the model comes from and what is known of it."""
    its = model.provenance
    lines = [f"Written by Atoll {VERSION}. Result: job {its['job']}, seed {its['seed']}, digest {its['digest']}."]
    if its["data"]:
        lines.append(f"Data: {', '.join(its['files'] or ())}, {its['rows']} rows, sha256 {its['data']}.")
    lines += ["", "Equations, with rounded constants:", *(f"  {each}" for each in [model.remark] if each)]
    for each in model.equations:
        lines.append(f"  {each}")
        if each.verdict is not None:
            lines.append(f"    {each.verdict}: {each.reason}")
    return lines


@dataclass(frozen=True)
class Language:
    """How a language writes expressions and names, what it calls the time, and how a comment begins.

    `where_undefined` says what happens where an expression has no value, `usage` how the file is used.
    """

    notation: Notation
    naming: Naming
    time: str
    comment: str
    where_undefined: str
    usage: str = ""


class Wording:
    """The parts of a content in one language."""

    def __init__(self, content: Content, language: Language) -> None:
        self.content = content
        self._language = language
        wanted = {each.name: each.name for each in content.variables}
        wanted |= {_key("constant", each.name): each.name for each in content.constants}
        wanted |= {_key("noise", name): name for name in self._helpers}
        self._names = language.naming.assign(wanted)
        self._names |= {each.name: language.time for each in content.inputs if each.kind == "time"}

    def __getitem__(self, its: str | Parameter) -> str:
        """Return what a variable, by its name, or a constant is called."""
        return self._names[its] if isinstance(its, str) else self.constant(its.name)

    def constant(self, name: str) -> str:
        """Return what a constant is called, by its name in the model."""
        return self._names[_key("constant", name)]

    def _of_noise(self, name: str) -> str:
        return self._names[_key("noise", name)]

    @property
    def states(self) -> list[str]:
        """What the states are called."""
        return [self[each.name] for each in self.content.states]

    @property
    def time(self) -> str:
        """The name of the time in a table: that of the column, in plain letters."""
        return spelled(self.content.time)

    @property
    def target(self) -> str:
        """What a regression gives the value of, in plain letters."""
        return spelled(self.content.target)

    def text(self, formula: Formula) -> str:
        """Return an expression."""
        symbols = [self._names.get(name, "") for name in self.content.symbols]
        constants = {place: self.constant(name) for place, name in formula.constants.items()}
        return to_code(formula.program, symbols, self._language.notation, constants)

    @property
    def rates(self) -> list[str]:
        """The right-hand sides."""
        return [self.text(each) for each in self.content.rates]

    @cached_property
    def _helpers(self) -> list[str]:
        size = len(self.content.states) if self.content.covariance else 0
        lower = [f"{kind}{i + 1}_{j + 1}" for kind in ("b", "g") for i in range(size) for j in range(i + 1)]
        return lower + [f"w{place + 1}" for place in range(size)]

    @property
    def normals(self) -> list[str]:
        """What the components of dW are called."""
        return [self._of_noise(f"w{place + 1}") for place in range(len(self.content.states))]

    @property
    def noise(self) -> "tuple[list[tuple[str, str]], list[list[str]]]":
        """What multiplies dW: assignments (name, expression) in order, and the names in each row of g, "" for 0.

        g is the lower triangle with g g' = B (Cholesky).
        """
        root = self._language.notation.call(SQRT)
        size = len(self.content.states)
        assignments = [
            (self._of_noise(f"b{max(pair) + 1}_{min(pair) + 1}"), self.text(its))
            for pair, its in self.content.covariance.items()
        ]
        rows = [[""] * size for _ in range(size)]
        for i in range(size):
            for j in range(i + 1):
                products = [f"{rows[i][k]}*{rows[j][k]}" for k in range(j) if rows[i][k] and rows[j][k]]
                has_own = (min(i, j), max(i, j)) in self.content.covariance
                if not has_own and (not products or i == j):
                    continue
                rest = " - ".join([self._of_noise(f"b{i + 1}_{j + 1}") if has_own else "0.0", *products])
                rows[i][j] = self._of_noise(f"g{i + 1}_{j + 1}")
                text = f"{root}({rest})" if i == j else f"({rest})/{rows[j][j]}"
                assignments.append((rows[i][j], text))
        return assignments, rows

    def heading(self, *more: str) -> list[str]:
        """Return the comment at the top: where the model comes from, what is called how, and `more`."""
        its = self._language
        arithmetic = f"{_UNDEFINED} {its.where_undefined}. {_LARGE_ANGLES}"
        usage = [line for line in (its.usage, *more) if line]
        lines = [*self.content.lines, *self._notes(), "", *usage, arithmetic]
        wrapped = [part for line in lines for part in _wrapped(line)]
        return [f"{self._language.comment} {line}".rstrip() for line in wrapped]

    def note(self, its: Parameter) -> str:
        """Return what is known of a constant, for a comment beside it."""
        unit = harmless(its.unit) if its.unit is not None and its.unit != "1" else ""
        error = "" if its.stderr is None else f"standard error {its.stderr:.2g}"
        return ", ".join(each for each in (unit, error) if each)

    def about(self, its: Variable | Input) -> str:
        """Return what a variable is: its column and unit, for a comment beside it."""
        unit = f" [{harmless(its.unit)}]" if its.unit else ""
        return f"column {harmless(its.column)}{unit}"

    def _notes(self) -> list[str]:
        found = [
            f"  {self[each.name]} is the column '{each.column}'"
            for each in self.content.variables
            if self[each.name] != each.column
        ]
        found += [
            f"  {self[each]} is the constant {each.name}" for each in self.content.constants if self[each] != each.name
        ]
        lines = ["", "Names:", *found] if found else []
        if self.content.covariance:
            lines += ["", "Noise: dx = f dt + g dW in the sense of Ito; g is the root of the covariance per time."]
        return lines


def _key(kind: str, name: str) -> str:
    """Return a key that is no name of a variable."""
    return f"{kind} {name}"


def _wrapped(line: str) -> list[str]:
    indent = line[: len(line) - len(line.lstrip())]
    text = harmless(line)
    further = f"{indent}  " if indent else ""
    return textwrap.wrap(text, WIDTH, initial_indent=indent, subsequent_indent=further) or [""]


def refuse_noise(content: Content, name: str) -> None:
    """Raise UsageError where a process would lose its noise."""
    if content.covariance:
        raise UsageError(f"{name} cannot hold the noise of a process; python, julia and xppaut can")


def refuse_regression(content: Content, name: str) -> None:
    """Raise UsageError where there is no time."""
    if not content.states:
        raise UsageError(
            f"{name} holds what moves in time, and this model does not; python, c, julia, matlab, latex and sympy can"
        )


def refuse_tables(content: Content, name: str) -> None:
    """Raise UsageError where an input goes along a table."""
    if content.tables:
        raise UsageError(
            f"{name} cannot hold the table of the input '{content.tables[0].name}'; give one number for it"
        )
