"""The rates of a system's states at a point, their derivatives, and the interpolation of inputs between rows.

Letters: N nodes of all equations, D states with an equation, U inputs, Z = D + U numbers of a point (states, then
inputs), P fitted constants, R rows.
"""

import math
from typing import Any, Final

from atoll_core.compilation.jit import inlined
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.kernels.operator_choice import choose
from atoll_core.expression.kernels.tape import Ints
from atoll_core.expression.operators import (
    ARITY,
    CONSTANT,
    DIVIDE,
    POW,
    TRIGONOMETRIC_LIMIT,
    VARIABLE,
    Functions,
    Partial,
    definitions,
)

LARGEST_EXPONENT: Final = 709.0
"""exp overflows at 709.8; from this number on it counts as infinity."""

Table = tuple[FloatArray, FloatArray, FloatArray, float]
"""An embedded Runge-Kutta method whose last stage is the first stage of the next step: coefficients (S, S - 1), or
(S, S) for implicit stages; times (S,) as shares of the step; error weights (S,); order of the error estimate."""

Tape = tuple[Ints, Ints, Ints, FloatArray, Ints, Ints]
"""The nodes of all equations, one equation after another: code, left, right and constants (N,). Arguments are indices
of earlier nodes; `left` of a VARIABLE is its index in the point z. Then the output nodes of the equations (D,), and for
each node the number of its fitted constant (N,), -1 without one."""

Path = tuple[FloatArray, FloatArray, FloatArray]
"""Times (R,) of all rows, inputs (U, R) and their slopes (U, R)."""

Scratch = tuple[FloatArray, ...]
"""Scratch arrays for S stages of a step and Q columns of sensitivities: points (S, Z), rates of the sensitivities
(S, D, Q), values (S, N), adjoints (N,), Jacobian (D, Z), derivatives with respect to constants (P,), scratch
sensitivities (D, Q), rates (S + 1, D)."""

EXHAUSTED: Final = -1
"""Returned instead of the number of remaining steps: the budget of steps was too small."""
BLOWN_UP: Final = -2
"""Returned instead of the number of remaining steps: the state left its limits, or no step was small enough."""


@inlined
def _sin(a: float) -> float:
    return math.sin(a) if abs(a) <= TRIGONOMETRIC_LIMIT else math.nan


@inlined
def _cos(a: float) -> float:
    return math.cos(a) if abs(a) <= TRIGONOMETRIC_LIMIT else math.nan


@inlined
def _exp(a: float) -> float:
    return math.exp(a) if a < LARGEST_EXPONENT else math.inf


@inlined
def _log(a: float) -> float:
    return math.log(a) if a > 0.0 else (-math.inf if a == 0.0 else math.nan)


@inlined
def _sqrt(a: float) -> float:
    return math.sqrt(a) if a >= 0.0 else math.nan


@inlined
def _tanh(a: float) -> float:
    return math.tanh(a)


@inlined
def _power(a: float, b: float) -> float:
    return math.nan if a == 0.0 and b < 0.0 else float(a**b)


@inlined
def _sign(a: float) -> float:
    return 1.0 if a > 0.0 else (-1.0 if a < 0.0 else 0.0)


@inlined
def _base_log(a: float, v: float) -> float:
    return 0.0 if a == 0.0 and v == 0.0 else _log(a)


_OPERATORS: Final = definitions(Functions(_sin, _cos, _exp, _log, _sqrt, abs, _tanh, _power, _sign, _base_log))
"""The operators with functions of the C library, which are faster than the functions of the search."""


def _pulled(partial: Partial) -> Any:
    """Return the function (g, a, b, v) that multiplies the adjoint `g` by a partial derivative of an operator.

    `a` and `b` are the arguments of the operator, `v` is its value.
    """
    sign = partial.sign
    carried = inlined(lambda g, a, b, v: sign * g)
    for factor in partial.factors:
        carried = inlined(_times(carried, inlined(factor)))
    return carried if partial.divisor is None else inlined(_over(carried, inlined(partial.divisor)))


def _times(carried: Any, factor: Any) -> Any:
    return lambda g, a, b, v: carried(g, a, b, v) * factor(a, b, v)


def _over(carried: Any, divisor: Any) -> Any:
    return lambda g, a, b, v: carried(g, a, b, v) / divisor(a, b, v)


@inlined
def _undefined(op: int, *_: float) -> float:
    return math.nan


_value: Final = choose({op: inlined(each.value) for op, each in _OPERATORS.items()}, _undefined)
_pull_left: Final = choose({op: _pulled(each.left) for op, each in _OPERATORS.items()}, _undefined)
_pull_right: Final = choose({op: _pulled(each.right) for op, each in _OPERATORS.items() if ARITY[op] == 2}, _undefined)


@inlined
def rates(tape: Tape, z: FloatArray, values: FloatArray, stage: int, rate: FloatArray) -> None:
    """Write the values of all nodes at the point `z` (Z,) into `values` (N,), the rates (D,) into ``rate[stage]``."""
    code, left, right, constants, outputs, _ = tape
    for i in range(code.shape[0]):
        op = code[i]
        if op == VARIABLE:
            values[i] = z[left[i]]
            continue
        if op == CONSTANT:
            values[i] = constants[i]
            continue
        values[i] = _value(op, values[left[i]], values[right[i]])
    for d in range(outputs.shape[0]):
        rate[stage, d] = values[outputs[d]]


@inlined
def slopes(tape: Tape, values: FloatArray, adjoints: FloatArray, jacobian: FloatArray, direct: FloatArray) -> None:
    """Write d rate / d z into `jacobian` (D, Z) and d rate / d constant into `direct` (P,); call `rates` before.

    There is one reverse sweep for each equation, over the nodes after the output of the previous equation up to its own
    output.
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
            adjoints[p] += _pull_left(op, g, a, b, v)
            if op <= DIVIDE or op == POW:
                adjoints[q] += _pull_right(op, g, a, b, v)
        first = last + 1


@inlined
def put_inputs(z: FloatArray, states: int, path: Path, row: int, at: float, width: float) -> None:
    """Interpolate the inputs between `row` and the next row and write them after the `states` states in `z`.

    `at` is the position between the two rows in [0, 1], `width` the time between them. The interpolation is cubic
    (Hermite). An input whose slope is NaN keeps the value of `row`.
    """
    _, inputs, input_slopes = path
    for u in range(inputs.shape[0]):
        p, q = inputs[u, row], inputs[u, row + 1]
        if math.isnan(input_slopes[u, row]):
            z[states + u] = p
        else:
            m, n = input_slopes[u, row] * width, input_slopes[u, row + 1] * width
            c2, c3 = 3.0 * (q - p) - 2.0 * m - n, 2.0 * (p - q) + m + n
            z[states + u] = p + at * (m + at * (c2 + at * c3))
