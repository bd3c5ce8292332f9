"""Two models beside each other: whose equations describe the same data better, and how sure that is.

Models of trajectories are fitted again, all constants free, to the same measurements, and weighed by Akaike's weights,
as the candidates of a suggestion are. EquationSet y = f(X) are compared as they are, over the rows that a result lists.
Letters: N rows.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from atoll.experiments.alternatives import half_akaike, weighed_pair
from atoll.experiments.fits import FittedEquations, equations_of, fit_equations, fit_shown, measured_of
from atoll.experiments.suggestion import equations_text, which_of_two
from atoll.model.equations import Parameter
from atoll.model.model import Model
from atoll.terminal.output import attributes, plain
from atoll_coordinator.result.result import Result
from atoll_core.data.dataset import FloatArray
from atoll_core.data.table import Table
from atoll_core.errors import UsageError
from atoll_core.expression.program import structure, variables_of
from atoll_core.expression.text.infix import to_infix
from atoll_core.expression.text.parsing import from_infix
from atoll_core.quoting import first_lines

SCHEMA: Final = 1
_NAMES: Final = ("A", "B")
_LEVEL: Final = 0.95
"""Probability with which all constants of two fits of one law agree: that of the intervals which results give."""


@dataclass(frozen=True)
class ComparedModel:
    """One of two models on some data: its `equations` by left-hand side as they are compared, with so many `constants`.

    `residuals` are root mean squares over the standard deviation of each state.
    """

    equations: Mapping[str, str]
    constants: int
    residuals: Mapping[str, float]


@dataclass(frozen=True)
class OnData:
    """Both models on the same data, of which `source` says where they come from.

    `nats` is the logarithm of the odds for A, by how well the data are described; `longer` by how many nats the
    description by B is longer, which also counts what the equations are made of (None of equations without time).
    """

    source: str
    sides: tuple[ComparedModel, ComparedModel]
    nats: float
    longer: float | None

    @property
    def sentence(self) -> str:
        """Which of the two is right, and how sure that is."""
        return which_of_two(*_NAMES, self.nats)

    @property
    def length_sentence(self) -> str:
        """Whose description is shorter; "" where that is not known."""
        if self.longer is None or abs(self.longer) < 0.05:
            return ""
        shorter = _NAMES[0] if self.longer > 0.0 else _NAMES[1]
        return f"Δ description length, equations included: {abs(self.longer):.1f} in favour of {shorter}."


@dataclass(frozen=True)
class Comparison:
    """What two models, called A and B, have in common and how well they describe the same data.

    `names` are what they were given as, `forms` says of each equation whether both have the same; `data` has an entry
    for the data of A and, where these are others, of B.
    """

    names: tuple[str, str]
    equations: tuple[Mapping[str, str], Mapping[str, str]]
    forms: Mapping[str, str]
    data: tuple[OnData, ...]

    def __str__(self) -> str:
        each = zip(_NAMES, self.names, self.equations, strict=True)
        lines = [f"{letter} = {name}: {equations_text(equations)}" for letter, name, equations in each]
        lines += [f"{side}: {text}" for side, text in self.forms.items()]
        for on in self.data:
            lines.append(f"on {on.source}:")
            for letter, side in zip(_NAMES, on.sides, strict=True):
                left = ", ".join(f"{name} {100.0 * share:.2g} %" for name, share in side.residuals.items())
                lines.append(
                    f"  {letter}: residuals {left} of the standard deviation; {side.constants} constants; "
                    f"{equations_text(side.equations)}"
                )
            lines += [f"  {sentence}" for sentence in (on.sentence, on.length_sentence) if sentence]
        return "\n".join(lines)

    def __repr__(self) -> str:
        return first_lines(str(self), "print it")

    def as_dict(self) -> dict[str, object]:
        """Return all of it as plain data, as ``coordinator compare --json`` prints it."""
        data = [
            attributes(on, "source", "nats", "longer", "sentence")
            | {letter: vars(side) for letter, side in zip(_NAMES, on.sides, strict=True)}
            for on in self.data
        ]
        models = {
            letter: {"name": name, "equations": equations}
            for letter, name, equations in zip(_NAMES, self.names, self.equations, strict=True)
        }
        return plain({"schema": SCHEMA, **models, "forms": self.forms, "data": data})


def compare(
    first: Result, second: Result, names: tuple[str, str] = ("the first", "the second"), table: Table | None = None
) -> Comparison:
    """Return two models beside each other.

    Args:
        first: A; its data are those that both are compared on.
        second: B; where its data are others, both are compared on these as well.
        names: what they are called.
        table: measurements in the place of those of the results.

    Raises:
        UsageError: they are not of the same states or target, or there are no measurements.
        AtollError: one cannot be simulated along the data.
    """
    models = Model(first), Model(second)
    for model in models:
        model.require_one_group()
    _require_alike(*models)
    on = _regressions if models[0].is_regression else _dynamics
    data = [on(first, second, "A", table)]
    if table is None and not _have_same_data(first, second):
        turned = on(second, first, "B", table)
        turned_length = None if turned.longer is None else -turned.longer
        data.append(OnData(turned.source, (turned.sides[1], turned.sides[0]), -turned.nats, turned_length))
    shown = tuple({equation.lhs: equation.expression for equation in model.equations} for model in models)
    return Comparison(names, (shown[0], shown[1]), _forms(*models), tuple(data))


def _require_alike(first: Model, second: Model) -> None:
    """Raise UsageError where two models are not of the same quantities."""
    sides = [[equation.lhs for equation in model.equations] for model in (first, second)]
    if sorted(sides[0]) != sorted(sides[1]) or first.is_regression != second.is_regression:
        left, right = (", ".join(names) for names in sides)
        raise UsageError(f"A has equations of {left} and B of {right}; compare models of the same quantities")


def _have_same_data(first: Result, second: Result) -> bool:
    digests = [None if result.data is None else result.data.digest for result in (first, second)]
    return digests[0] == digests[1]


def _forms(first: Model, second: Model) -> dict[str, str]:
    """Return for each equation whether both models have the same, and by how much its constants differ."""
    others = {equation.lhs: equation for equation in second.equations}
    forms = {}
    for equation in first.equations:
        other = others[equation.lhs]
        names = tuple(dict.fromkeys((*first.result.names, *second.result.names)))
        programs = [from_infix(one.exact, names) for one in (equation, other)]
        if programs[0] == programs[1]:
            forms[equation.lhs] = "the same equation"
        elif structure(programs[0]) != structure(programs[1]):
            forms[equation.lhs] = "another form"
        else:
            constants = [
                [constant for constant in model.params.values() if constant.variable == equation.variable]
                for model in (first, second)
            ]
            forms[equation.lhs] = f"the same form; {_difference(*constants)}"
    return forms


def _difference(first: Sequence[Parameter], second: Sequence[Parameter]) -> str:
    """Return by how many standard errors the constants of two equations of one form differ."""
    largest, name = 0.0, ""
    for one, other in zip(first, second, strict=True):
        error = math.hypot(one.stderr or 0.0, other.stderr or 0.0)
        if one.value != other.value and not error > 0.0:
            return f"other constants, whose errors are not known ({one.name}: {one.value:.6g} and {other.value:.6g})"
        errors = abs(one.value - other.value) / error if error > 0.0 else 0.0
        if errors >= largest:
            largest, name = errors, one.name
    agree = "agree within their errors" if largest <= _most_errors(len(first)) else "differ"
    return f"its constants {agree}, {name} by {largest:.2g} standard errors"


def _most_errors(count: int) -> float:
    """Return the standard errors that the largest of so many normal differences does not exceed at `_LEVEL` (Šidák)."""
    from scipy.special import ndtri

    return float(ndtri(0.5 + 0.5 * _LEVEL ** (1.0 / max(count, 1))))


def _dynamics(holder: Result, other: Result, letter: str, table: Table | None) -> OnData:
    """Compare on the data of `holder`, called `letter`, or of a table."""
    _require_columns(holder, other)
    shown = fit_shown(measured_of(holder, table), holder)
    texts = {equation.variable: equation.expression or "" for equation in other.equations}
    equations = equations_of(holder)
    for place, (variable, entry) in enumerate(zip(equations.variables, holder.equations, strict=True)):
        program = from_infix(texts[variable], equations.names)
        if program != from_infix(entry.expression or "", equations.names):
            equations = equations.exchanged(place, program)
    fitted = fit_equations(shown.measured, equations, shown.fit.starts)
    if fitted is None:
        raise UsageError(
            "one of the models cannot be simulated along the data of the other; compare them on other data"
        )
    nats, longer = weighed_pair(shown, fitted)
    source = shown.measured.source.replace("the result", letter)
    return OnData(source, (_side(holder, shown), _side(holder, fitted)), nats, longer)


def _require_columns(holder: Result, other: Result) -> None:
    """Raise UsageError where the data of one result lack what the equations of the other are made of."""
    for equation in other.equations:
        program = from_infix(equation.expression or "", other.names)
        used = {other.names[place] for place in variables_of(program)}
        lacking = sorted(used - set(holder.names))
        if lacking:
            raise UsageError(
                f"the equation of {equation.lhs} has {', '.join(lacking)}, which the data of the other model lack; "
                "compare models of the same columns"
            )


def _side(result: Result, fitted: FittedEquations) -> ComparedModel:
    equations, measurements = fitted.equations, fitted.measured.measurements
    programs = fitted.fit.system.programs[-len(equations.programs) :]
    pairs = zip(result.equations, programs, strict=True)
    texts = {equation.lhs: to_infix(program, equations.names, digits=4) for equation, program in pairs}
    observed = [measurements.variables[place] for place in measurements.observed.tolist()]
    shares = np.sqrt(fitted.fit.squares) / measurements.scales[measurements.observed]
    return ComparedModel(texts, len(fitted.values), dict(zip(observed, shares.tolist(), strict=True)))


def _regressions(holder: Result, other: Result, letter: str, table: Table | None) -> OnData:
    """Compare two equations y = f(X) over the rows that a result lists, their constants as they are."""
    rows = holder.regression
    if table is not None:
        raise UsageError("equations without time are compared on the rows of their results; leave the data out")
    if rows is None or not rows.measured:
        raise UsageError(f"{letter} has no measured rows; compare results that have them")
    _require_columns(holder, other)
    target = np.array(rows.measured, dtype=np.float64)
    count = float(rows.rows or len(target))
    sides, lengths = [], []
    for result in (holder, other):
        values = Model(result).predict(_columns(holder, result))
        left = target - values
        known = np.isfinite(left)
        square = float(np.mean(left[known] ** 2)) if known.all() else math.inf
        constants = len(Model(result).params)
        spread = float(np.nanstd(target)) or 1.0
        equation = Model(result).equations[0]
        sides.append(
            ComparedModel(
                {equation.lhs: equation.expression}, constants, {equation.variable: math.sqrt(square) / spread}
            )
        )
        misfit = 0.5 * count * math.log(max(square, 1e-24 * spread**2)) if math.isfinite(square) else math.inf
        lengths.append(half_akaike(misfit, constants, count))
    nats = lengths[1] - lengths[0] if math.isfinite(lengths[0]) or math.isfinite(lengths[1]) else 0.0
    return OnData(f"{len(target)} of {count:.0f} rows of {letter}", (sides[0], sides[1]), nats, None)


def _columns(holder: Result, result: Result) -> dict[str, FloatArray]:
    """Return the variables of a result over the rows that another one lists, by symbol."""
    rows = holder.regression
    assert rows is not None
    by_symbol = {holder.symbols.get(column, column): curve for column, curve in rows.variables.items()}
    length = len(rows.measured)
    return {name: np.array(by_symbol.get(name, (0.0,) * length), dtype=np.float64) for name in result.names}
