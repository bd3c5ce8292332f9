"""The only table of operators: code, arity, text, value and derivatives. All modules that treat operators use it.

No operator is protected: where an expression has no finite value, its program has none. A printed equation is exactly
the equation that was computed.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

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
SIGN: Final = 17
BASE_LOG: Final = 18

TRIGONOMETRIC_LIMIT: Final = 1e5
"""sin(x) and cos(x) are NaN for |x| above this."""


@dataclass(frozen=True)
class Operator:
    """One operator: its `code` in programs, its `name` in options, its number of arguments.

    `text` is its form in expressions: a sign between two arguments, or the name of a function of one argument. It is
    empty if expressions use other operators instead.
    """

    code: int
    name: str
    arity: int
    text: str = ""


OPERATORS: Final = (
    Operator(VARIABLE, "variable", 0),
    Operator(CONSTANT, "constant", 0),
    Operator(ADD, "+", 2, "+"),
    Operator(SUBTRACT, "-", 2, "-"),
    Operator(MULTIPLY, "*", 2, "*"),
    Operator(DIVIDE, "/", 2, "/"),
    Operator(SIN, "sin", 1, "sin"),
    Operator(COS, "cos", 1, "cos"),
    Operator(EXP, "exp", 1, "exp"),
    Operator(LOG, "log", 1, "log"),
    Operator(SQRT, "sqrt", 1, "sqrt"),
    Operator(ABS, "abs", 1, "abs"),
    Operator(TANH, "tanh", 1, "tanh"),
    Operator(POW, "pow", 2, "**"),
    Operator(INVERSE, "inverse", 1),
    Operator(SQUARE, "square", 1),
    Operator(NEGATE, "neg", 1),
)
"""All operators of programs; the index of an operator is its code."""

PARTIAL_OPERATORS: Final = (Operator(SIGN, "sign", 1, "sign"), Operator(BASE_LOG, "base log", 2))
"""Further operators, which occur only in derivatives; their codes follow the codes of `OPERATORS`. The search does not
use them, and messages do not contain them."""

ARITY: Final = tuple(operator.arity for operator in (*OPERATORS, *PARTIAL_OPERATORS))
BY_NAME: Final = {operator.name: operator for operator in OPERATORS if operator.arity > 0}
"""The operators a user can select with ``--operators``."""
FUNCTIONS: Final = {operator.code: operator.text for operator in OPERATORS if operator.arity == 1 and operator.text}
"""By code: the names of operators that are written as a call; our parser, sympy and Python use the same names."""


class Functions(NamedTuple):
    """The functions of some library, of numbers or of arrays; operators are made of them and of + - * /.

    ``sin(x)`` and ``cos(x)`` are NaN where |x| is above `TRIGONOMETRIC_LIMIT`; ``log(0)`` is minus infinity;
    ``power(x, y)`` is defined for x > 0, x = 0 <= y, and x < 0 with integer y, and NaN elsewhere; ``sign(x)`` is -1, 0
    or 1. ``base_log(x, v)`` is log x, but 0 where x and v = x**y are 0. The derivative of x**y with respect to y is v
    times ``base_log(x, v)``; at x = 0 it is 0, since 0**y is 0 for all y > 0.
    """

    sin: Callable[[Any], Any]
    cos: Callable[[Any], Any]
    exp: Callable[[Any], Any]
    log: Callable[[Any], Any]
    sqrt: Callable[[Any], Any]
    magnitude: Callable[[Any], Any]
    tanh: Callable[[Any], Any]
    power: Callable[[Any, Any], Any]
    sign: Callable[[Any], Any]
    base_log: Callable[[Any, Any], Any]


PartialFactor = Callable[[Any, Any, Any], Any]
"""A function (a, b, v) of an operator's arguments a and b and its value v."""


class Partial(NamedTuple):
    """The partial derivative with respect to one argument: ``sign * factors[0] * ... / divisor``; 0 for sign 0."""

    sign: int = 1
    factors: tuple[PartialFactor, ...] = ()
    divisor: PartialFactor | None = None


class Definition(NamedTuple):
    """The value of an operator as a function of two arguments, and its partial derivatives.

    An operator with one argument ignores the second.
    """

    value: Callable[[Any, Any], Any]
    left: Partial
    right: Partial = Partial()


def definitions(functions: Functions) -> dict[int, Definition]:
    """Return the definition of every operator, by code, made of these `functions`.

    Operators are defined only here. The kernels of the search, numpy's evaluation, the trajectory fits and the folding
    of constants differ in the functions that they use, and in the order in which they multiply an adjoint by the parts
    of a partial derivative.
    """
    sin, cos, exp, log, sqrt, magnitude, tanh, power, sign, base_log = functions
    return {
        ADD: Definition(lambda a, b: a + b, Partial(), Partial()),
        SUBTRACT: Definition(lambda a, b: a - b, Partial(), Partial(-1)),
        MULTIPLY: Definition(lambda a, b: a * b, Partial(1, (_b,)), Partial(1, (_a,))),
        DIVIDE: Definition(lambda a, b: a / b, Partial(1, (), _b), Partial(-1, (_v,), _b)),
        SIN: Definition(lambda a, b: sin(a), Partial(1, (lambda a, b, v: cos(a),))),
        COS: Definition(lambda a, b: cos(a), Partial(-1, (lambda a, b, v: sin(a),))),
        EXP: Definition(lambda a, b: exp(a), Partial(1, (_v,))),
        LOG: Definition(lambda a, b: log(a), Partial(1, (), _a)),
        SQRT: Definition(lambda a, b: sqrt(a), Partial(1, (), lambda a, b, v: v + v)),
        ABS: Definition(lambda a, b: magnitude(a), Partial(1, (lambda a, b, v: sign(a),))),
        TANH: Definition(lambda a, b: tanh(a), Partial(1, (lambda a, b, v: 1.0 - v * v,))),
        POW: Definition(
            lambda a, b: power(a, b),
            Partial(1, (_b, lambda a, b, v: power(a, b - 1.0))),
            Partial(1, (_v, lambda a, b, v: base_log(a, v))),
        ),
        INVERSE: Definition(lambda a, b: 1.0 / a, Partial(-1, (_v, _v))),
        SQUARE: Definition(lambda a, b: a * a, Partial(1, (lambda a, b, v: a + a,))),
        NEGATE: Definition(lambda a, b: -a, Partial(-1)),
    }


def partial_definitions(functions: Functions) -> dict[int, Definition]:
    """Return the definitions of `PARTIAL_OPERATORS`; second derivatives need their partial derivatives."""
    return {
        SIGN: Definition(lambda a, b: functions.sign(a), Partial(0)),
        BASE_LOG: Definition(lambda a, b: functions.base_log(a, b), Partial(1, (), _a), Partial(0)),
    }


def _a(a: Any, b: Any, v: Any) -> Any:
    return a


def _b(a: Any, b: Any, v: Any) -> Any:
    return b


def _v(a: Any, b: Any, v: Any) -> Any:
    return v
