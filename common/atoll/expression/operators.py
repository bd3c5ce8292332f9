"""The one table of operators: code, arity, text. Kernels and printers are indexed by these codes.

No operator is protected: where the mathematics has no finite value, neither has the program. What is printed is what
was computed.
"""

from dataclasses import dataclass
from typing import Final

VARIABLE: Final = 0
CONSTANT: Final = 1
ADD: Final = 2
SUBTRACT: Final = 3
MULTIPLY: Final = 4
DIVIDE: Final = 5
SIN: Final = 6
COS: Final = 7
EXP: Final = 8
LOG: Final = 9
SQRT: Final = 10
ABS: Final = 11
TANH: Final = 12
POW: Final = 13
INVERSE: Final = 14
SQUARE: Final = 15
NEGATE: Final = 16

TRIGONOMETRIC_LIMIT: Final = 1e5
"""|x| above this in sin or cos counts as not finite (NaN)."""


@dataclass(frozen=True)
class Operator:
    """One operator: its `code` in programs, its `name` in options, its number of arguments."""

    code: int
    name: str
    arity: int


OPERATORS: Final = (
    Operator(VARIABLE, "variable", 0),
    Operator(CONSTANT, "constant", 0),
    Operator(ADD, "+", 2),
    Operator(SUBTRACT, "-", 2),
    Operator(MULTIPLY, "*", 2),
    Operator(DIVIDE, "/", 2),
    Operator(SIN, "sin", 1),
    Operator(COS, "cos", 1),
    Operator(EXP, "exp", 1),
    Operator(LOG, "log", 1),
    Operator(SQRT, "sqrt", 1),
    Operator(ABS, "abs", 1),
    Operator(TANH, "tanh", 1),
    Operator(POW, "pow", 2),
    Operator(INVERSE, "inverse", 1),
    Operator(SQUARE, "square", 1),
    Operator(NEGATE, "neg", 1),
)
"""Indexed by code. pow(x, y): x > 0, or x = 0 <= y, or x < 0 with integer y; elsewhere NaN."""

ARITY: Final = tuple(operator.arity for operator in OPERATORS)
BY_NAME: Final = {operator.name: operator for operator in OPERATORS if operator.arity > 0}
"""The operators a user can select with ``--operators``."""
