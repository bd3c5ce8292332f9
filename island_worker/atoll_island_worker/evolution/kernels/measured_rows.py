"""Rows on which individuals are measured: all rows of the problem, or the rows of a fitness predictor."""

import numpy as np

from atoll_core.compilation.jit import inlined, kernel
from atoll_core.expression.kernels.functions import apply_function
from atoll_core.expression.kernels.lanes import LANES, centre, place, total
from atoll_core.expression.kernels.tape import Int, functions_address
from atoll_core.expression.operators import COS, SIN
from atoll_island_worker.evolution.structures import Floats, Ints, Rows, empty_rows

_ZERO = np.int64(0)


@inlined
def product(one: Floats, i: Int, other: Floats, j: Int, length: Int) -> float:
    """Return the sum of one[i] * other[j] over the rows [0, length); one of them must be 0 in the padding.

    The lanes of a block are summed in a fixed tree, the blocks in order.
    """
    sum_ = 0.0
    for start in range(_ZERO, length, LANES):
        sum_ += total(place(one, i, start), place(other, j, start))
    return sum_


@inlined
def centre_into(out: Floats, i: Int, source: Floats, j: Int, mean: float, rows: Rows) -> None:
    """Write source[j] - `mean` to out[i], and 0 in the padding."""
    for start in range(_ZERO, rows.length, LANES):
        centre(place(out, i, start), place(source, j, start), mean, place(rows.mask, _ZERO, start))


@inlined
def _describe(rows: Rows, functions: Int) -> None:
    """Fill `facts`, `centred` and `waves` of `rows` from its inputs and target."""
    n = rows.length
    mean = product(rows.target, _ZERO, rows.mask, _ZERO, n) / n
    rows.facts[0] = mean
    centre_into(rows.centred, _ZERO, rows.target, _ZERO, 0.0, rows)
    rows.facts[1] = product(rows.centred, _ZERO, rows.centred, _ZERO, n) / n
    centre_into(rows.centred, _ZERO, rows.target, _ZERO, mean, rows)
    for wave in range(rows.waves.shape[0]):
        operator = np.int64(COS) if wave & 1 else np.int64(SIN)
        for start in range(_ZERO, n, LANES):
            argument = place(rows.inputs, wave >> 1, start)
            apply_function(functions, operator, place(rows.waves, wave, start), argument, argument)


@kernel
def gather(rows: Rows, every: Rows, index: Ints, functions: Int) -> None:
    """Fill `rows` with the rows of `every` at the indices `index`; padding repeats the last one."""
    last = index.shape[0] - 1
    for k in range(rows.target.shape[1]):
        r = index[min(k, last)]
        for v in range(rows.inputs.shape[0]):
            rows.inputs[v, k] = every.inputs[v, r]
        rows.target[0, k] = every.target[0, r]
    _describe(rows, functions)


def padded_rows(inputs: Floats, target: Floats, keeps_waves: bool = False) -> Rows:
    """Return `inputs` (V, R) and `target` (R,) as padded rows, with sine and cosine of the inputs if `keeps_waves`."""
    variables, count = inputs.shape
    every = empty_rows(variables, count, 0)
    every.inputs[:, :count] = inputs
    every.target[0, :count] = target
    rows = empty_rows(variables, count, 2 * variables if keeps_waves else 0)
    gather(rows, every, np.arange(count), functions_address())
    return rows
