"""The derivative of a program by its constants: from the definition, as a difference quotient in 60 digits."""

from collections.abc import Callable, Sequence
from typing import Any

import mpmath

from atoll_core.expression.operators import (
    ABS,
    ADD,
    CONSTANT,
    COS,
    DIVIDE,
    EXP,
    INVERSE,
    LOG,
    MULTIPLY,
    NEGATE,
    POW,
    SIN,
    SQRT,
    SQUARE,
    SUBTRACT,
    TANH,
    VARIABLE,
)
from atoll_core.expression.program import Program

DIGITS = 60
STEP = mpmath.mpf(10) ** -25

EXACT: dict[int, Callable[[Any, Any], Any]] = {
    ADD: lambda a, b: a + b,
    SUBTRACT: lambda a, b: a - b,
    MULTIPLY: lambda a, b: a * b,
    DIVIDE: lambda a, b: a / b,
    SIN: lambda a, _: mpmath.sin(a),
    COS: lambda a, _: mpmath.cos(a),
    EXP: lambda a, _: mpmath.exp(a),
    LOG: lambda a, _: mpmath.log(a),
    SQRT: lambda a, _: mpmath.sqrt(a),
    ABS: lambda a, _: abs(a),
    TANH: lambda a, _: mpmath.tanh(a),
    POW: lambda a, b: mpmath.power(a, b),
    INVERSE: lambda a, _: 1 / a,
    SQUARE: lambda a, _: a * a,
    NEGATE: lambda a, _: -a,
}


def exact_values(program: Program, row: Sequence[float], moved: int = -1, by: Any = 0) -> list[Any]:
    """Return the value of every node at `row` in 60 digits, the constant at node `moved` changed by `by`."""
    values: list[Any] = []
    for node, code in enumerate(program.operators.tolist()):
        if code == VARIABLE:
            values.append(mpmath.mpf(row[program.left[node]]))
        elif code == CONSTANT:
            values.append(mpmath.mpf(float(program.constants[node])) + (by if node == moved else 0))
        else:
            values.append(EXACT[code](values[program.left[node]], values[program.right[node]]))
    return values


def derivative(program: Program, row: Sequence[float], constant: int) -> float:
    """Return d(output)/d(constant at that node) at `row`."""
    with mpmath.workdps(DIGITS):
        above, below = (exact_values(program, row, constant, step)[-1] for step in (STEP, -STEP))
        return float((above - below) / (2 * STEP))
