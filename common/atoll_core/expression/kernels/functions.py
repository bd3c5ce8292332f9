"""The operators that are functions, and their partial derivatives, over one block of rows.

They are compiled once and called by address: they are long, and a compiler that works through all callees anew in
every caller would spend its minute on them.
"""

from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np

from atoll_core.compilation.jit import IS_COMPILED, callback, inlined
from atoll_core.expression.kernels.elementary import (
    strict_cos,
    strict_exp,
    strict_log,
    strict_pow,
    strict_sin,
    strict_tanh,
)
from atoll_core.expression.kernels.lanes import LANES, get, put, square_root
from atoll_core.expression.kernels.operator_choice import choose, nothing
from atoll_core.expression.operators import ABS, COS, EXP, LOG, POW, SIN, TANH, Functions, PartialFactor, definitions

Int = int | np.int64

_LANES: Final = np.int64(LANES)
LEFT: Final = 32
"""Added to an operator's code: its partial derivative by the left argument."""
RIGHT: Final = 64
"""Added to an operator's code: its partial derivative by the right argument, whose place the value takes."""


@inlined
def _sign(x: float) -> float:
    return 1.0 if x > 0.0 else (-1.0 if x < 0.0 else 0.0)


@inlined
def _base_log(x: float, v: float) -> float:
    return 0.0 if x == 0.0 and v == 0.0 else strict_log(x)


STRICT: Final = definitions(
    Functions(
        strict_sin, strict_cos, strict_exp, strict_log, square_root, abs, strict_tanh, strict_pow, _sign, _base_log
    )
)
"""The operators of the search: the same bits on every machine."""


_CODES: Final = definitions(
    Functions(
        lambda a: SIN, lambda a: COS, lambda a: EXP, lambda a: LOG, square_root, abs, lambda a: TANH, lambda a, b: POW,
        lambda a: LEFT + ABS, lambda a, v: RIGHT + POW,
    )
)  # fmt: skip


def left_partial_code(code: int) -> int:
    """Return the code of the function of a block that gives an operator's partial derivative by its left argument."""
    factors = _CODES[code].left.factors
    return LEFT + code if len(factors) > 1 else int(factors[0](0.0, 0.0, 0.0))


def product(
    factors: Sequence[PartialFactor], compiled: Callable[[PartialFactor], PartialFactor] = lambda part: part
) -> PartialFactor:
    """Return the product of one or two factors of a partial derivative, each `compiled` if it is called by another."""
    if len(factors) == 1:
        return factors[0]
    first, second = map(compiled, factors)
    return lambda a, b, v: first(a, b, v) * second(a, b, v)


def _value(code: int) -> Any:
    """Return the loop of an operator over a block."""
    function = inlined(STRICT[code].value)

    @inlined
    def loop(count: Int, out: Any, a: Any, b: Any) -> None:
        for k in range(count):
            put(out, k, function(get(a, k), get(b, k)))

    return loop


def _left(code: int) -> Any:
    """Return the loop of its partial derivative by the left argument."""
    factor = inlined(product(STRICT[code].left.factors, inlined))

    @inlined
    def loop(count: Int, out: Any, a: Any, b: Any) -> None:
        for k in range(count):
            put(out, k, factor(get(a, k), get(b, k), 0.0))

    return loop


def _right(code: int) -> Any:
    """Return the loop of its partial derivative by the right argument, see `RIGHT`."""
    factor = inlined(product(STRICT[code].right.factors, inlined))

    @inlined
    def loop(count: Int, out: Any, a: Any, v: Any) -> None:
        for k in range(count):
            put(out, k, factor(get(a, k), 0.0, get(v, k)))

    return loop


_choice: Final = choose(
    {code: _value(code) for code in (SIN, COS, EXP, LOG, TANH, POW)}
    | {LEFT + code: _left(code) for code in (ABS, POW)}
    | {RIGHT + POW: _right(POW)},
    nothing,
)


def _apply(operator: Int, count: Int, out: Any, a: Any, b: Any) -> None:
    """Write function `operator` of `count` numbers at place `a` (and `b`) to place `out`.

    `count` is always LANES, which the compiler must not know: it would write the loops out one number at a time.
    """
    _choice(operator, count, out, a, b)


if IS_COMPILED:
    from atoll_core.expression.kernels.lanes import call_at

    _COMPILED: Final = callback("void(int64, int64, int64, int64, int64)", _apply)

    @inlined
    def apply_function(address: Int, operator: Int, out: Any, a: Any, b: Any) -> None:
        """Write function `operator` of the numbers at place `a` (and `b`) to place `out`."""
        call_at(address, operator, _LANES, out, a, b)
else:

    def apply_function(address: Int, operator: Int, out: Any, a: Any, b: Any) -> None:
        """Interpreted: the function itself; `address` means nothing."""
        _apply(operator, LANES, out, a, b)


def functions_address() -> int:
    """Return where the compiled function lies in this process; 0 when interpreted."""
    return int(_COMPILED.address) if IS_COMPILED else 0
