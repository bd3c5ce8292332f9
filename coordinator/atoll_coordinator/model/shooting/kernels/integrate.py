"""Integrate a system of equations with its sensitivities, along segments of rows.

A system stands on a tape, see `kernels.rates`. Letters: D states with an equation, U inputs, Z = D + U numbers of a
point, P fitted constants, Q = P + D columns of sensitivities (constants, then the initial state), N rows of all
trajectories, G segments.

Runge-Kutta steps with error control, clipped at the rows; the sensitivities follow the accepted steps of the states.
Explicit ones here; implicit ones, for stiff systems, in `kernels.implicit`.
"""

import math
from typing import Final

import numpy as np

from atoll_coordinator.model.shooting.kernels.implicit import advance_implicitly
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
from atoll_core.compilation.jit import allocating_kernel, inlined, kernel
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.kernels.tape import Ints

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


Flat = tuple[FloatArray, FloatArray, FloatArray]
"""The sensitivities (D Q,), carried ones (D Q,), and their rates at S stages (S, D Q): those of `Scratch` as vectors,
on which one instruction works on several numbers."""


@inlined
def carry_on(h: float, weights: FloatArray, stage: int, owners: Ints, jacobian: FloatArray, direct: FloatArray,
             flat: Flat) -> None:  # fmt: skip
    """Write the rates of the sensitivities at a stage, where the slopes are known."""
    sensitivity, moved, stages = flat
    states = jacobian.shape[0]
    columns = sensitivity.shape[0] // states
    for i in range(sensitivity.shape[0]):
        moved[i] = sensitivity[i]
    for k in range(stage):
        if weights[stage, k] != 0.0:
            factor = h * weights[stage, k]
            for i in range(sensitivity.shape[0]):
                moved[i] += factor * stages[k, i]
    for d in range(states):
        mine = d * columns
        for q in range(columns):
            stages[stage, mine + q] = 0.0
        for k in range(states):
            factor, its = jacobian[d, k], k * columns
            if factor == 0.0:
                continue  # of many states most do not meet
            for q in range(columns):
                stages[stage, mine + q] += factor * moved[its + q]
    for p in range(owners.shape[0]):
        stages[stage, owners[p] * columns + p] += direct[p]


@inlined
def gather(h: float, weights: FloatArray, flat: Flat) -> None:
    """Carry the sensitivities over a step of length `h`, their rates at all stages but the last being known."""
    sensitivity, moved, stages = flat
    for i in range(sensitivity.shape[0]):
        moved[i] = 0.0
    for s in range(stages.shape[0] - 1):
        factor = weights[s]
        for i in range(sensitivity.shape[0]):
            moved[i] += factor * stages[s, i]
    for i in range(sensitivity.shape[0]):
        sensitivity[i] += h * moved[i]


@kernel
def advance(table: Table, tape: Tape, owners: Ints, path: Path, row: int, tolerance: FloatArray, limits: FloatArray,
            y: FloatArray, step: float, budget: int, flat: Flat, wants: bool, scratch: Scratch,
            is_known: bool) -> tuple[float, int]:  # fmt: skip
    """Carry the state `y` (D,), and the sensitivities in `flat` if it `wants` them, from `row` to the next one.

    `tolerance` (D,) is the error allowed in a step, `limits` (D, 2) the range outside of which the state has blown up;
    `budget` the steps that may be taken; `is_known` tells that the first values and rates, see `Scratch`, are those of
    `y` already. Returns the step to begin with next and the budget left, `BLOWN_UP` or `EXHAUSTED` when the end was
    not reached.
    """
    points, _, values, adjoints, jacobian, direct, _, rate = scratch
    weights, nodes, errors, order = table
    last = nodes.shape[0] - 1
    states = y.shape[0]
    width = path[0][row + 1] - path[0][row]
    done = 0.0
    while done < 1.0:
        if budget <= 0:
            return step, EXHAUSTED
        budget -= 1
        share = step / width
        is_last = done + share >= 1.0 - 1e-9
        if is_last:
            share = 1.0 - done
        h = share * width
        for s in range(1 if is_known else 0, last + 1):
            for d in range(states):
                total = 0.0
                for k in range(s):
                    total += weights[s, k] * rate[k, d]
                points[s, d] = y[d] + h * total
            put_inputs(points[s], states, path, row, done + share * nodes[s], width)
            rates(tape, points[s], values[s], s, rate)
        is_known = True
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
                return step, BLOWN_UP
            continue
        if wants:
            for s in range(last):
                slopes(tape, values[s], adjoints, jacobian, direct)
                carry_on(h, weights, s, owners, jacobian, direct, flat)
            gather(h, weights[last], flat)
        for i in range(values.shape[1]):
            values[0, i] = values[last, i]
        for d in range(states):
            rate[0, d] = rate[last, d]
            y[d] = points[last, d]
            if not limits[d, 0] <= y[d] <= limits[d, 1]:
                return step, BLOWN_UP
        done += share
        grown = h * min(5.0, 0.9 * max(error, 1e-4) ** (-1.0 / order))
        step = grown if not is_last else max(step, grown)
        if is_last:
            break
    return step, budget


@allocating_kernel
def integrate_segments(table: Table, tape: Tape, owners: Ints, path: Path, segments: Ints, starts: FloatArray,
          tolerance: FloatArray, limits: FloatArray, budget: int, wants: bool, simulated: FloatArray,
          gradients: FloatArray, taken: Ints) -> int:  # fmt: skip
    """Integrate every segment from its start; write states (D, N) and sensitivities (N, D, Q) at its rows.

    `segments` (G, 2) are half-open row ranges, `starts` (G, D) their states at the first row, `budget` the steps that
    all rows together may take, `taken` (1,) gets how many were. Returns the number g of segments that were integrated
    to their end: all, or the rows of the one that was not stay NaN from where it ended, and the later ones are not
    tried; -1 - g when the budget was used up.
    """
    stage_count = table[1].shape[0]
    is_implicit = table[0].shape[1] == stage_count
    times, inputs, input_slopes = path
    nodes, states = tape[0].shape[0], tape[4].shape[0]
    columns = owners.shape[0] + states
    scratch = (
        np.zeros((stage_count, states + inputs.shape[0])),
        np.zeros((stage_count, states, columns)),
        np.zeros((stage_count, nodes)),
        np.zeros(nodes),
        np.zeros((states, states + inputs.shape[0])),
        np.zeros(owners.shape[0]),
        np.zeros((states, columns)),
        np.zeros((stage_count + 1, states)),
    )
    sensitivity = np.zeros((states, columns))
    flat = (sensitivity.reshape(-1), scratch[6].reshape(-1), scratch[1].reshape(stage_count, states * columns))
    matrix = np.zeros((states, states))
    column = np.zeros((states, 1))
    y = np.zeros(states)
    is_held = False  # then rates jump at the rows, and those at the end of one step do not begin the next
    for u in range(inputs.shape[0]):
        is_held = is_held or math.isnan(input_slopes[u, 0])
    given = budget
    taken[0] = 0
    for g in range(segments.shape[0]):
        first, end = segments[g, 0], segments[g, 1]
        for d in range(states):
            y[d] = starts[g, d]
            for q in range(columns):
                sensitivity[d, q] = 1.0 if q == owners.shape[0] + d else 0.0
        step = times[first + 1] - times[first] if end > first + 1 else 1.0
        for row in range(first, end):
            if row > first and is_implicit:
                step, budget = advance_implicitly(
                    table, tape, owners, path, row - 1, tolerance, limits, y, step, budget, sensitivity, wants, scratch,
                    matrix, column, row == first + 1 or is_held,
                )  # fmt: skip
            elif row > first:
                step, budget = advance(
                    table, tape, owners, path, row - 1, tolerance, limits, y, step, budget, flat, wants, scratch,
                    row > first + 1 and inputs.shape[0] == 0,
                )  # fmt: skip
            if budget >= 0:
                taken[0] = given - budget
            else:
                taken[0] = given if budget == EXHAUSTED else taken[0]
                return g if budget == BLOWN_UP else -1 - g
            for d in range(states):
                simulated[d, row] = y[d]
                if wants:
                    for q in range(columns):
                        gradients[row, d, q] = sensitivity[d, q]
    return int(segments.shape[0])
