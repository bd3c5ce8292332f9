"""The constants of a model by name, with their errors."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from atoll_coordinator.result.base import Pair
from atoll_coordinator.result.equations import Constant, Equation, GroupEquation
from atoll_coordinator.result.result import Result
from atoll_core.expression.program import constant_places
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
