"""Integrate stiff systems with their sensitivities: implicit Runge-Kutta steps whose stages are solved one by one.

Every stage is solved by Newton's method. The sensitivities are the derivatives of the solved stages, so that they are
exact for the computed states. Letters as in `kernels.integrate`; C columns.
"""

import math
from typing import Final

import numpy as np

from atoll_coordinator.model.shooting.kernels.rates import (
    BLOWN_UP,
    EXHAUSTED,
    Path,
    Scratch,
    Table,
    Tape,
    put_inputs,
    rates,
    slopes,
)
from atoll_core.compilation.jit import kernel
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.kernels.tape import Ints

_G: Final = 1767732205903 / 4055673282236
_B: Final = (1471266399579 / 7840856788654, -4482444167858 / 7529755066697, 11266239266428 / 11593286722821, _G)
_EMBEDDED: Final = (
    2756255671327 / 12835298489170,
    -10771552573575 / 22201958757719,
    9247589265047 / 10645013368117,
    2193209047091 / 5459859503100,
)

STIFF: Final[Table] = (
    np.array([
        [0.0, 0.0, 0.0, 0.0],
        [_G, _G, 0.0, 0.0],
        [2746238789719 / 10658868560708, -640167445237 / 6845629431997, _G, 0.0],
        [*_B],
    ]),
    np.array([0.0, 2.0 * _G, 3 / 5, 1.0]),
    np.array(_B) - np.array(_EMBEDDED),
    3.0,
)  # fmt: skip
"""The L-stable method ESDIRK 3(2)4L[2]SA, Kennedy & Carpenter 2003."""

NEWTON_STEPS: Final = 8
CLOSE: Final = 0.05
"""A stage is solved when Newton's last step is at most this share of the allowed error."""


@kernel
def eliminate(matrix: FloatArray, right: FloatArray) -> bool:
    """Overwrite `right` (D, C) by the solutions of matrix * x = right; return False if `matrix` (D, D) is singular.

    `matrix` is overwritten, too.
    """
    size, columns = matrix.shape[0], right.shape[1]
    for i in range(size):
        pivot = i
        for j in range(i + 1, size):
            if abs(matrix[j, i]) > abs(matrix[pivot, i]):
                pivot = j
        if not abs(matrix[pivot, i]) > 0.0:
            return False
        if pivot != i:
            for k in range(size):
                matrix[i, k], matrix[pivot, k] = matrix[pivot, k], matrix[i, k]
            for c in range(columns):
                right[i, c], right[pivot, c] = right[pivot, c], right[i, c]
        for j in range(i + 1, size):
            share = matrix[j, i] / matrix[i, i]
            if share != 0.0:
                for k in range(i, size):
                    matrix[j, k] -= share * matrix[i, k]
                for c in range(columns):
                    right[j, c] -= share * right[i, c]
    for i in range(size - 1, -1, -1):
        for c in range(columns):
            total = right[i, c]
            for k in range(i + 1, size):
                total -= matrix[i, k] * right[k, c]
            right[i, c] = total / matrix[i, i]
    return True


@kernel
def put_matrix(jacobian: FloatArray, scale: float, matrix: FloatArray) -> None:
    """Write the identity minus `scale` times the first D columns of `jacobian` (D, Z) into `matrix` (D, D)."""
    for d in range(matrix.shape[0]):
        for e in range(matrix.shape[0]):
            matrix[d, e] = (1.0 if d == e else 0.0) - scale * jacobian[d, e]


@kernel
def solve_stage(table: Table, tape: Tape, stage: int, h: float, y: FloatArray, tolerance: FloatArray,
                points: FloatArray, values: FloatArray, adjoints: FloatArray, jacobian: FloatArray, direct: FloatArray,
                rate: FloatArray, matrix: FloatArray, column: FloatArray) -> bool:  # fmt: skip
    """Write the point and the rate of a stage; return False if Newton's method does not converge.

    The inputs of the stage must be in `points` already.
    """
    weights = table[0]
    states = y.shape[0]
    scale = h * weights[stage, stage]
    for d in range(states):
        points[stage, d] = points[stage - 1, d]
    for _ in range(NEWTON_STEPS):
        rates(tape, points[stage], values[stage], stage, rate)
        slopes(tape, values[stage], adjoints, jacobian, direct)
        put_matrix(jacobian, scale, matrix)
        for d in range(states):
            known = y[d]
            for k in range(stage):
                known += h * weights[stage, k] * rate[k, d]
            column[d, 0] = known + scale * rate[stage, d] - points[stage, d]
        if not eliminate(matrix, column):
            return False
        error = 0.0
        for d in range(states):
            points[stage, d] += column[d, 0]
            off = abs(column[d, 0]) / tolerance[d]
            error = error if off <= error or math.isnan(error) else off
        if not error < math.inf:
            return False
        if error <= CLOSE:
            for d in range(states):
                known = y[d]
                for k in range(stage):
                    known += h * weights[stage, k] * rate[k, d]
                rate[stage, d] = (points[stage, d] - known) / scale
            return True
    return False


@kernel
def carry(table: Table, h: float, stage: int, owners: Ints, sensitivity: FloatArray, stages: FloatArray,
          jacobian: FloatArray, direct: FloatArray, moved: FloatArray, matrix: FloatArray) -> bool:  # fmt: skip
    """Write the rates of the sensitivities (D, Q) at a stage into ``stages[stage]``.

    `jacobian` and `direct` hold the derivatives of the rates at this stage. Returns False if the matrix of the stage is
    singular.
    """
    weights = table[0]
    states, columns = sensitivity.shape
    for d in range(states):
        for q in range(columns):
            total = sensitivity[d, q]
            for k in range(stage):
                total += h * weights[stage, k] * stages[k, d, q]
            stages[stage, d, q] = total
    for d in range(states):
        for q in range(columns):
            total = 0.0
            for k in range(states):
                total += jacobian[d, k] * stages[stage, k, q]
            moved[d, q] = total
    for p in range(owners.shape[0]):
        moved[owners[p], p] += direct[p]
    put_matrix(jacobian, h * weights[stage, stage], matrix)
    if not eliminate(matrix, moved):
        return False
    for d in range(states):
        for q in range(columns):
            stages[stage, d, q] = moved[d, q]
    return True


@kernel
def advance_implicitly(table: Table, tape: Tape, owners: Ints, path: Path, row: int, tolerance: FloatArray,
                       limits: FloatArray, y: FloatArray, step: float, budget: int, sensitivity: FloatArray,
                       wants: bool, scratch: Scratch, matrix: FloatArray, column: FloatArray,
                       is_first: bool) -> tuple[float, int]:  # fmt: skip
    """Integrate the state `y` and its sensitivities from `row` to the next row, as `kernels.integrate.advance` does.

    Before a step, the first rows of the rates and of the stages, see `Scratch`, hold the last rates of the step before.
    With `is_first` there is no step before, and they are computed here.
    """
    points, stages, values, adjoints, jacobian, direct, moved, rate = scratch
    weights, nodes, errors, order = table
    last = nodes.shape[0] - 1
    states, columns = sensitivity.shape
    width = path[0][row + 1] - path[0][row]
    for d in range(states):
        points[0, d] = y[d]
    if is_first:
        put_inputs(points[0], states, path, row, 0.0, width)
        rates(tape, points[0], values[0], 0, rate)
        slopes(tape, values[0], adjoints, jacobian, direct)
        if wants and not carry(table, 0.0, 0, owners, sensitivity, stages, jacobian, direct, moved, matrix):
            return step, BLOWN_UP
    done = 0.0
    while done < 1.0:
        if budget <= 0:
            return step, EXHAUSTED
        if step < 1e-10 * width:
            return step, BLOWN_UP
        budget -= 1
        share = step / width
        is_last = done + share >= 1.0 - 1e-9
        if is_last:
            share = 1.0 - done
        h = share * width
        is_solved = True
        for s in range(1, last + 1):
            put_inputs(points[s], states, path, row, done + share * nodes[s], width)
            is_solved = solve_stage(
                table, tape, s, h, y, tolerance, points, values, adjoints, jacobian, direct, rate, matrix, column
            )  # fmt: skip
            if not is_solved:
                break
        if not is_solved:
            step = 0.25 * h
            continue
        put_matrix(jacobian, h * weights[last, last], matrix)
        for d in range(states):
            column[d, 0] = 0.0
            for s in range(last + 1):
                column[d, 0] += h * errors[s] * rate[s, d]
        error = math.inf
        if eliminate(matrix, column):
            error = 0.0
            for d in range(states):
                off = abs(column[d, 0]) / tolerance[d]
                error = error if off <= error or math.isnan(error) else off
        if not error <= 1.0:
            step = h * (max(0.1, 0.9 * error ** (-1.0 / order)) if error < 1e300 else 0.1)
            continue
        if wants:
            for s in range(1, last + 1):
                rates(tape, points[s], values[s], last + 1, rate)
                slopes(tape, values[s], adjoints, jacobian, direct)
                if not carry(table, h, s, owners, sensitivity, stages, jacobian, direct, moved, matrix):
                    return step, BLOWN_UP
            for d in range(states):
                for q in range(columns):
                    total = 0.0
                    for s in range(last + 1):
                        total += weights[last, s] * stages[s, d, q]
                    sensitivity[d, q] += h * total
                    stages[0, d, q] = stages[last, d, q]
        for d in range(states):
            y[d] = points[last, d]
            points[0, d] = y[d]
            rate[0, d] = rate[last, d]
            if not limits[d, 0] <= y[d] <= limits[d, 1]:
                return step, BLOWN_UP
        done += share
        grown = h * min(5.0, 0.9 * max(error, 1e-4) ** (-1.0 / order))
        step = grown if not is_last else max(step, grown)
        if is_last:
            break
    return step, budget
