"""Integrate a system of equations with its sensitivities, along segments of rows.

A tape holds the system, see `kernels.rates`. Letters: D states with an equation, U inputs, Z = D + U numbers of a
point, P fitted constants, Q = P + D columns of sensitivities (constants, then the initial state), N rows of all
trajectories, G segments, S stages.

The integration uses Runge-Kutta steps with error control; steps end at the rows. The sensitivities are integrated with
the accepted steps of the states. This module has explicit steps; `kernels.implicit` has implicit steps for stiff
systems.
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
"""The method of Dormand & Prince 1980, order 5(4)."""

QUICK: Final[Table] = (
    np.array([[0.0, 0.0, 0.0], [1 / 2, 0.0, 0.0], [0.0, 3 / 4, 0.0], [2 / 9, 1 / 3, 4 / 9]]),
    np.array([0.0, 1 / 2, 3 / 4, 1.0]),
    np.array([-5 / 72, 1 / 12, 1 / 9, -1 / 8]),
    3.0,
)
"""The method of Bogacki & Shampine 1989, order 3(2)."""

_GROWTH: Final = 5.0
"""The next step is at most this many times as long."""

Flat = tuple[FloatArray, FloatArray, FloatArray]
"""The sensitivities (D Q,), scratch sensitivities (D Q,), and the rates at the stages (S, D Q). The latter two are flat
views of arrays in `Scratch`, so that loops over them vectorise."""


@inlined
def carry_on(h: float, weights: FloatArray, stage: int, owners: Ints, jacobian: FloatArray, direct: FloatArray,
             flat: Flat) -> None:  # fmt: skip
    """Write the rates of the sensitivities at a stage, from the derivatives of the rates in `jacobian` and `direct`.

    `owners` (P,) are the equations of the fitted constants.
    """
    sensitivity, moved, stages = flat
    states = jacobian.shape[0]
    columns = sensitivity.shape[0] // states
    source = sensitivity
    for k in range(stage):
        if weights[stage, k] != 0.0:
            factor = h * weights[stage, k]
            for i in range(sensitivity.shape[0]):
                moved[i] = source[i] + factor * stages[k, i]
            source = moved
    for d in range(states):
        mine, is_empty = d * columns, True
        for k in range(states):
            factor, its = jacobian[d, k], k * columns
            if factor == 0.0:
                continue  # in a large system most states do not depend on each other
            for q in range(columns):
                before = 0.0 if is_empty else stages[stage, mine + q]
                stages[stage, mine + q] = before + factor * source[its + q]
            is_empty = False
        if is_empty:
            for q in range(columns):
                stages[stage, mine + q] = 0.0
    for p in range(owners.shape[0]):
        stages[stage, owners[p] * columns + p] += direct[p]


@inlined
def gather(h: float, weights: FloatArray, flat: Flat) -> None:
    """Advance the sensitivities by a step of length `h`, from their rates at all stages but the last.

    `weights` (S - 1,) are the last row of the method's coefficients.
    """
    sensitivity, moved, stages = flat
    for i in range(sensitivity.shape[0]):
        moved[i] = 0.0
    for s in range(stages.shape[0] - 1):
        factor = weights[s]
        for i in range(sensitivity.shape[0]):
            moved[i] += factor * stages[s, i]
    for i in range(sensitivity.shape[0]):
        sensitivity[i] += h * moved[i]


@inlined
def advance(table: Table, tape: Tape, owners: Ints, path: Path, row: int, tolerance: FloatArray, limits: FloatArray,
            y: FloatArray, step: float, budget: int, flat: Flat, wants: bool, scratch: Scratch,
            is_known: bool, easy: float) -> tuple[float, int]:  # fmt: skip
    """Integrate the state `y` (D,), and with `wants` the sensitivities in `flat`, from `row` to the next row.

    `tolerance` (D,) is the allowed error of a step; a state outside of `limits` (D, 2) has blown up; `budget` is the
    largest number of steps. With `is_known` the first rows of values and rates, see `Scratch`, belong to `y` already.
    After a step with an error below `easy`, the next step grows as far as it may.
    Returns the length of the next step and the remaining budget; `BLOWN_UP` or `EXHAUSTED` instead of the budget if
    the next row was not reached.
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
        grown = _GROWTH * h
        if error >= easy:  # the power takes as long as a stage, and for smaller errors it exceeds the limit
            grown = h * min(_GROWTH, 0.9 * max(error, 1e-4) ** (-1.0 / order))
        step = grown if not is_last else max(step, grown)
        if is_last:
            break
    return step, budget


@allocating_kernel
def integrate_segments(table: Table, tape: Tape, owners: Ints, path: Path, segments: Ints, starts: FloatArray,
          tolerance: FloatArray, limits: FloatArray, budget: int, wants: bool, simulated: FloatArray,
          gradients: FloatArray, taken: Ints) -> int:  # fmt: skip
    """Integrate every segment from its initial state; write states and sensitivities at its rows.

    `segments` (G, 2) are half-open row ranges, `starts` (G, D) their initial states. `budget` is the largest number of
    steps of all segments together. Results are the states `simulated` (D, N), with `wants` the sensitivities
    `gradients` (N, D, Q), and `taken` (1,), the number of steps.

    Returns the number g of segments that were integrated to their end. The integration ends at the first segment that
    blows up; the rows that were not reached keep their values (NaN). If the budget is exhausted, it returns -1 - g.
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
    is_held = False  # if an input is held, rates jump at rows: the last rates before a row are not the first after it
    for u in range(inputs.shape[0]):
        is_held = is_held or math.isnan(input_slopes[u, 0])
    easy = (0.85 / _GROWTH) ** table[3]
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
                    row > first + 1 and inputs.shape[0] == 0, easy,
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


@kernel
def largest_sizes(gradients: FloatArray, sizes: FloatArray) -> None:
    """Write the largest absolute values (D, Q) over the rows of `gradients` (N, D, Q) into `sizes`; infinity where a
    value is not finite."""
    rows, columns = gradients.shape[0], sizes.size
    flat, values = sizes.reshape(-1), gradients.reshape((rows, columns))
    for q in range(columns):
        flat[q] = 0.0
    for row in range(rows):
        for q in range(columns):
            size = abs(values[row, q])
            flat[q] = size if size > flat[q] else flat[q]
            if not size < math.inf:
                flat[q] = math.inf
