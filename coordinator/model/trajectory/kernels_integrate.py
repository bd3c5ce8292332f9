"""Integrate a system of equations with its sensitivities, and sum up what a fit to measured states needs.

A *tape* holds the nodes of all equations one after another: `code`, `left`, `right` (N,) int64 and `constants` (N,);
arguments are indices of earlier nodes, a VARIABLE's `left` is its place in the point z. Letters: D states with an
equation, U inputs, Z = D + U numbers of a point, P fitted constants, Q = P + D columns of sensitivities (constants,
then the initial state), N rows of all trajectories, G segments.

Explicit Runge-Kutta steps with error control, clipped at the rows; the sensitivities follow the accepted steps of the
states.
"""

import math
from typing import Final

import numpy as np

from common.dataset import FloatArray
from common.expression.kernels import Ints
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
    TRIGONOMETRIC_LIMIT,
    VARIABLE,
)
from common.jit import allocating_kernel, inlined, kernel

LARGEST_EXPONENT: Final = 709.0
"""exp has no finite value far beyond."""

Table = tuple[FloatArray, FloatArray, FloatArray, float]
"""An embedded Runge-Kutta method whose last stage is the next step's first: coefficients (S, S - 1), times (S,), error
weights (S,), and the order of the error estimate."""

PRECISE: Final[Table] = (
    np.array([
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [1 / 5, 0.0, 0.0, 0.0, 0.0, 0.0],
        [3 / 40, 9 / 40, 0.0, 0.0, 0.0, 0.0],
        [44 / 45, -56 / 15, 32 / 9, 0.0, 0.0, 0.0],
        [19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729, 0.0, 0.0],
        [9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656, 0.0],
        [35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84],
    ]),
    np.array([0.0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1.0, 1.0]),
    np.array([71 / 57600, 0.0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40]),
    5.0,
)  # fmt: skip
"""Dormand & Prince 1980, 5(4)."""

QUICK: Final[Table] = (
    np.array([[0.0, 0.0, 0.0], [1 / 2, 0.0, 0.0], [0.0, 3 / 4, 0.0], [2 / 9, 1 / 3, 4 / 9]]),
    np.array([0.0, 1 / 2, 3 / 4, 1.0]),
    np.array([-5 / 72, 1 / 12, 1 / 9, -1 / 8]),
    3.0,
)
"""Bogacki & Shampine 1989, 3(2)."""


@kernel
def rates(code: Ints, left: Ints, right: Ints, constants: FloatArray, outputs: Ints, z: FloatArray,
          values: FloatArray, stage: int, rate: FloatArray) -> None:  # fmt: skip
    """Write the value of every node at the point `z` (Z,) into `values` (N,), the equations' into ``rate[stage]``."""
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


@kernel
def slopes(code: Ints, left: Ints, right: Ints, outputs: Ints, parameters: Ints, values: FloatArray,
           adjoints: FloatArray, jacobian: FloatArray, direct: FloatArray) -> None:  # fmt: skip
    """Write d rate / d z into `jacobian` (D, Z) and d rate / d constant into `direct` (P,), after `rates`.

    `parameters` (N,) is the number of the fitted constant at a node, -1 elsewhere. One reverse sweep for each equation,
    whose nodes lie between the output of the one before and its own.
    """
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
def put_inputs(z: FloatArray, states: int, inputs: FloatArray, input_slopes: FloatArray, row: int, at: float,
               width: float) -> None:  # fmt: skip
    """Write the inputs at `at` in [0, 1] between `row` and the next, `width` apart, behind the states in `z`."""
    for u in range(inputs.shape[0]):
        p, q = inputs[u, row], inputs[u, row + 1]
        m, n = input_slopes[u, row] * width, input_slopes[u, row + 1] * width
        c2, c3 = 3.0 * (q - p) - 2.0 * m - n, 2.0 * (p - q) + m + n
        z[states + u] = p + at * (m + at * (c2 + at * c3))


@kernel
def advance(table: Table, code: Ints, left: Ints, right: Ints, constants: FloatArray, outputs: Ints, parameters: Ints,
            owners: Ints, times: FloatArray, inputs: FloatArray, input_slopes: FloatArray, row: int,
            tolerance: FloatArray, limits: FloatArray, y: FloatArray, step: float, budget: int,
            sensitivity: FloatArray, wants: bool, points: FloatArray, stages: FloatArray, values: FloatArray,
            adjoints: FloatArray, jacobian: FloatArray, direct: FloatArray, moved: FloatArray,
            rate: FloatArray) -> tuple[float, int]:  # fmt: skip
    """Carry the state `y` (D,), and `sensitivity` (D, Q) if it `wants` them, from `row` to the next one.

    `tolerance` (D,) is the error allowed in a step, `limits` (D, 2) the range outside of which the state has blown up;
    `budget` the steps that may be taken. Returns the step to begin with next and the budget left, negative when the
    state blew up or the budget was used up. The other arguments are scratch.
    """
    weights, nodes, errors, order = table
    last = nodes.shape[0] - 1
    states = y.shape[0]
    columns = sensitivity.shape[1]
    fitted = columns - states
    width = times[row + 1] - times[row]
    done = 0.0
    while done < 1.0:
        if budget <= 0:
            return step, -1
        budget -= 1
        share = step / width
        is_last = done + share >= 1.0 - 1e-9
        if is_last:
            share = 1.0 - done
        h = share * width
        for s in range(last + 1):
            for d in range(states):
                total = 0.0
                for k in range(s):
                    total += weights[s, k] * rate[k, d]
                points[s, d] = y[d] + h * total
            put_inputs(points[s], states, inputs, input_slopes, row, done + share * nodes[s], width)
            rates(code, left, right, constants, outputs, points[s], values[s], s, rate)
        error = 0.0
        for d in range(states):
            off = 0.0
            for s in range(last + 1):
                off += errors[s] * rate[s, d]
            off = abs(h * off) / tolerance[d]
            error = error if off <= error or math.isnan(error) else off
        if not error <= 1.0:
            step = h * (max(0.1, 0.9 * error ** (-1.0 / order)) if error < 1e300 else 0.1)
            if step < 1e-10 * width:
                return step, -1
            continue
        if wants:
            for s in range(last):
                slopes(code, left, right, outputs, parameters, values[s], adjoints, jacobian, direct)
                for d in range(states):
                    for q in range(columns):
                        total = sensitivity[d, q]
                        for k in range(s):
                            if weights[s, k] != 0.0:
                                total += h * weights[s, k] * stages[k, d, q]
                        moved[d, q] = total
                for d in range(states):
                    for q in range(columns):
                        total = 0.0
                        for k in range(states):
                            total += jacobian[d, k] * moved[k, q]
                        stages[s, d, q] = total
                for p in range(fitted):
                    stages[s, owners[p], p] += direct[p]
            for d in range(states):
                for q in range(columns):
                    total = 0.0
                    for s in range(last):
                        total += weights[last, s] * stages[s, d, q]
                    sensitivity[d, q] += h * total
        for d in range(states):
            y[d] = points[last, d]
            if not limits[d, 0] <= y[d] <= limits[d, 1]:
                return step, -1
        done += share
        grown = h * min(5.0, 0.9 * max(error, 1e-4) ** (-1.0 / order))
        step = grown if not is_last else max(step, grown)
        if is_last:
            break
    return step, budget


@allocating_kernel
def shoot(table: Table, code: Ints, left: Ints, right: Ints, constants: FloatArray, outputs: Ints, parameters: Ints,
          owners: Ints, times: FloatArray, inputs: FloatArray, input_slopes: FloatArray, segments: Ints,
          starts: FloatArray, tolerance: FloatArray, limits: FloatArray, budget: int, wants: bool,
          simulated: FloatArray, gradients: FloatArray) -> int:  # fmt: skip
    """Integrate every segment from its start; write states (D, N) and sensitivities (N, D, Q) at its rows.

    `segments` (G, 2) are half-open row ranges, `starts` (G, D) their states at the first row, `budget` the steps that
    all rows together may take. Returns the number of segments that were integrated to their end: all, or the rows of
    the one that was not stay NaN from where it ended, and the later ones are not tried.
    """
    stage_count = table[1].shape[0]
    nodes, states = code.shape[0], outputs.shape[0]
    columns = owners.shape[0] + states
    rate = np.zeros((stage_count, states))
    points = np.zeros((stage_count, states + inputs.shape[0]))
    values = np.zeros((stage_count, nodes))
    adjoints = np.zeros(nodes)
    jacobian = np.zeros((states, states + inputs.shape[0]))
    direct = np.zeros(owners.shape[0])
    moved = np.zeros((states, columns))
    stages = np.zeros((stage_count, states, columns))
    sensitivity = np.zeros((states, columns))
    y = np.zeros(states)
    for g in range(segments.shape[0]):
        first, end = segments[g, 0], segments[g, 1]
        for d in range(states):
            y[d] = starts[g, d]
            for q in range(columns):
                sensitivity[d, q] = 1.0 if q == owners.shape[0] + d else 0.0
        step = times[first + 1] - times[first] if end > first + 1 else 1.0
        for row in range(first, end):
            if row > first:
                step, budget = advance(
                    table, code, left, right, constants, outputs, parameters, owners, times, inputs, input_slopes,
                    row - 1, tolerance, limits, y, step, budget, sensitivity, wants, points, stages, values, adjoints,
                    jacobian, direct, moved, rate,
                )  # fmt: skip
                if budget < 0:
                    return g
            for d in range(states):
                simulated[d, row] = y[d]
                if wants:
                    for q in range(columns):
                        gradients[row, d, q] = sensitivity[d, q]
    return int(segments.shape[0])
