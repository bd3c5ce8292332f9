"""The rates of a system's states at a point, with their slopes, and inputs between rows.

Letters: N nodes of all equations, D states with an equation, U inputs, Z = D + U numbers of a point, P fitted
constants, R rows.
"""

import math
from typing import Final

from atoll.compilation.jit import inlined
from atoll.data.dataset import FloatArray
from atoll.expression.kernels.tape import Ints
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
    TRIGONOMETRIC_LIMIT,
    VARIABLE,
)

LARGEST_EXPONENT: Final = 709.0
"""exp has no finite value far beyond."""

Table = tuple[FloatArray, FloatArray, FloatArray, float]
"""An embedded Runge-Kutta method whose last stage is the next step's first: coefficients (S, S - 1), or (S, S) where
stages are implicit, times (S,), error weights (S,), and the order of the error estimate."""

Tape = tuple[Ints, Ints, Ints, FloatArray, Ints, Ints]
"""The nodes of all equations one after another: code, left, right (N,) and constants (N,), where arguments are indices
of earlier nodes and a VARIABLE's left is its place in the point z; then the equations' outputs (D,), and the number of
the fitted constant at each node (N,), -1 at all others."""

Path = tuple[FloatArray, FloatArray, FloatArray]
"""Times (R,) of all rows, inputs (U, R) and their slopes (U, R)."""

Scratch = tuple[FloatArray, ...]
"""Room for S stages of a step, Q columns of sensitivities: points (S, Z), rates of the sensitivities (S, D, Q), values
(S, N), adjoints (N,), Jacobian (D, Z), slopes by constants (P,), carried sensitivities (D, Q), rates (S + 1, D)."""

EXHAUSTED: Final = -1
"""Instead of a number of steps left: there were too few."""
BLOWN_UP: Final = -2
"""Instead of a number of steps left: the state left its limits, or no step was small enough."""


@inlined
def rates(tape: Tape, z: FloatArray, values: FloatArray, stage: int, rate: FloatArray) -> None:
    """Write the value of every node at the point `z` (Z,) into `values` (N,), the equations' into ``rate[stage]``."""
    code, left, right, constants, outputs, _ = tape
    for i in range(code.shape[0]):
        op = code[i]
        if op == VARIABLE:
            values[i] = z[left[i]]
            continue
        if op == CONSTANT:
            values[i] = constants[i]
            continue
        a, b = values[left[i]], values[right[i]]
        if op == ADD:
            values[i] = a + b
        elif op == SUBTRACT:
            values[i] = a - b
        elif op == MULTIPLY:
            values[i] = a * b
        elif op == DIVIDE:
            values[i] = a / b
        elif op == SIN:
            values[i] = math.sin(a) if abs(a) <= TRIGONOMETRIC_LIMIT else math.nan
        elif op == COS:
            values[i] = math.cos(a) if abs(a) <= TRIGONOMETRIC_LIMIT else math.nan
        elif op == SQUARE:
            values[i] = a * a
        elif op == INVERSE:
            values[i] = 1.0 / a
        elif op == NEGATE:
            values[i] = -a
        elif op == EXP:
            values[i] = math.exp(a) if a < LARGEST_EXPONENT else math.inf
        elif op == LOG:
            values[i] = math.log(a) if a > 0.0 else math.nan
        elif op == SQRT:
            values[i] = math.sqrt(a) if a >= 0.0 else math.nan
        elif op == ABS:
            values[i] = abs(a)
        elif op == TANH:
            values[i] = math.tanh(a)
        else:
            values[i] = a**b
    for d in range(outputs.shape[0]):
        rate[stage, d] = values[outputs[d]]


@inlined
def slopes(tape: Tape, values: FloatArray, adjoints: FloatArray, jacobian: FloatArray, direct: FloatArray) -> None:
    """Write d rate / d z into `jacobian` (D, Z) and d rate / d constant into `direct` (P,), after `rates`.

    One reverse sweep for each equation, whose nodes lie between the output of the one before and its own.
    """
    code, left, right, _, outputs, parameters = tape
    direct[:] = 0.0
    jacobian[:] = 0.0
    first = 0
    for d in range(outputs.shape[0]):
        last = outputs[d]
        for i in range(first, last):
            adjoints[i] = 0.0
        adjoints[last] = 1.0
        for i in range(last, first - 1, -1):
            g = adjoints[i]
            if g == 0.0:
                continue
            op, p, q = code[i], left[i], right[i]
            if op == VARIABLE:
                jacobian[d, p] += g
                continue
            if op == CONSTANT:
                if parameters[i] >= 0:
                    direct[parameters[i]] += g
                continue
            a, b, v = values[p], values[q], values[i]
            if op == ADD:
                adjoints[p] += g
                adjoints[q] += g
            elif op == SUBTRACT:
                adjoints[p] += g
                adjoints[q] -= g
            elif op == MULTIPLY:
                adjoints[p] += g * b
                adjoints[q] += g * a
            elif op == DIVIDE:
                adjoints[p] += g / b
                adjoints[q] -= g * v / b
            elif op == SIN:
                adjoints[p] += g * math.cos(a)
            elif op == COS:
                adjoints[p] -= g * math.sin(a)
            elif op == SQUARE:
                adjoints[p] += 2.0 * g * a
            elif op == INVERSE:
                adjoints[p] -= g * v * v
            elif op == NEGATE:
                adjoints[p] -= g
            elif op == EXP:
                adjoints[p] += g * v
            elif op == LOG:
                adjoints[p] += g / a
            elif op == SQRT:
                adjoints[p] += 0.5 * g / v
            elif op == ABS:
                adjoints[p] += g if a >= 0.0 else -g
            elif op == TANH:
                adjoints[p] += g * (1.0 - v * v)
            elif op == POW:
                adjoints[p] += g * b * a ** (b - 1.0)
                if a > 0.0:
                    adjoints[q] += g * v * math.log(a)
        first = last + 1


@inlined
def put_inputs(z: FloatArray, states: int, path: Path, row: int, at: float, width: float) -> None:
    """Write the inputs at `at` in [0, 1] between `row` and the next, `width` apart, behind the states in `z`."""
    _, inputs, input_slopes = path
    for u in range(inputs.shape[0]):
        p, q = inputs[u, row], inputs[u, row + 1]
        m, n = input_slopes[u, row] * width, input_slopes[u, row + 1] * width
        c2, c3 = 3.0 * (q - p) - 2.0 * m - n, 2.0 * (p - q) + m + n
        z[states + u] = p + at * (m + at * (c2 + at * c3))
