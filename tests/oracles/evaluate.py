"""Slow, obvious evaluation of programs at one row: the definition of every operator, by the C library's functions.

NaN rules: nothing is protected. An operator gives what IEEE 754 gives; where the mathematics has no value (log of a
negative number, 0/0, sqrt of a negative number) the value is NaN, and NaN and infinity travel on as IEEE 754 says.
sin and cos beyond |x| > 1e5 are NaN. pow(x, y) has a value for x > 0, for x = 0 <= y, and for x < 0 with a whole y.
"""

import math
from collections.abc import Callable, Sequence

from atoll_core.expression.operators import BY_NAME, CONSTANT, TRIGONOMETRIC_LIMIT, VARIABLE
from atoll_core.expression.program import Program

NAN = math.nan


def evaluate(program: Program, row: Sequence[float]) -> float:
    """Return the value of `program` where the input variables have the values `row`."""
    values: list[float] = []
    for index in range(len(program)):
        code = int(program.operators[index])
        left, right = int(program.left[index]), int(program.right[index])
        if code == VARIABLE:
            values.append(float(row[left]))
        elif code == CONSTANT:
            values.append(float(program.constants[index]))
        else:
            values.append(apply(code, values[left], values[right]))
    return values[-1]


def apply(code: int, a: float, b: float) -> float:
    """Return the value of the operator `code`; `b` is ignored when it has one operand."""
    return _DEFINITIONS[code](a, b)


def _divide(a: float, b: float) -> float:
    if b != 0.0:
        return a / b
    if a == 0.0 or math.isnan(a) or math.isnan(b):
        return NAN
    return math.copysign(math.inf, a) * math.copysign(1.0, b)


def _trigonometric(function: Callable[[float], float]) -> Callable[[float, float], float]:
    return lambda a, _: function(a) if abs(a) <= TRIGONOMETRIC_LIMIT else NAN


def _exp(a: float, _: float) -> float:
    try:
        return math.exp(a)
    except OverflowError:
        return math.inf


def _log(a: float, _: float) -> float:
    if a == 0.0:
        return -math.inf
    return math.log(a) if a > 0.0 else NAN


def _sqrt(a: float, _: float) -> float:
    return math.sqrt(a) if a >= 0.0 else NAN


def _pow(a: float, b: float) -> float:
    if math.isnan(a) or math.isnan(b):
        return NAN
    if a > 0.0 or (a == 0.0 and b >= 0.0) or (a < 0.0 and (math.isinf(b) or b % 1.0 == 0.0)):
        try:
            return math.pow(a, b)
        except OverflowError:
            return -math.inf if a < 0.0 and b % 2.0 == 1.0 else math.inf
    return NAN


def _multiply(a: float, b: float) -> float:
    return a * b


_BY_NAME: dict[str, Callable[[float, float], float]] = {
    "+": lambda a, b: a + b,
    "-": lambda a, b: a - b,
    "*": _multiply,
    "/": _divide,
    "sin": _trigonometric(math.sin),
    "cos": _trigonometric(math.cos),
    "exp": _exp,
    "log": _log,
    "sqrt": _sqrt,
    "abs": lambda a, _: abs(a),
    "tanh": lambda a, _: math.tanh(a),
    "pow": _pow,
    "inverse": lambda a, _: _divide(1.0, a),
    "square": lambda a, _: a * a,
    "neg": lambda a, _: -a,
}
_DEFINITIONS = {BY_NAME[name].code: definition for name, definition in _BY_NAME.items()}
