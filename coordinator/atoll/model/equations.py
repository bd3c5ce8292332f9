"""Equations and constants of a result for display, its groups of trajectories, and its measured ranges.

The text of an equation contains numbers, and the result lists fitted constants. This module matches both by value. The
names c1, c2, … count the numbers of all texts, in order. A number without a fitted constant has no error, such as the 2
in 2*x, which stands for x + x.

In a side that the user gave with ``--equation``, parameters keep their names, and numbers of the user's text have no
name, since they are not fitted. Only constants of its unknown parts are counted, each once, even if they occur in
several sides.
"""

import itertools
import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

from atoll.model.given_sides import GivenSides, program_of
from atoll_coordinator.result.base import Pair
from atoll_coordinator.result.equations import Constant, Equation, GivenSide, GroupEquation, Observation, RunValue
from atoll_coordinator.result.findings import Group, Noise
from atoll_coordinator.result.result import Result
from atoll_core.config import DataConfig
from atoll_core.expression.program import constant_places
from atoll_core.expression.template import ConstantSource
from atoll_core.expression.text.infix import to_infix
from atoll_core.expression.text.parsing import from_infix

LEVEL: Final = 0.95
"""The level of the intervals in a result."""

DIGITS: Final = 6
"""Significant digits of the displayed constants."""

_COMPOUND: Final = re.compile(r"[\s*/^.·⋅×⁻¹²³]|\d")
"""Characters that occur only in units with several factors or a power."""

_EXACT_SHARE: Final = 1e-6
"""Standard errors below this share of their constants are rounding errors and not displayed."""

_PRINTED_ROUNDING: Final = 5e-4
"""Relative rounding error of the ends of a range that `outside_sentence` prints. A value copied from such a sentence
does not count as outside."""


# ---------------------------------------------------------------------------------------------------------- equations


class DisplayedEquation(Equation):
    """An equation of a result for display: `expression` has rounded constants, `exact` has constants with all digits.

    `unit` is the unit of the left-hand side, "" if it is not known.
    """

    expression: str = ""
    exact: str = ""
    unit: str = ""
    nats: float = 0.0

    def __str__(self) -> str:
        if self.runs:
            return f"{self.variable} = {', '.join(f'{one.estimate:.6g}' for one in self.runs)} by run"
        return f"{self.lhs} = {self.expression}" + (f"  [{self.unit}]" if self.unit else "")


def displayed_equation(result: Result, equation: Equation) -> DisplayedEquation:
    """Return an equation of a result for display."""
    exact = equation.expression or ""
    above, below = result.units.get(equation.variable, ""), result.units.get(result.time, "")
    unit = above
    if result.kind != "regression" and "/" in equation.lhs:
        both = (f"({name})" if _COMPOUND.search(name) else name for name in (above, below))
        unit = "/".join(both) + ("^2" if equation.lhs.startswith("d2") else "") if above and below else ""
    texts = {"expression": side_text(equation, result.names), "exact": exact, "unit": unit}
    displayed = {**texts, "nats": equation.nats or 0.0}
    return DisplayedEquation.model_construct(**(dict(equation) | displayed))


def rounded(expression: str, names: Sequence[str], *, is_given: bool = False) -> str:
    """Return an expression over these names with its constants rounded to `DIGITS`.

    It is written in the shortest form; if the user gave it, its form stays the same.
    """
    return to_infix(from_infix(expression, names), names, digits=DIGITS, is_given=is_given)


def side_text(
    equation: Equation | GroupEquation | Observation, names: Sequence[str], *, is_given: bool | None = None
) -> str:
    """Return a right-hand side with rounded constants; `is_given` None: as the equation says."""
    given = not isinstance(equation, GroupEquation) and equation.given is not None if is_given is None else is_given
    return rounded(equation.expression or "", names, is_given=given)


def observation_text(one: Observation, names: Sequence[str]) -> str:
    """Return a measured column that is computed from states, such as ``y = c/2.08  (observed: c/V)``."""
    text = f"{one.column} = {side_text(one, names)}"
    return f"{text}  (observed: {one.given.text})"


# ---------------------------------------------------------------------------------------------------------- constants


@dataclass(frozen=True)
class Parameter:
    """A constant of a model.

    `name` is c1, c2, …, counted over all equations. `variable` is the state of its equation. `stderr` is its standard
    error and `interval` the 95 % interval, None if they are not known. `identifiable`: the data determine its value.
    `unit` is "1" for a pure number, None if it is not known. `bounds` were set by the user; an open side is None.
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
        """Return the confidence interval at `level` (0 to 1) from Student's t with `freedom` degrees of freedom.

        `freedom` None stands for infinitely many. The interval is None if it is not known. For a constant at its bound
        only the 95 % interval is known.
        """
        if level == LEVEL:
            return self.interval
        if self.stderr is None or self.interval is None:
            return None
        middle, half = 0.5 * (self.interval[0] + self.interval[1]), quantile(level, freedom) * self.stderr
        return middle - half, middle + half


def quantile(level: float, freedom: float | None) -> float:
    """Return half the width of an interval at `level` in standard errors; see `Parameter.interval_at`."""
    from scipy import special

    below = 0.5 + level / 2.0
    return float(special.ndtri(below) if freedom is None else special.stdtrit(freedom, below))


def parameters_of(result: Result) -> dict[str, Parameter]:
    """Return the constants of all equations by name, in the order of the parameters of a `VectorField`.

    Parameters that only occur in observed columns, and then values by run, such as ``l[run 2]``, come last.

    A constant that differs between groups of trajectories has a value for each: ``c1[strain 2]``.
    """
    label = result.data_settings.get("group") or "trajectory"
    parameters: dict[str, Parameter] = {}
    numbers = numbers_of(result)
    for equation in result.equations:
        if equation.runs:
            continue
        is_given = equation.given is not None
        by_group = [
            (f"[{label} {group.group}]", _numbers_in(group, result.names, is_given=is_given))
            for group in equation.groups
        ]
        for place, (name, value, constant) in enumerate(numbers[equation.variable]):
            values = [("", value, constant)]
            if by_group and (constant is None or constant.shared is False):
                values = [(suffix, *listed[place]) for suffix, listed in by_group]
            for suffix, number, known in values if name else ():
                parameter = _parameter(f"{name}{suffix}", equation.variable, number, known)
                parameters.setdefault(parameter.name, parameter)
    for one in result.observations:
        for name, place in one.given.parameters.items():
            known = one.constants[place]
            parameters.setdefault(name, _parameter(name, one.column, known.value or 0.0, known))
    for equation in result.equations:
        for name, of_run in zip(run_names(equation), equation.runs, strict=True):
            parameters[name] = _parameter(name, equation.variable, of_run.estimate, of_run)
    return parameters


def constant_names(result: Result) -> dict[str, list[str]]:
    """Return for each equation the names of its `constants`, as in `parameters_of`.

    A constant that does not occur in the text has its value as name.
    """
    names: dict[str, list[str]] = {}
    for variable, numbers in numbers_of(result).items():
        equation = next(equation for equation in result.equations if equation.variable == variable)
        places = {id(number.constant): number.name for number in numbers}
        names[variable] = [
            places.get(id(constant)) or f"{constant.value or 0.0:.6g}" for constant in equation.constants
        ]
    return names


def run_names(equation: Equation) -> list[str]:
    """Return the names of the values of a parameter that differs by run: ``l[run 2]``."""
    return [f"{equation.variable}[run {one.run}]" for one in equation.runs]


class EquationNumber(NamedTuple):
    """A number of an equation: its `name` ("": it has none), its `value`, and its fitted `constant`, if there is
    one."""

    name: str
    value: float
    constant: Constant | None


def numbers_of(result: Result) -> dict[str, list[EquationNumber]]:
    """Return the numbers of each equation by variable: of its text or, for a given side, of its program in node
    order."""
    sides = GivenSides.of(result)
    names = _Names({one.name for one in sides.template.parameters})
    numbers: dict[str, list[EquationNumber]] = {}
    for index, equation in enumerate(result.equations):
        is_given = equation.given is not None
        values = _numbers_in(equation, result.names, is_given=is_given)
        if is_given:
            called = [names.of(source, sides) for source in sides.composition.sources(index)]
        else:
            called = [names.next() for _ in values]
        numbers[equation.variable] = [EquationNumber(name, *pair) for name, pair in zip(called, values, strict=True)]
    return numbers


class _Names:
    """The names c1, c2, … without the `taken` names; constants of the same unknown part have the same names."""

    def __init__(self, taken: Collection[str]) -> None:
        self._free = (name for name in map("c{}".format, itertools.count(1)) if name not in taken)
        self._known: dict[ConstantSource, str] = {}

    def next(self) -> str:
        return next(self._free)

    def of(self, source: ConstantSource, sides: GivenSides) -> str:
        if source.parameter is not None:
            return sides.template.parameters[source.parameter].name
        if source.home is None:
            return ""
        if source not in self._known:
            self._known[source] = self.next()
        return self._known[source]


def _numbers_in(
    equation: Equation | GroupEquation, names: Sequence[str], *, is_given: bool
) -> list[tuple[float, Constant | None]]:
    """Return the numbers in the text of an equation, each with its fitted constant, if there is one.

    If the side `is_given`, they are the constants of its program.
    """
    if equation.expression is None:
        return []
    if is_given:
        return [(constant.value or 0.0, constant) for constant in equation.constants]
    program = from_infix(equation.expression, names)
    values = program.constants[constant_places(program)].tolist()
    known = [math.nan if constant.value is None else constant.value for constant in equation.constants]
    by_place = dict(zip(match_constants(known, values), equation.constants, strict=True))
    return [(value, by_place.get(place)) for place, value in enumerate(values)]


def match_constants(constants: Sequence[float], numbers: Sequence[float]) -> list[int | None]:
    """Return for each constant the index of a number of the same absolute value, or None; each number is used once."""
    left = list(range(len(constants)))
    places: list[int | None] = [None] * len(constants)
    for place, number in enumerate(numbers):
        found = next((index for index in left if abs(constants[index]) == abs(number)), None)
        if found is not None:
            places[found] = place
            left.remove(found)
    return places


def _parameter(name: str, variable: str, value: float, constant: Constant | None) -> Parameter:
    """Return a constant with its errors; the sign of `value` in the text may differ from the sign of the constant."""
    if constant is None:
        return Parameter(name, variable, value)
    has_other_sign = value * (constant.value or 0.0) < 0.0

    def with_sign(pair: Pair | None) -> Pair | None:
        if pair is None or not has_other_sign:
            return pair
        low, high = pair
        return None if high is None else 0.0 - high, None if low is None else 0.0 - low

    low, high = with_sign(constant.interval) or (None, None)
    interval = None if low is None or high is None else (low, high)
    bounds = with_sign(constant.bounds)
    return Parameter(name, variable, value, constant.std_error, interval, constant.identifiable, constant.unit, bounds)


# ------------------------------------------------------------------------------------------------- numbers as texts


@dataclass(frozen=True)
class ConstantWords:
    """A displayed constant: a number, such as ``2.981 ± 0.018``, `notes` about it, and its `unit`.

    `unit` is "1" for a pure number, None if it is not known.
    """

    number: str
    notes: tuple[str, ...]
    unit: str | None


def constant_words(constants: Sequence[Constant]) -> list[ConstantWords]:
    """Return the displayed constants of an equation; empty if no error is known or all errors are rounding errors."""
    known = with_errors(constants)
    return [] if all(map(_is_rounding, known)) else [*map(words_of, known)]


def _is_rounding(constant: Constant) -> bool:
    """Tell whether the standard error of a constant is only a rounding error, or not known."""
    is_small = (constant.std_error or 0.0) <= _EXACT_SHARE * abs(constant.value or 0.0)
    return is_small and constant.identifiable and not constant.at_bound


def with_errors(constants: Sequence[Constant]) -> list[Constant]:
    """Return the constants with an error, also those that are not identifiable (infinite error) or at a bound."""
    return [each for each in constants if each.std_error is not None or not each.identifiable or each.at_bound]


@dataclass(frozen=True)
class GivenWords:
    """A side that the user gave, for display: its `text`, and the values of its `parameters` and `unknowns` by name.

    `constants` are the constants of its unknown parts. For a side that was found, these are all constants, and the
    `text` is "".
    """

    text: str
    parameters: dict[str, ConstantWords]
    unknowns: dict[str, str]
    constants: tuple[Constant, ...]


def given_words(equation: Equation | Observation, names: Sequence[str]) -> GivenWords:
    """Return the side of an equation, or of an observed column, for display."""
    given, constants = equation.given, equation.constants
    if given is None:
        return GivenWords("", {}, {}, constants)
    places = given.parameters
    rest = (constant for place, constant in enumerate(constants) if place not in places.values())
    return GivenWords(
        given.text,
        {name: _words_of_parameter(constants[place]) for name, place in places.items()},
        {part.label: rounded(part.expression, names, is_given=True) for part in given.unknowns},
        tuple(rest),
    )


def _words_of_parameter(constant: Constant) -> ConstantWords:
    if _is_rounding(constant):
        return ConstantWords(number_text(constant.value, 6), (), constant.unit)
    return words_of(constant)


def words_of(constant: Constant) -> ConstantWords:
    """Return a constant for display. If the equation has another value than the fit, the fitted value is a note."""
    displayed, fitted = number_text(constant.value, 6), fitted_text(constant)
    notes = [] if constant.identifiable else ["not determined"]
    if constant.at_bound:
        notes = ["at its bound", interval_text(constant.interval)]
    elif constant.std_error is not None:
        begins_alike = fitted.startswith(f"{displayed} ")
        displayed, notes = (fitted, notes) if begins_alike else (displayed, [fitted, *notes])
    return ConstantWords(displayed, tuple(notes), constant.unit)


def words_of_run(one: RunValue) -> ConstantWords:
    """Return the value of a parameter in one run, for display; its error determines the digits."""
    words = _words_of_parameter(one.replaced(value=one.estimate))
    if not one.identifiable:
        return replace(words, notes=("not determined",))
    return words if one.at_bound or _is_rounding(one) else replace(words, number=fitted_text(one), notes=())


def fitted_text(constant: Constant) -> str:
    """Return the fitted value with its standard error."""
    return plus_minus(constant.estimate, constant.std_error or 0.0)


def plus_minus(value: float, error: float) -> str:
    """Return ``2.981 ± 0.018`` or ``1.21e-07 ± 3.0e-09``: the error has two digits, the value the same decimals."""
    if not error > 0.0:
        return f"{value:.6g}"
    size = math.floor(math.log10(max(abs(value), error)))
    decimals = 1 - math.floor(math.log10(error))
    if -4 <= size < 6:
        return f"{value:.{max(decimals, 0)}f} ± {error:.{max(decimals, 0)}f}"
    return f"{value:.{max(decimals + size, 0)}e} ± {error:.1e}"


def number_text(value: float | None, digits: int = 3) -> str:
    """Return a number with `digits` significant digits; ``?`` for None."""
    return "?" if value is None else f"{value:.{digits}g}"


def r2_text(value: float | None) -> str:
    """Return R2 in four decimals, never rounded up to 1; ``-`` for None."""
    if value is None:
        return "-"
    return "1" if value == 1.0 else f"{math.floor(value * 1e4) / 1e4:.4f}" if value > -10.0 else f"{value:.2g}"


def unit_text(unit: str | None) -> str:
    """Return a unit as printed after a number; "" for a pure number or an unknown unit."""
    return f" {unit}" if unit not in (None, "1") else ""


def interval_text(bounds: Sequence[float | None] | None) -> str:
    """Return ``1.99956 to 2.00019``, with enough digits to distinguish the ends; ``-`` if an end is not known."""
    low, high = bounds or (None, None)
    if low is None or high is None:
        return "-"
    spread = high - low
    digits = 6 if spread <= 0.0 else 3 + max(0, math.floor(math.log10(max(abs(low), abs(high)) / spread)))
    return f"{low:.{digits}g} to {high:.{digits}g}"


# ------------------------------------------------------------------------------------------------------------- groups


def differing_groups(result: Result) -> tuple[str, ...]:
    """Return the groups of trajectories of a result; empty if no constant differs between them."""
    for equation in result.equations:
        # the flag is compared and not the values: the mean of equal numbers may differ from them in the last bit
        are_shared = equation.constants and all(constant.shared for constant in equation.constants)
        if not are_shared and any(group.expression != equation.expression for group in equation.groups):
            return tuple(group.group for group in result.groups)
    return ()


def remark_on_groups(result: Result) -> str:
    """Return a line that says to which group the constants belong, or over which groups they are averaged.

    It is "" for a result without groups. Constants of fronts and candidates belong to all groups together.
    """
    together = ", ".join(equation.lhs for equation in result.equations if equation.is_of_all_groups)
    if result.group is not None:
        others = f"; the constants of {together} belong to all groups together" if together else ""
        return f"Constants belong to group {' '.join(result.group.split())}{others}."
    if together:
        return f"Constants of {together} are fitted to all groups together, although groups may differ in them."
    names = " ".join(", ".join(differing_groups(result)).split())
    return f"Constants that differ between groups are means over them; the groups are {names}." if names else ""


def of_group(result: Result, group: Group) -> Result:
    """Return a result with the constants and the trajectories of one of its groups."""
    equations = []
    given = _given_of_group(result, group)
    for equation in result.equations:
        own = next((known for known in equation.groups if known.group == group.group), None)
        update: dict[str, object] = {"groups": ()}
        if own is not None:
            update |= {"expression": own.expression, "program": own.program, "constants": own.constants}
            update |= {"given": given[equation.variable]} if equation.variable in given else {}
        equations.append(equation.model_copy(update=update))
    taken: dict[str, object] = {"covariance": group.covariance, "groups": (), "group": group.group}
    taken["equations"] = tuple(equations)
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


def _given_of_group(result: Result, group: Group) -> dict[str, GivenSide]:
    """Return the given sides by variable; their unknown parts have the constants of the group."""
    sides, names, given = GivenSides.of(result), result.names, {}
    if not sides.template.sides:
        return {}
    own = {
        place: program_of(one, names)
        for place, equation in enumerate(result.equations)
        for one in equation.groups
        if one.group == group.group
    }
    of_group = sides.with_values_of([own.get(place, program) for place, program in enumerate(sides.programs)])
    for place, equation in enumerate(result.equations):
        if equation.given is not None:
            parts = of_group.described_parts(place)
            given[equation.variable] = equation.given.model_copy(update={"unknowns": parts})
    return given


def _with_share(noise: Noise, share: float) -> Noise:
    errors = noise.errors
    if errors is None or not errors.independent_rows:
        return noise
    fewer = errors.model_copy(update={"independent_rows": errors.independent_rows * share})
    return noise.model_copy(update={"errors": fewer})


def _searched_rows(result: Result) -> int:
    return sum(part.rows or 0 for part in result.recorded if not part.held_out)


# ----------------------------------------------------------------------------------------------------- measured ranges


def measured_ranges(result: Result) -> dict[str, tuple[float, float]]:
    """Return the smallest and largest measured value of each state and input, by symbol.

    Angles are left out, because they are periodic.
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


def with_printed_rounding(low: float, high: float) -> tuple[float, float]:
    """Return the ends of a range that contains its own ends when they are printed."""
    return low - _PRINTED_ROUNDING * abs(low), high + _PRINTED_ROUNDING * abs(high)


def outside_sentence(values: Mapping[str, float], ranges: Mapping[str, tuple[float, float]]) -> str:
    """Return a sentence about the `values` outside of their `ranges`; "" if there are none."""
    outside = []
    for name, value in values.items():
        low, high = ranges.get(name, (value, value))
        least, largest = with_printed_rounding(low, high)
        if not least <= value <= largest:
            outside.append(f"{name} = {value:.4g} (measured: {low:.4g} to {high:.4g})")
    if not outside:
        return ""
    return f"the initial state is outside of the measured range: {', '.join(outside)}; the model is extrapolated there"
