"""The operators that are functions (sin, exp, ...), and their partial derivatives, over one block of rows.

They are compiled once and called by address. Their code is long, and compiling it again in every caller would take most
of the minute that all kernels take.
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
"""An operator's code plus this number is the code of its partial derivative with respect to the left argument."""
RIGHT: Final = 64
"""An operator's code plus this number is the code of its partial derivative with respect to the right argument. This
function takes the left argument and the operator's value."""


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
"""The operators of the search, with the same bits on every machine."""


_CODES: Final = definitions(
    Functions(
        lambda a: SIN, lambda a: COS, lambda a: EXP, lambda a: LOG, square_root, abs, lambda a: TANH, lambda a, b: POW,
        lambda a: LEFT + ABS, lambda a, v: RIGHT + POW,
    )
)  # fmt: skip


def left_partial_code(code: int) -> int:
    """Return the code of the block function for an operator's partial derivative with respect to the left argument."""
    factors = _CODES[code].left.factors
    return LEFT + code if len(factors) > 1 else int(factors[0](0.0, 0.0, 0.0))


def product(
    factors: Sequence[PartialFactor], compiled: Callable[[PartialFactor], PartialFactor] = lambda part: part
) -> PartialFactor:
    """Return the product of one or two factors of a partial derivative; if there are two, each is `compiled` first."""
    if len(factors) == 1:
        return factors[0]
    first, second = map(compiled, factors)
    return lambda a, b, v: first(a, b, v) * second(a, b, v)


def _value(code: int) -> Any:
    """Return a loop that applies an operator to a block."""
    function = inlined(STRICT[code].value)

    @inlined
    def loop(count: Int, out: Any, a: Any, b: Any) -> None:
        for k in range(count):
            put(out, k, function(get(a, k), get(b, k)))

    return loop


def _left(code: int) -> Any:
    """Return a loop over a block for the partial derivative with respect to the left argument."""
    factor = inlined(product(STRICT[code].left.factors, inlined))

    @inlined
    def loop(count: Int, out: Any, a: Any, b: Any) -> None:
        for k in range(count):
            put(out, k, factor(get(a, k), get(b, k), 0.0))

    return loop


def _right(code: int) -> Any:
    """Return a loop over a block for the partial derivative with respect to the right argument, see `RIGHT`."""
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
    """Write function `operator` of the `count` numbers at place `a` (and `b`) to place `out`.

    `count` is always LANES, but the compiler must not know this. If it does, it unrolls the loops into operations on
    single numbers instead of vectors.
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
        """Interpreted: call the Python function; `address` is ignored."""
        _apply(operator, LANES, out, a, b)


def functions_address() -> int:
    """Return the address of the compiled function in this process; 0 when interpreted."""
    return int(_COMPILED.address) if IS_COMPILED else 0
