"""Evaluate a tape of operations over blocks of rows, forward and with gradient. The innermost loops of all programs.

A *tape* holds the live nodes of a program in order: `code` (N,) int64; `left` and `right` (N,) int64, the indices of
earlier nodes (for VARIABLE, `left` is the input's index); `constants` (N,) float64. Rows are processed in blocks of
`LANES`, in vector registers (`atoll_core.expression.kernels.lanes`). The number of rows in arrays is padded to a
multiple of `LANES`.
"""

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from atoll_core.compilation.jit import inlined
from atoll_core.expression.kernels.functions import (
    RIGHT,
    STRICT,
    apply_function,
    functions_address,
    left_partial_code,
    product,
)
from atoll_core.expression.kernels.lanes import LANES, copy, fill, lane_operation, place
from atoll_core.expression.kernels.operator_choice import choose, nothing
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
    Partial,
)

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
Booleans = npt.NDArray[np.bool_]
Int = int | np.int64
"""An integer of Python or numpy; to the compiler both are int64."""

_ZERO: Final = np.int64(0)


def padded(rows: int) -> int:
    """Return `rows` rounded up to a multiple of LANES."""
    return -(-rows // LANES) * LANES


@inlined
def _function_value(op: Int, out: Any, a: Any, b: Any, functions: Int) -> None:
    apply_function(functions, op, out, a, b)


apply_operator: Final = choose(
    {
        op: lane_operation(STRICT[op].value, ignored=1)
        for op in (ADD, SUBTRACT, MULTIPLY, DIVIDE, SQUARE, INVERSE, NEGATE, SQRT, ABS)
    },
    _function_value,
)
"""``(op, out, a, b, functions)``: write the result of operator `op` for the numbers at places `a` and `b` to `out`."""


@inlined
def forward_block(
    count: Int,
    code: Ints,
    left: Ints,
    right: Ints,
    constants: Floats,
    wanted: Booleans,
    inputs: Floats,
    waves: Floats,
    start: Int,
    values: Floats,
    functions: Int,
) -> None:
    """Write the values of the `wanted` nodes at rows [start, start + LANES) into the same columns of `values`.

    Only the first `count` nodes are considered. `inputs` is (V, R) and `values` (>= count, >= R), with R padded.
    `waves` is (2 V, R), sine and cosine of each input, or (0, R) if they are to be computed here. Operators are not
    protected: results that are undefined or too large become NaN or infinity.
    """
    for i in range(count):
        if not wanted[i]:
            continue
        op = code[i]
        out = place(values, i, start)
        if op == VARIABLE:
            copy(out, place(inputs, left[i], start))
            continue
        if op == CONSTANT:
            fill(out, constants[i])
            continue
        if (op == SIN or op == COS) and waves.shape[0] > 0 and code[left[i]] == VARIABLE:
            copy(out, place(waves, 2 * left[left[i]] + (op - SIN), start))
            continue
        apply_operator(op, out, place(values, left[i], start), place(values, right[i], start), functions)


@inlined
def forward(
    count: Int,
    code: Ints,
    left: Ints,
    right: Ints,
    constants: Floats,
    wanted: Booleans,
    inputs: Floats,
    waves: Floats,
    rows: Int,
    values: Floats,
    functions: Int,
) -> None:
    """Write the values of the `wanted` nodes among the first `count` at rows [0, rows), padded, into `values`."""
    for start in range(_ZERO, rows, LANES):
        forward_block(count, code, left, right, constants, wanted, inputs, waves, start, values, functions)


def _pulled(partial: Partial) -> Any:
    """Return the operation on places that adds a partial derivative times `g` to an adjoint, see `_pull_left`."""
    factor, divisor = product(partial.factors) if partial.factors else None, partial.divisor

    def pulled(target: Any, g: Any, a: Any, b: Any, v: Any) -> Any:
        amount = g if factor is None else g * factor(a, b, v)
        amount = amount if divisor is None else amount / divisor(a, b, v)
        return target + amount if partial.sign > 0 else target - amount

    return _pull_by(pulled)


def _pull_by(function: Any) -> Any:
    return lane_operation(function, onto=True, ignored=2)


def _pulled_by_function(sign: int, code: int, *, takes_value: bool = False) -> Any:
    """Return the same operation for a partial derivative with one factor, the block function of this `code`."""
    operation = lane_operation(lambda t, g, s: t + g * s if sign > 0 else t - g * s, onto=True)

    @inlined
    def pull(target: Any, g: Any, a: Any, b: Any, v: Any, scratch: Any, functions: Int) -> None:
        apply_function(functions, code, scratch, a, v if takes_value else b)
        operation(target, g, scratch)

    return pull


_pull_left: Final = choose(
    {op: _pulled(STRICT[op].left)
     for op in (ADD, SUBTRACT, MULTIPLY, DIVIDE, SQUARE, INVERSE, NEGATE, EXP, LOG, SQRT)}
    # g (1 - v v) without the number 1
    | {TANH: _pull_by(lambda t, g, a, b, v: (t + g) - (g * v) * v)}
    | {op: _pulled_by_function(STRICT[op].left.sign, left_partial_code(op)) for op in (SIN, COS, ABS, POW)},
    nothing,
)  # fmt: skip
"""``(op, target, g, a, b, v, scratch, functions)``: add the adjoint `g` times the partial derivative of operator `op`
with respect to its left argument to `target`. All but `op` and `functions` are places: arguments `a` and `b`, value
`v`."""

_pull_right: Final = choose(
    {op: _pulled(STRICT[op].right) for op in (ADD, SUBTRACT, MULTIPLY, DIVIDE)}
    | {POW: _pulled_by_function(STRICT[POW].right.sign, RIGHT + POW, takes_value=True)},
    nothing,
)
"""The same as `_pull_left`, with respect to the right argument."""


@inlined
def reverse_block(
    count: Int,
    code: Ints,
    left: Ints,
    right: Ints,
    depends: Booleans,
    values: Floats,
    start: Int,
    adjoints: Floats,
    functions: Int,
) -> None:
    """Propagate the adjoints of the outputs to every node that `depends` on a fitted constant.

    This is one reverse sweep over the tape (reverse-mode differentiation). On entry `adjoints` (> count, LANES) holds
    d(result)/d(node) for the output nodes, and zero for the other dependent nodes. On return it holds the adjoints of
    all dependent nodes. Its last row is scratch. `values` come from `forward_block` at rows [start, start + LANES).
    """
    scratch = place(adjoints, adjoints.shape[0] - 1, _ZERO)
    for i in range(count - 1, -1, -1):
        op = code[i]
        if op <= CONSTANT or not depends[i]:
            continue
        g = place(adjoints, i, _ZERO)
        value = place(values, i, start)
        a = place(values, left[i], start)
        b = place(values, right[i], start)
        if depends[left[i]]:
            _pull_left(op, place(adjoints, left[i], _ZERO), g, a, b, value, scratch, functions)
        if (op <= DIVIDE or op == POW) and depends[right[i]]:
            _pull_right(op, place(adjoints, right[i], _ZERO), g, a, b, value, scratch, functions)


__all__ = ["LANES", "Booleans", "Floats", "Int", "Ints", "forward", "forward_block", "functions_address", "padded",
           "reverse_block"]  # fmt: skip
