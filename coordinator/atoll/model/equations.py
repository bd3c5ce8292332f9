"""The constants of a model by name, with their errors.

The equations of a model as people read them.

What is said of a constant: its value, its standard error, what keeps both from being taken as they are.

Groups of trajectories that differ in constants: which there are, and the result of one of them.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from atoll_coordinator.result.base import Pair
from atoll_coordinator.result.equations import Constant, Equation, GroupEquation
from atoll_coordinator.result.findings import Group, Noise
from atoll_coordinator.result.result import Result
from atoll_core.config import DataConfig
from atoll_core.expression.program import Program, constant_places
from atoll_core.expression.text.infix import to_infix
from atoll_core.expression.text.parsing import from_infix

LEVEL: Final = 0.95
"""The level of the intervals that a result has."""

Number = tuple[float, Constant | None]
"""A number of a text, and what is known of it if it is one of its constants: not of the 2 of 2*x for x + x."""


@dataclass(frozen=True)
class Parameter:
    """A constant of a model.

    `name` is c1, c2, … over all equations, `variable` the state of its equation; `stderr` is its standard error,
    `interval` its 95 % one, None where they are not known; `identifiable`: the data determine it. `unit` is its unit,
    "1" of a pure number, None where units do not tell; `bounds` are those that were set for it, None on an open side.
    """

    name: str
    variable: str
    value: float
    stderr: float | None = None
    interval: tuple[float, float] | None = None
    identifiable: bool = True
    unit: str | None = None
    bounds: tuple[float | None, float | None] | None = None

    def interval_at(self, level: float, freedom: float | None) -> tuple[float, float] | None:
        """Return the interval at `level`, by Student's t with so many degrees of freedom (None: infinitely many).

        None where there is none, or where it is known at 95 % alone, as that of a constant on its bound is.
        """
        if level == LEVEL:
            return self.interval
        if self.stderr is None or self.interval is None:
            return None
        middle, half = 0.5 * (self.interval[0] + self.interval[1]), quantile(level, freedom) * self.stderr
        return middle - half, middle + half


def quantile(level: float, freedom: float | None) -> float:
    """Return how many standard errors lie on either side of an interval at `level`; see `Parameter.interval_at`."""
    from scipy import special

    below = 0.5 + level / 2.0
    return float(special.ndtri(below) if freedom is None else special.stdtrit(freedom, below))


def parameters_of(result: Result) -> dict[str, Parameter]:
    """Return the constants of all equations by name, in the order of a `VectorField` of them.

    Where groups of trajectories differ in a constant, it has a value for each: ``c1[strain 2]``.
    """
    label = result.data_settings.get("group") or "trajectory"
    parameters: list[Parameter] = []
    count = 0
    for equation in result.equations:
        by_group = [(f"[{label} {group.group}]", _numbers(group, result.names)) for group in equation.groups]
        for place, (value, constant) in enumerate(_numbers(equation, result.names)):
            count += 1
            values = [("", value, constant)]
            if by_group and (constant is None or constant.shared is False):
                values = [(suffix, *numbers[place]) for suffix, numbers in by_group]
            parameters += [
                _parameter(f"c{count}{suffix}", equation.variable, number, known) for suffix, number, known in values
            ]
    return {parameter.name: parameter for parameter in parameters}


def constant_names(result: Result) -> dict[str, list[str]]:
    """Return by equation what its `constants` are called in `parameters_of`; one that its text lacks by its value."""
    names: dict[str, list[str]] = {}
    count = 0
    for equation in result.equations:
        numbers = _numbers(equation, result.names)
        places = {id(constant): f"c{count + place}" for place, (_, constant) in enumerate(numbers, start=1)}
        names[equation.variable] = [
            places.get(id(constant)) or f"{constant.value or 0.0:.6g}" for constant in equation.constants
        ]
        count += len(numbers)
    return names


def _numbers(equation: Equation | GroupEquation, names: Sequence[str]) -> list[Number]:
    """Return the numbers of an equation's text, each with what is known of it if it is one of its constants."""
    if equation.expression is None:
        return []
    left = list(equation.constants)
    program = from_infix(equation.expression, names)
    numbers: list[Number] = []
    for value in program.constants[constant_places(program)].tolist():
        constant = next((each for each in left if each.value is not None and abs(each.value) == abs(value)), None)
        left = [each for each in left if each is not constant]
        numbers.append((value, constant))
    return numbers


def _parameter(name: str, variable: str, value: float, constant: Constant | None) -> Parameter:
    """Return a constant with its errors; the sign of `value` is that of the text, where a minus may stand before it."""
    if constant is None:
        return Parameter(name, variable, value)
    is_turned = value * (constant.value or 0.0) < 0.0
    low, high = _swap(constant.interval, is_turned) or (None, None)
    interval = None if low is None or high is None else (low, high)
    bounds = _swap(constant.bounds, is_turned)
    return Parameter(name, variable, value, constant.std_error, interval, constant.identifiable, constant.unit, bounds)


def _swap(pair: Pair | None, is_turned: bool) -> Pair | None:
    """Return lower and upper end of a range, of that of the opposite number if it `is_turned`."""
    if pair is None or not is_turned:
        return pair
    low, high = pair
    return None if high is None else 0.0 - high, None if low is None else 0.0 - low


def r2_text(value: float | None) -> str:
    """Return R2 in four decimals, never rounded up to 1; ``-`` for None."""
    if value is None:
        return "-"
    return "1" if value == 1.0 else f"{math.floor(value * 1e4) / 1e4:.4f}" if value > -10.0 else f"{value:.2g}"


def unit_text(unit: str | None) -> str:
    """Return a unit as it stands behind a number; "" of a pure number and where units do not tell."""
    return f" {unit}" if unit not in (None, "1") else ""


def interval_text(bounds: Sequence[float | None] | None) -> str:
    """Return ``1.99956 to 2.00019``, with digits that tell the ends apart; ``-`` where an end is not known."""
    low, high = bounds or (None, None)
    if low is None or high is None:
        return "-"
    spread = high - low
    digits = 6 if spread <= 0.0 else 3 + max(0, math.floor(math.log10(max(abs(low), abs(high)) / spread)))
    return f"{low:.{digits}g} to {high:.{digits}g}"


DIGITS: Final = 6
"""Significant digits of the constants that people are shown."""

_COMPOUND: Final = re.compile(r"[\s*/^.·⋅×⁻¹²³]|\d")
"""What a unit of several factors or with a power has."""


def program_of(equation: Equation, names: Sequence[str]) -> Program:
    """Return a right-hand side over the variables of these names, as it was computed where that is known."""
    if equation.program:
        return Program.from_bytes(bytes.fromhex(equation.program), len(names))
    return from_infix(equation.expression or "", names)


def rounded(expression: str, names: Sequence[str]) -> str:
    """Return an expression over these names with its constants rounded to `DIGITS`."""
    return to_infix(from_infix(expression, names), names, digits=DIGITS)


@dataclass(frozen=True)
class DisplayedEquation:
    """One equation: `lhs` = `expression`, for people with rounded constants; `exact` is the text to the last bit.

    `unit` is that of the left-hand side, "" where columns have none. `verdict` and `reason` say how far to trust it.
    """

    variable: str
    lhs: str
    expression: str
    exact: str
    unit: str = ""
    verdict: str | None = None
    reason: str | None = None
    complexity: int | None = None
    nats: float = 0.0

    def __str__(self) -> str:
        return f"{self.lhs} = {self.expression}" + (f"  [{self.unit}]" if self.unit else "")


def equation_of(result: Result, equation: Equation) -> DisplayedEquation:
    """Return an equation of a result as people read it."""
    exact = equation.expression or ""
    time = None if result.kind == "regression" else result.time
    return DisplayedEquation(
        equation.variable,
        equation.lhs,
        rounded(exact, result.names),
        exact,
        _unit(equation.variable, equation.lhs, result.units, time),
        equation.verdict,
        equation.reason,
        equation.complexity,
        equation.nats or 0.0,
    )


def _unit(variable: str, lhs: str, units: Mapping[str, str], time: str | None) -> str:
    """Return the unit of a left-hand side, of a regression without `time`; "" where a column has none."""
    above = units.get(variable, "")
    if time is None or "/" not in lhs:
        return above
    below = units.get(time, "")
    if not above or not below:
        return ""
    above, below = (f"({unit})" if _COMPOUND.search(unit) else unit for unit in (above, below))
    return f"{above}/{below}^2" if lhs.startswith("d2") else f"{above}/{below}"


_EXACT_SHARE: Final = 1e-6
"""Standard errors below this share of their constants are those of rounding, and not worth a line."""


@dataclass(frozen=True)
class ConstantWords:
    """A constant as people are shown it: a number, such as ``2.981 ± 0.018``, `notes` on it, and its `unit`.

    `unit` is "1" of a pure number, None where units do not tell.
    """

    number: str
    notes: tuple[str, ...]
    unit: str | None


def plus_minus(value: float, error: float) -> str:
    """Return ``2.981 ± 0.018``, or ``1.21e-07 ± 3.0e-09``: an error in two digits, the value with as many decimals."""
    if not error > 0.0:
        return f"{value:.6g}"
    size = math.floor(math.log10(max(abs(value), error)))
    decimals = 1 - math.floor(math.log10(error))
    if -4 <= size < 6:
        return f"{value:.{max(decimals, 0)}f} ± {error:.{max(decimals, 0)}f}"
    return f"{value:.{max(decimals + size, 0)}e} ± {error:.1e}"


def number_text(value: float | None, digits: int = 3) -> str:
    """Return a number with so many significant digits; ``?`` for None."""
    return "?" if value is None else f"{value:.{digits}g}"


def with_errors(constants: Sequence[Constant]) -> list[Constant]:
    """Return those whose errors are known; where one is infinite, it is null, and nothing is determined."""
    return [each for each in constants if each.std_error is not None or not each.identifiable or each.at_bound]


def constant_words(constants: Sequence[Constant]) -> list[ConstantWords]:
    """Return what is said of the constants of an equation; nothing where no error is known, or all are rounding."""
    known = with_errors(constants)
    return [] if all(map(_is_exact, known)) else [*map(words_of, known)]


def _is_exact(constant: Constant) -> bool:
    is_small = (constant.std_error or 0.0) <= _EXACT_SHARE * abs(constant.value or 0.0)
    return is_small and constant.identifiable and not constant.at_bound


def words_of(constant: Constant) -> ConstantWords:
    """Return what is said of a constant: where it is shown rounded, what was fitted is a note."""
    shown, fitted = number_text(constant.value, 6), fitted_text(constant)
    notes = [] if constant.identifiable else ["not determined"]
    if constant.at_bound:
        notes = ["at its bound", interval_text(constant.interval)]
    elif constant.std_error is not None:
        begins_alike = fitted.startswith(f"{shown} ")
        shown, notes = (fitted, notes) if begins_alike else (shown, [fitted, *notes])
    return ConstantWords(shown, tuple(notes), constant.unit)


def fitted_text(constant: Constant) -> str:
    """Return the fitted value with its standard error."""
    return plus_minus(constant.estimate, constant.std_error or 0.0)


def differing_groups(result: Result) -> tuple[str, ...]:
    """Return the groups of trajectories of a result; none where no constant differs between them."""
    is_different = any(map(_differs, result.equations))
    return tuple(group.group for group in result.groups) if is_different else ()


def _differs(equation: Equation) -> bool:
    """Tell whether an equation has a constant that is not the same in all groups."""
    if equation.constants and all(constant.shared for constant in equation.constants):
        return False  # the mean of equal numbers may have another last bit
    return any(group.expression != equation.expression for group in equation.groups)


def remark_on_groups(result: Result) -> str:
    """Return a line that says of which group the constants in equations are, or of which groups they are means.

    Members of fronts and candidates have constants of all groups together. "" where there are no groups.
    """
    together = ", ".join(equation.lhs for equation in result.equations if equation.is_of_all_groups)
    if result.group is not None:
        others = f"; those of {together} are of all groups together" if together else ""
        return f"Constants are those of group {' '.join(result.group.split())}{others}."
    if together:
        return f"Constants of {together} are of all groups together, which may differ in them."
    names = " ".join(", ".join(differing_groups(result)).split())
    return f"Constants that differ between groups are means over them; the groups are {names}." if names else ""


def of_group(result: Result, group: Group) -> Result:
    """Return a result with the constants and the trajectories of one `group` of its groups alone, named as `group`."""
    taken: dict[str, object] = {"covariance": group.covariance, "groups": (), "group": group.group}
    taken["equations"] = tuple(_of_group(equation, group.group) for equation in result.equations)
    if result.simulation is not None:
        simulated = tuple(part for part in result.simulated if part.name in group.trajectories)
        taken["simulation"] = result.simulation.model_copy(update={"trajectories": simulated})
    if result.data is not None and result.data.trajectories is not None:
        recorded = tuple(part for part in result.recorded if part.name in group.trajectories)
        taken["data"] = result.data.model_copy(update={"trajectories": recorded})
    alone = result.model_copy(update=taken)
    rows = _searched_rows(result)
    if not rows:
        return alone
    share = _searched_rows(alone) / rows
    noise = {state: _with_share(known, share) for state, known in result.noise.items()}
    return alone.model_copy(update={"noise": noise})


def _of_group(equation: Equation, name: str) -> Equation:
    group = next((group for group in equation.groups if group.group == name), None)
    taken: dict[str, object] = {"groups": ()}
    if group is not None:
        taken |= {"expression": group.expression, "program": group.program, "constants": group.constants}
    return equation.model_copy(update=taken)


def _with_share(noise: Noise, share: float) -> Noise:
    """Return noise with as many independent rows as a share of the trajectories has, of those of all."""
    errors = noise.errors
    if errors is None or not errors.independent_rows:
        return noise
    fewer = errors.model_copy(update={"independent_rows": errors.independent_rows * share})
    return noise.model_copy(update={"errors": fewer})


def _searched_rows(result: Result) -> int:
    return sum(part.rows or 0 for part in result.recorded if not part.held_out)


_PRINTED: Final = 5e-4
"""Largest relative error of an end as `outside_sentence` prints it, with four digits: who copies it is not outside."""


def measured_ranges(result: Result) -> dict[str, tuple[float, float]]:
    """Return the lowest and highest value that was measured of states and inputs, by symbol.

    Of the rows that were searched, and of those that were not. Angles have none: they come round again.
    """
    data = DataConfig.model_validate(result.data_settings)
    angles = {result.symbols.get(angle.column, angle.column) for angle in data.angles}
    ranges = dict(result.ranges)
    for part in result.recorded:
        for column, curve in {**part.measured, **part.inputs}.items():
            name, known = result.symbols.get(column, column), [value for value in curve if value is not None]
            if known:
                low, high = ranges.get(name, (math.inf, -math.inf))
                ranges[name] = min(low, *known), max(high, *known)
    return {name: ends for name, ends in ranges.items() if name not in angles}


def names_outside(values: Mapping[str, float], ranges: Mapping[str, tuple[float, float]]) -> tuple[str, ...]:
    """Return the names of values that lie outside of their range; those without a range are in none."""
    outside = []
    for name, value in values.items():
        low, high = ranges.get(name, (value, value))
        if not low - _PRINTED * abs(low) <= value <= high + _PRINTED * abs(high):
            outside.append(name)
    return tuple(outside)


def outside_sentence(values: Mapping[str, float], ranges: Mapping[str, tuple[float, float]]) -> str:
    """Return that an initial state lies outside of the measured ranges, and what follows; "" where it does not."""
    names = names_outside(values, ranges)
    if not names:
        return ""
    each = [f"{name} = {values[name]:.4g} (measured: {ranges[name][0]:.4g} to {ranges[name][1]:.4g})" for name in names]
    return f"the initial state is outside of the measured range: {', '.join(each)}; the model is extrapolated there"
