"""Evaluate a tape of operations over blocks of rows, forward and with gradient. The innermost loops of everything.

A *tape* is a program's live nodes in order: `code` (N,) int64, `left`, `right` (N,) int64 indices of earlier nodes (for
VARIABLE, `left` is the input's index), `constants` (N,) float64. Rows are handled `LANES` at a time, in vector
registers (`atoll.expression.kernels.lanes`); arrays of rows are padded to a multiple of it.
"""

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from atoll.compilation.jit import inlined
from atoll.expression.kernels.functions import POWER_SLOPE, SIGN, apply_function, functions_address
from atoll.expression.kernels.lanes import (
    LANES,
    add,
    add_product,
    add_quotient,
    copy,
    divide,
    fill,
    invert,
    magnitude,
    multiply,
    negate,
    place,
    root,
    subtract,
    subtract_product,
    subtract_quotient,
)
from atoll.expression.operators import (
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

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
Booleans = npt.NDArray[np.bool_]
Int = int | np.int64
"""A whole number of whatever origin; to the compiler both are int64."""

_ZERO: Final = np.int64(0)


def padded(rows: int) -> int:
    """Return `rows` rounded up to a multiple of LANES."""
    return -(-rows // LANES) * LANES


@inlined
def apply_operator(op: Int, out: Any, a: Any, b: Any, functions: Int) -> None:
    """Write operator `op` of the numbers at places `a` and `b` to place `out`."""
    if op == ADD:
        add(out, a, b)
    elif op == SUBTRACT:
        subtract(out, a, b)
    elif op == MULTIPLY:
        multiply(out, a, b)
    elif op == DIVIDE:
        divide(out, a, b)
    elif op == SQUARE:
        multiply(out, a, a)
    elif op == INVERSE:
        invert(out, a)
    elif op == NEGATE:
        negate(out, a)
    elif op == SQRT:
        root(out, a)
    elif op == ABS:
        magnitude(out, a)
    else:
        apply_function(functions, op, out, a, b)


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
    """Write the value of each `wanted` of `count` nodes at rows [start, start + LANES) into those columns of `values`.

    `inputs` is (V, R) and `values` (>= count, >= R), R padded; `waves` (2 V, R) holds sine and cosine of each input, or
    nothing. Operators are not protected: what has no finite value becomes NaN or infinity.
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
    """Write the value of each `wanted` of `count` nodes at rows [0, rows), padded, into `values`."""
    for start in range(_ZERO, rows, LANES):
        forward_block(count, code, left, right, constants, wanted, inputs, waves, start, values, functions)


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
    """Carry the adjoints of the outputs down to every node that `depends` on a fitted constant.

    `adjoints` (> count, LANES) holds d(result)/d(node) for the nodes that are outputs and zero for the others that
    depend; on return it is complete; its last row is scratch. `values` are those of `forward_block` at rows
    [start, start + LANES). One reverse sweep over the list (reverse-mode differentiation).
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
            target = place(adjoints, left[i], _ZERO)
            if op == ADD or op == SUBTRACT:
                add(target, target, g)
            elif op == MULTIPLY:
                add_product(target, g, b)
            elif op == DIVIDE:
                add_quotient(target, g, b)
            elif op == SIN:
                apply_function(functions, COS, scratch, a, a)
                add_product(target, g, scratch)
            elif op == COS:
                apply_function(functions, SIN, scratch, a, a)
                subtract_product(target, g, scratch)
            elif op == SQUARE:
                add(scratch, a, a)
                add_product(target, g, scratch)
            elif op == INVERSE:
                multiply(scratch, value, value)
                subtract_product(target, g, scratch)
            elif op == NEGATE:
                subtract(target, target, g)
            elif op == EXP:
                add_product(target, g, value)
            elif op == LOG:
                add_quotient(target, g, a)
            elif op == SQRT:
                add(scratch, value, value)
                add_quotient(target, g, scratch)
            elif op == TANH:
                multiply(scratch, g, value)
                add(target, target, g)
                subtract_product(target, scratch, value)
            else:
                apply_function(functions, SIGN if op == ABS else POWER_SLOPE, scratch, a, b)
                add_product(target, g, scratch)
        if (op <= DIVIDE or op == POW) and depends[right[i]]:
            target = place(adjoints, right[i], _ZERO)
            if op == ADD:
                add(target, target, g)
            elif op == SUBTRACT:
                subtract(target, target, g)
            elif op == MULTIPLY:
                add_product(target, g, a)
            elif op == DIVIDE:
                subtract_quotient(target, g, value, b)
            else:  # d(a**b)/db = a**b log(a): NaN for a base that is not positive, as it must be
                apply_function(functions, LOG, scratch, a, a)
                multiply(scratch, scratch, value)
                add_product(target, g, scratch)


__all__ = ["LANES", "Booleans", "Floats", "Int", "Ints", "forward", "forward_block", "functions_address", "padded",
           "reverse_block"]  # fmt: skip
