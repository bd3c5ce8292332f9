"""The right-hand sides of a result as programs."""

from collections.abc import Sequence

from atoll_coordinator.result.equations import Equation
from atoll_core.expression.program import Program
from atoll_core.expression.text.parsing import from_infix


def program_of(equation: Equation, names: Sequence[str]) -> Program:
    """Return a right-hand side over the variables of these names, as it was computed where that is known."""
    if equation.program:
        return Program.from_bytes(bytes.fromhex(equation.program), len(names))
    return from_infix(equation.expression or "", names)
