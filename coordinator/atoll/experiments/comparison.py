"""Compare two models: which equations fit the same data better, and with what odds.

Models of trajectories are fitted again to the same measurements, with all constants free. Their odds are the ratio of
their Akaike weights, as for the candidates of a suggestion. Equations y = f(X) are not fitted again; they are compared
on the rows that a result lists. Letters: N rows.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from atoll.experiments.alternatives import half_akaike, weigh_pair
from atoll.experiments.fits import (
    EquationSetFit,
    equations_of,
    fit_displayed,
    fit_equations,
    measured_of,
    starts_of,
)
from atoll.experiments.suggestion import equations_text, which_of_two
from atoll.model.core import ModelCore
from atoll.model.equations import DisplayedEquation, Parameter, numbers_of
from atoll.terminal.output import attributes, plain
from atoll_coordinator.result.result import Result
from atoll_core.data.table import Table
from atoll_core.errors import UsageError
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.program import structure, variables_of
from atoll_core.expression.text.parsing import from_infix
from atoll_core.quoting import first_lines

SCHEMA: Final = 1
_NAMES: Final = ("A", "B")
_LEVEL: Final = 0.95
"""Probability that all constants of two fits of the same law agree: the level of the intervals in results."""


@dataclass(frozen=True)
class ComparedModel:
    """The fit of a model to some data: its `equations` by left-hand side, and its number of `constants`.

    `residuals` are root mean squared residuals by state, divided by the standard deviation of the state.
    """

    equations: Mapping[str, str]
    constants: int
    residuals: Mapping[str, float]


@dataclass(frozen=True)
class DataComparison:
    """The fits of both models to the same data; `source` names the data.

    `columns` are the measured columns by which models with different states are compared; empty for equal states.
    `nats` is the logarithm of the odds for A, from the fits alone. `longer` is the description length of B minus the
    description length of A in nats. Description lengths include the lengths of the equations; they are not known for
    equations without time, and `longer` is then None.
    """

    source: str
    sides: tuple[ComparedModel, ComparedModel]
    nats: float
    longer: float | None
    columns: tuple[str, ...] = ()

    @property
    def sentence(self) -> str:
        """A sentence that says which model the data favour, and with what odds."""
        return which_of_two(*_NAMES, self.nats)

    @property
    def length_sentence(self) -> str:
        """A sentence that says which description is shorter; "" if they are equal or not known."""
        if self.longer is None or abs(self.longer) < 0.05:
            return ""
        shorter = _NAMES[0] if self.longer > 0.0 else _NAMES[1]
        return f"Δ description length, equations included: {abs(self.longer):.1f} in favour of {shorter}."


@dataclass(frozen=True)
class Comparison:
    """Two models, called A and B: the forms of their equations, and their fits to the same data.

    `names` are the names that the user gave. `forms` compares the form of each equation. `data` has an entry for the
    data of A and, if B has different data, one for the data of B.
    """

    names: tuple[str, str]
    equations: tuple[Mapping[str, str], Mapping[str, str]]
    forms: Mapping[str, str]
    data: tuple[DataComparison, ...]

    def __str__(self) -> str:
        each = zip(_NAMES, self.names, self.equations, strict=True)
        lines = [f"{letter} = {name}: {equations_text(equations)}" for letter, name, equations in each]
        lines += [f"{side}: {text}" for side, text in self.forms.items()]
        for on in self.data:
            by = f", by the measured {', '.join(on.columns)}" if on.columns else ""
            lines.append(f"on {on.source}{by}:")
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
        """Return the comparison as plain data, as ``coordinator compare --json`` prints it."""
        data = [
            attributes(on, "source", "nats", "longer", "sentence")
            | ({"columns": on.columns} if on.columns else {})
            | dict(zip(_NAMES, on.sides, strict=True))
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
    """Compare two models.

    Args:
        first: model A; both models are compared on its data.
        second: model B; if its data are different, both models are compared on its data too. Its states may differ, if
            the measured columns are the same, as for models of first and of second order.
        names: the names of the models.
        table: measurements that replace the measurements in the results.

    Raises:
        UsageError: the models have different states or targets, or there are no measurements.
        AtollError: a model cannot be simulated along the data.
    """
    models = ModelCore(first), ModelCore(second)
    for model in models:
        model.require_one_group()
    on = _regressions if models[0].is_regression else _trajectories
    if models[0].is_regression != models[1].is_regression or not _have_equal_states(first, second):
        columns = [_observed_columns(model) for model in models]
        if not columns[0] or columns[0] != columns[1]:
            left, right = (", ".join(equation.lhs for equation in model.equations) for model in models)
            raise UsageError(
                f"A has equations of {left} and B of {right}; compare models of the same quantities, or models of "
                "trajectories with the same measured columns"
            )
    data = [on(first, second, "A", table)]
    digests = [None if result.data is None else result.data.digest for result in (first, second)]
    if table is None and digests[0] != digests[1]:
        swapped = on(second, first, "B", table)
        swapped_length = None if swapped.longer is None else -swapped.longer
        turned = (swapped.sides[1], swapped.sides[0])
        data.append(DataComparison(swapped.source, turned, -swapped.nats, swapped_length, swapped.columns))
    displayed = tuple({equation.lhs: equation.expression for equation in model.equations} for model in models)
    return Comparison(names, (displayed[0], displayed[1]), _forms(*models), tuple(data))


def _forms(first: ModelCore, second: ModelCore) -> dict[str, str]:
    """Return for each equation of both models whether they have the same form, and how much its constants differ."""
    others = {equation.lhs: equation for equation in second.equations}
    forms = {}
    for equation in first.equations:
        other = others.get(equation.lhs)
        if other is None:
            continue
        names = tuple(dict.fromkeys((*first.result.names, *second.result.names)))
        programs = [from_infix(one.exact, names) for one in (equation, other)]
        if programs[0] == programs[1]:
            forms[equation.lhs] = "the same equation"
        elif structure(programs[0]) != structure(programs[1]):
            forms[equation.lhs] = "another form"
        elif equation.given is not None and other.given is not None and equation.given.text != other.given.text:
            forms[equation.lhs] = f"the same form, given as {equation.given.text} and as {other.given.text}"
        elif (equation.given is None) is not (other.given is None):
            forms[equation.lhs] = "the same form; one of the models has parts that the user gave"
        else:
            constants = [_constants_in(model, equation) for model in (first, second)]
            forms[equation.lhs] = f"the same form; {_difference(*constants)}"
    return forms


def _constants_in(model: ModelCore, equation: DisplayedEquation) -> list[Parameter]:
    """Return the constants of an equation, in order; for a given side also parameters that stand in other sides."""
    if equation.given is None:
        return [constant for constant in model.params.values() if constant.variable == equation.variable]
    names = dict.fromkeys(one.name for one in numbers_of(model.result)[equation.variable])
    return [model.params[name] for name in names if name in model.params]


def _difference(first: Sequence[Parameter], second: Sequence[Parameter]) -> str:
    """Return the largest difference between the constants of two equations with the same form, in standard errors."""
    largest, name = 0.0, ""
    for one, other in zip(first, second, strict=True):
        error = math.hypot(one.stderr or 0.0, other.stderr or 0.0)
        if one.value != other.value and not error > 0.0:
            return f"different constants with unknown errors ({one.name}: {one.value:.6g} and {other.value:.6g})"
        errors = abs(one.value - other.value) / error if error > 0.0 else 0.0
        if errors >= largest:
            largest, name = errors, one.name
    agree = "agree within their errors" if largest <= most_errors(len(first)) else "differ"
    return f"its constants {agree}, {name} by {largest:.2g} standard errors"


def most_errors(count: int) -> float:
    """Return the bound, in standard errors, on the largest of `count` normal differences at `_LEVEL` (Šidák)."""
    from scipy.special import ndtri

    return float(ndtri(0.5 + 0.5 * _LEVEL ** (1.0 / max(count, 1))))


def _have_equal_states(first: Result, second: Result) -> bool:
    """Tell whether two models have equations of the same sides, and all their states are measured."""
    sides = [sorted(equation.lhs for equation in result.equations) for result in (first, second)]
    return sides[0] == sides[1] and not any(result.unmeasured or result.observations for result in (first, second))


def _observed_columns(model: ModelCore) -> frozenset[str]:
    """Return the measured columns with an equation; none unless the model is a law of trajectories."""
    if model.result.columns.kind != "dynamics":
        return frozenset()
    return frozenset(_measured_columns(model.result))


def _measured_columns(result: Result) -> tuple[str, ...]:
    """Return the measured columns that a law of trajectories predicts."""
    states = (equation.variable for equation in result.equations if equation.variable not in result.unmeasured)
    return (*states, *(one.column for one in result.observations))


def _trajectories(holder: Result, other: Result, letter: str, table: Table | None) -> DataComparison:
    """Compare two models by their residuals in the same measured columns.

    The other model is fitted to the same rows of the same columns, from as many initial states. All values that are
    fitted, hidden initial states too, count in the odds.
    """
    if table is None:
        _require_columns(holder, other)
    displayed = fit_displayed(measured_of(holder, table), holder)
    there = other.model_copy(update={"data": holder.data, "smoothing": holder.smoothing, "noise": holder.noise})
    inputs = tuple(name for name in other.columns.inputs if name in holder.columns.inputs)
    there = there.model_copy(update={"system": other.columns.model_copy(update={"inputs": inputs})})
    measured = measured_of(there, table).with_piece(displayed.measured.longest)
    measured = replace(measured, rows=displayed.measured.rows, source=displayed.measured.source)
    starts = starts_of(other, measured) if other.unmeasured else None
    columns = () if _have_equal_states(holder, other) else _measured_columns(holder)
    if not columns and measured.measurements.variables == displayed.measured.measurements.variables:
        starts = displayed.fit.starts
    fitted = fit_equations(measured, equations_of(other), starts)
    return _compare_fits(displayed, holder, fitted, other, letter, columns)


def _compare_fits(
    displayed: EquationSetFit, holder: Result, fitted: EquationSetFit | None, other: Result, letter: str,
    columns: tuple[str, ...] = (),
) -> DataComparison:  # fmt: skip
    """Return the comparison of two fits; the left-hand sides of the second fit are in the result `other`."""
    if fitted is None:
        raise UsageError(
            "one model cannot be simulated along the data of the other model; compare them on different data"
        )
    nats, longer = weigh_pair(displayed, fitted)
    source = displayed.measured.source.replace("the result", letter)
    return DataComparison(source, (_side(holder, displayed), _side(other, fitted)), nats, longer, columns)


def _require_columns(holder: Result, other: Result) -> None:
    """Raise UsageError if the data of `holder` lack inputs in the equations of the other result."""
    inputs = {*ModelCore(other).inputs}
    for equation in other.equations:
        program = from_infix(equation.expression or "", other.names)
        used = {other.names[place] for place in variables_of(program)} & inputs
        lacking = sorted(used - set(holder.names))
        if lacking:
            raise UsageError(
                f"the equation of {equation.lhs} has {', '.join(lacking)}, but the data of the other model do not; "
                "compare models of the same columns"
            )


def _side(result: Result, fitted: EquationSetFit) -> ComparedModel:
    measurements = fitted.measured.measurements
    names = (*measurements.variables[: len(measurements.scales)], *fitted.measured.recording.observed)
    observed = [names[place] for place in measurements.observed.tolist()]
    shares = np.sqrt(fitted.fit.squares) / measurements.observed_scales
    residuals = dict(zip(observed, shares.tolist(), strict=True))
    return ComparedModel(fitted.texts(result), len(fitted.values), residuals)


def _regressions(holder: Result, other: Result, letter: str, table: Table | None) -> DataComparison:
    """Compare two equations y = f(X) over the rows listed in a result, without fitting constants again."""
    rows = holder.regression
    if table is not None:
        raise UsageError("equations without time are compared on the rows of their results; do not give data")
    if rows is None or not rows.measured:
        raise UsageError(f"{letter} has no measured rows; compare results with measured rows")
    _require_columns(holder, other)
    target = np.array(rows.measured, dtype=np.float64)
    count = float(rows.rows or len(target))
    by_symbol = {holder.symbols.get(column, column): curve for column, curve in rows.variables.items()}
    sides, lengths = [], []
    for result in (holder, other):
        model, unused = ModelCore(result), (0.0,) * len(target)
        columns = np.array([by_symbol.get(name, unused) for name in result.names], dtype=np.float64)
        residuals = target - values_of(from_infix(model.equations[0].exact, result.names), columns)
        known = np.isfinite(residuals)
        square = float(np.mean(residuals[known] ** 2)) if known.all() else math.inf
        spread = float(np.nanstd(target)) or 1.0
        equation = model.equations[0]
        shares = {equation.variable: math.sqrt(square) / spread}
        sides.append(ComparedModel({equation.lhs: equation.expression}, len(model.params), shares))
        misfit = 0.5 * count * math.log(max(square, 1e-24 * spread**2)) if math.isfinite(square) else math.inf
        lengths.append(half_akaike(misfit, len(model.params), count))
    nats = lengths[1] - lengths[0] if math.isfinite(lengths[0]) or math.isfinite(lengths[1]) else 0.0
    return DataComparison(f"{len(target)} of {count:.0f} rows of {letter}", (sides[0], sides[1]), nats, None)
