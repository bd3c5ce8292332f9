"""The operators that are functions, and their slopes, over one block of rows: compiled once, called by address.

They are long, and a compiler that works through all callees anew in every caller would spend its minute on them.
"""

from typing import Any, Final

import numpy as np

from atoll.compilation.jit import IS_COMPILED, callback, inlined
from atoll.expression.kernels.elementary import strict_cos, strict_exp, strict_log, strict_pow, strict_sin, strict_tanh
from atoll.expression.kernels.lanes import LANES, get, put
from atoll.expression.operators import COS, EXP, LOG, POW, SIN, TANH

Int = int | np.int64

_LANES: Final = np.int64(LANES)
SIGN: Final = 32
"""-1, 0 or 1: the slope of the absolute value."""

POWER_SLOPE: Final = 33
"""b * a**(b - 1)."""


def _apply(operator: Int, count: Int, out: Any, a: Any, b: Any) -> None:
    """Write function `operator` of `count` numbers at place `a` (and `b`) to place `out`.

    `count` is always LANES, which the compiler must not know: it would write the loops out one number at a time.
    """
    if operator == SIN:
        for k in range(count):
            put(out, k, strict_sin(get(a, k)))
    elif operator == COS:
        for k in range(count):
            put(out, k, strict_cos(get(a, k)))
    elif operator == EXP:
        for k in range(count):
            put(out, k, strict_exp(get(a, k)))
    elif operator == LOG:
        for k in range(count):
            put(out, k, strict_log(get(a, k)))
    elif operator == TANH:
        for k in range(count):
            put(out, k, strict_tanh(get(a, k)))
    elif operator == POW:
        for k in range(count):
            put(out, k, strict_pow(get(a, k), get(b, k)))
    elif operator == SIGN:
        for k in range(count):
            x = get(a, k)
            put(out, k, 1.0 if x > 0.0 else (-1.0 if x < 0.0 else 0.0))
    elif operator == POWER_SLOPE:
        for k in range(count):
            put(out, k, get(b, k) * strict_pow(get(a, k), get(b, k) - 1.0))


if IS_COMPILED:
    from atoll.expression.kernels.lanes import call_at

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
