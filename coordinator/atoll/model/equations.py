"""The equations of a model as people read them."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from atoll_coordinator.result import equations
from atoll_coordinator.result.result import Result
from atoll_core.expression.program import Program
from atoll_core.expression.text.infix import to_infix
from atoll_core.expression.text.parsing import from_infix

DIGITS: Final = 6
"""Significant digits of the constants that people are shown."""

_COMPOUND: Final = re.compile(r"[\s*/^.·⋅×⁻¹²³]|\d")
"""What a unit of several factors or with a power has."""


def program_of(equation: equations.Equation, names: Sequence[str]) -> Program:
    """Return a right-hand side over the variables of these names, as it was computed where that is known."""
    if equation.program:
        return Program.from_bytes(bytes.fromhex(equation.program), len(names))
    return from_infix(equation.expression or "", names)


def rounded(expression: str, names: Sequence[str]) -> str:
    """Return an expression over these names with its constants rounded to `DIGITS`."""
    return to_infix(from_infix(expression, names), names, digits=DIGITS)


@dataclass(frozen=True)
class Equation:
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


def equation_of(result: Result, equation: equations.Equation) -> Equation:
    """Return an equation of a result as people read it."""
    exact = equation.expression or ""
    time = None if result.kind == "regression" else result.time
    return Equation(
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
