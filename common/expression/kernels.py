"""Evaluate a tape of operations over blocks of rows, forward and with gradient. The innermost loops of everything.

A *tape* is a program's live nodes in order: `code` (N,) int64, `left`, `right` (N,) int64 indices of earlier nodes (for
VARIABLE, `left` is the input's index), `constants` (N,) float64. Rows are handled `LANES` at a time, a constant that
LLVM knows, so that every inner loop becomes a few vector instructions; arrays of rows are padded to a multiple of it.
Sums run over the lanes of a block by a fixed tree and over blocks in order, so that they have the same bits everywhere.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from common.expression.kernels_elementary import strict_cos, strict_exp, strict_log, strict_pow, strict_sin, strict_tanh
from common.expression.operators import (
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
from common.jit import inlined, kernel

LANES: Final = 16
"""Rows in a block."""

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
Booleans = npt.NDArray[np.bool_]
Int = int | np.int64
"""A whole number of whatever origin; to the compiler both are int64."""


def padded(rows: int) -> int:
    """Return `rows` rounded up to a multiple of LANES."""
    return -(-rows // LANES) * LANES


@kernel
def forward_block(
    count: Int, code: Ints, left: Ints, right: Ints, constants: Floats, inputs: Floats, start: Int, values: Floats
) -> None:
    """Write the value of each of `count` nodes at rows [start, start + LANES) into those columns of `values`.

    `inputs` is (V, R) and `values` (>= count, >= R), R padded. Operators are not protected: what has no finite value
    becomes NaN or infinity.
    """
    for i in range(count):
        op = code[i]
        if op == VARIABLE:
            _load_into(values, i, inputs, left[i], start)
        elif op == CONSTANT:
            _fill_into(values, i, constants[i], start)
        elif op <= DIVIDE:
            _arithmetic_into(values, i, op, left[i], right[i], start)
        else:
            _function_into(values, i, op, left[i], right[i], start)


# The helpers take whole arrays and indices rather than rows: a row handed to another function would be counted as a
# reference, by an atomic instruction, at every node.


@kernel
def _load_into(values: Floats, i: int, inputs: Floats, variable: int, start: Int) -> None:
    out = values[i, start : start + LANES]
    column = inputs[variable, start : start + LANES]
    for k in range(LANES):
        out[k] = column[k]


@kernel
def _fill_into(values: Floats, i: int, constant: float, start: Int) -> None:
    out = values[i, start : start + LANES]
    for k in range(LANES):
        out[k] = constant


@kernel
def _arithmetic_into(values: Floats, i: int, op: int, left: int, right: int, start: Int) -> None:
    """Write node i = left op right for + - * /."""
    out = values[i, start : start + LANES]
    a = values[left, start : start + LANES]
    b = values[right, start : start + LANES]
    if op == ADD:
        for k in range(LANES):
            out[k] = a[k] + b[k]
    elif op == SUBTRACT:
        for k in range(LANES):
            out[k] = a[k] - b[k]
    elif op == MULTIPLY:
        for k in range(LANES):
            out[k] = a[k] * b[k]
    else:
        for k in range(LANES):
            out[k] = a[k] / b[k]


@kernel
def _function_into(values: Floats, i: int, op: int, left: int, right: int, start: Int) -> None:
    """Write node i for the operators that are functions."""
    out = values[i, start : start + LANES]
    a = values[left, start : start + LANES]
    if op == SIN:
        for k in range(LANES):
            out[k] = strict_sin(a[k])
    elif op == COS:
        for k in range(LANES):
            out[k] = strict_cos(a[k])
    elif op == SQUARE:
        for k in range(LANES):
            out[k] = a[k] * a[k]
    elif op == INVERSE:
        for k in range(LANES):
            out[k] = 1.0 / a[k]
    elif op == NEGATE:
        for k in range(LANES):
            out[k] = -a[k]
    elif op == EXP:
        for k in range(LANES):
            out[k] = strict_exp(a[k])
    elif op == LOG:
        for k in range(LANES):
            out[k] = strict_log(a[k])
    elif op == SQRT:
        for k in range(LANES):
            out[k] = np.sqrt(a[k])
    elif op == ABS:
        for k in range(LANES):
            out[k] = abs(a[k])
    elif op == TANH:
        for k in range(LANES):
            out[k] = strict_tanh(a[k])
    elif op == POW:
        b = values[right, start : start + LANES]
        for k in range(LANES):
            out[k] = strict_pow(a[k], b[k])


@kernel
def reverse_block(
    count: int, code: Ints, left: Ints, right: Ints, depends: Booleans, values: Floats, start: int, adjoints: Floats
) -> None:
    """Carry the adjoints of the outputs down to every node that `depends` on a fitted constant.

    `adjoints` (>= count, LANES) holds d(result)/d(node) for the nodes that are outputs and zero for the others that
    depend; on return it is complete. `values` are those of `forward_block` at rows [start, start + LANES). One reverse
    sweep over the list (reverse-mode differentiation).
    """
    for i in range(count - 1, -1, -1):
        op = code[i]
        if op <= CONSTANT or not depends[i]:
            continue
        a = left[i]
        b = right[i]
        if op <= DIVIDE:
            if depends[a]:
                _add_left_adjoint(adjoints, values, start, i, op, a, b)
            if depends[b]:
                _add_right_adjoint(adjoints, values, start, i, op, a, b)
        else:
            if depends[a]:
                _add_function_adjoint(adjoints, values, start, i, op, a, b)
            if op == POW and depends[b]:
                _add_exponent_adjoint(adjoints, values, start, i, a, b)


@kernel
def _add_left_adjoint(adjoints: Floats, values: Floats, start: int, i: int, op: int, left: int, right: int) -> None:
    """Add to the adjoint of the left argument of + - * /."""
    target = adjoints[left]
    g = adjoints[i]
    b = values[right, start : start + LANES]
    if op == MULTIPLY:
        for k in range(LANES):
            target[k] += g[k] * b[k]
    elif op == DIVIDE:
        for k in range(LANES):
            target[k] += g[k] / b[k]
    else:
        for k in range(LANES):
            target[k] += g[k]


@kernel
def _add_right_adjoint(adjoints: Floats, values: Floats, start: int, i: int, op: int, left: int, right: int) -> None:
    """Add to the adjoint of the right argument of + - * /."""
    target = adjoints[right]
    g = adjoints[i]
    if op == ADD:
        for k in range(LANES):
            target[k] += g[k]
    elif op == SUBTRACT:
        for k in range(LANES):
            target[k] -= g[k]
    elif op == MULTIPLY:
        a = values[left, start : start + LANES]
        for k in range(LANES):
            target[k] += g[k] * a[k]
    else:
        value = values[i, start : start + LANES]
        b = values[right, start : start + LANES]
        for k in range(LANES):
            target[k] -= g[k] * value[k] / b[k]


@kernel
def _add_function_adjoint(adjoints: Floats, values: Floats, start: int, i: int, op: int, left: int, right: int) -> None:
    """Add to the adjoint of the argument of a function, or of the base of pow."""
    target = adjoints[left]
    g = adjoints[i]
    value = values[i, start : start + LANES]
    a = values[left, start : start + LANES]
    if op == SIN:
        for k in range(LANES):
            target[k] += g[k] * strict_cos(a[k])
    elif op == COS:
        for k in range(LANES):
            target[k] -= g[k] * strict_sin(a[k])
    elif op == SQUARE:
        for k in range(LANES):
            target[k] += g[k] * (2.0 * a[k])
    elif op == INVERSE:
        for k in range(LANES):
            target[k] -= g[k] * (value[k] * value[k])
    elif op == NEGATE:
        for k in range(LANES):
            target[k] -= g[k]
    elif op == EXP:
        for k in range(LANES):
            target[k] += g[k] * value[k]
    elif op == LOG:
        for k in range(LANES):
            target[k] += g[k] / a[k]
    elif op == SQRT:
        for k in range(LANES):
            target[k] += g[k] / (2.0 * value[k])
    elif op == ABS:
        for k in range(LANES):
            target[k] += g[k] if a[k] > 0.0 else (-g[k] if a[k] < 0.0 else 0.0)
    elif op == TANH:
        for k in range(LANES):
            target[k] += g[k] * (1.0 - value[k] * value[k])
    elif op == POW:
        b = values[right, start : start + LANES]
        for k in range(LANES):
            target[k] += g[k] * (b[k] * strict_pow(a[k], b[k] - 1.0))


@kernel
def _add_exponent_adjoint(adjoints: Floats, values: Floats, start: int, i: int, left: int, right: int) -> None:
    """Add to the adjoint of pow's exponent: value * log(base); NaN for a base that is not positive, as it must be."""
    target = adjoints[right]
    g = adjoints[i]
    value = values[i, start : start + LANES]
    a = values[left, start : start + LANES]
    for k in range(LANES):
        target[k] += g[k] * (value[k] * strict_log(a[k]))


@inlined
def lane_sum(lanes: Floats) -> float:
    """Return the sum of the LANES = 16 numbers in `lanes` by a fixed tree; `lanes` is overwritten."""
    for k in range(8):
        lanes[k] += lanes[k + 8]
    for k in range(4):
        lanes[k] += lanes[k + 4]
    return (lanes[0] + lanes[2]) + (lanes[1] + lanes[3])


@kernel
def forward(
    count: int, code: Ints, left: Ints, right: Ints, constants: Floats, inputs: Floats, rows: int, values: Floats
) -> None:
    """Write the value of each of `count` nodes at rows [0, rows), padded, into `values`."""
    for start in range(0, rows, LANES):
        forward_block(count, code, left, right, constants, inputs, start, values)
