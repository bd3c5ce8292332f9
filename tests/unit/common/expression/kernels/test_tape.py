"""Values and gradients of programs, against the definition of every operator and its derivative."""

import math
from itertools import product

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from atoll_core.expression.kernels.elementary import strict_cos, strict_sin
from atoll_core.expression.kernels.tape import LANES, forward_block, functions_address, padded, reverse_block
from atoll_core.expression.operators import (
    ADD,
    ARITY,
    BY_NAME,
    CONSTANT,
    COS,
    DIVIDE,
    MULTIPLY,
    NEGATE,
    POW,
    SIN,
    SQUARE,
    SUBTRACT,
    VARIABLE,
)
from atoll_island_worker.evolution.kernels.measured_rows import padded_rows
from atoll_island_worker.evolution.structures import empty_work
from tests.oracles.evaluate import apply, evaluate
from tests.oracles.gradient import derivative
from tests.oracles.programs import program_of
from tests.oracles.tapes import evaluate_tape, live_nodes, node_values, rows_of, tape_of
from tests.property.programs import NAMES, ROWS, programs

X, Y = (VARIABLE, 0), (VARIABLE, 1)
AWKWARD = [0.0, -0.0, 1.0, -1.0, 2.0, -3.0, 0.5, 7.25, -0.125, 1e-300, -1e-300, 1e200, -1e200, 1e5, 1.1e5]
AWKWARD += [math.inf, -math.inf, math.nan, 20.0, -745.0]
QUICK = settings(max_examples=200, deadline=None, derandomize=True, database=None)


@pytest.fixture(autouse=True)
def _quiet():
    """Silence numpy's warnings, which kernels cause when the JIT is off."""
    with np.errstate(all="ignore"):
        yield


def block(tape, count, inputs, waves, start, values):
    """Call `forward_block` with the arrays of `tape`."""
    forward_block(
        count, tape.code, tape.left, tape.right, tape.constants, tape.wanted, inputs, waves, start, values,
        functions_address(),
    )  # fmt: skip


def gradient(program, inputs):
    """Return d(output)/d(node) for every node that depends on a constant, at every row: (nodes, rows)."""
    rows = rows_of(inputs, np.zeros(len(inputs[0])))
    tape, count = tape_of(program)
    work = empty_work(count, rows.length)
    evaluate_tape(tape, count, rows, work)
    for node in range(count):
        parts = (tape.left[node], tape.right[node])[: ARITY[tape.code[node]]]
        tape.depends[node] = tape.code[node] == CONSTANT or any(tape.depends[part] for part in parts)
    values = np.zeros((count, padded(rows.length)))
    for start in range(0, rows.length, LANES):
        work.adjoints[:] = 0.0
        work.adjoints[count - 1] = 1.0
        reverse_block(
            count, tape.code, tape.left, tape.right, tape.depends, work.values, start, work.adjoints, work.functions
        )
        values[:, start : start + LANES] = work.adjoints[:count]
    return values[:, : rows.length]


@pytest.mark.parametrize("name", BY_NAME)
def test_every_operator_has_the_value_of_its_definition(name):
    operator = BY_NAME[name]
    pairs = list(product(AWKWARD, AWKWARD if operator.arity == 2 else [0.0]))
    values = node_values(program_of([X, Y, (operator.code, 0, 1)]), np.array(pairs).T)[2]
    expected = [apply(operator.code, a, b) for a, b in pairs]
    np.testing.assert_allclose(values, expected, rtol=1e-15, atol=1e-15 if operator.code in (SIN, COS) else 0.0)
    if name not in ("sin", "pow"):  # they treat -0.0 as 0.0
        signs = [[math.copysign(1.0, value) for value in both if value == 0.0] for both in (values, expected)]
        assert signs[0] == signs[1]


@QUICK
@given(programs(), st.lists(ROWS, min_size=1, max_size=LANES + 4))
def test_a_program_has_the_value_of_its_definition_at_every_row(program, rows):
    """Operators that are not exactly rounded are left out, because a program can amplify errors in their last bits.

    The test above covers them.
    """
    assume(not {BY_NAME[name].code for name in ("sin", "cos", "exp", "log", "tanh", "pow")} & {*program.operators})
    values = node_values(program, np.array(rows).T)
    np.testing.assert_array_equal(values[-1], [evaluate(program, row) for row in rows])


def test_rows_do_not_touch_each_other():
    """The values at a row do not depend on the rows next to it or on the block."""
    program = program_of([X, Y, 0.3, (MULTIPLY, 0, 2), (SIN, 3), (DIVIDE, 4, 1), (POW, 1, 5)])
    inputs = np.random.default_rng(0).uniform(0.1, 3.0, (2, 37))
    together = node_values(program, inputs)
    alone = np.array([node_values(program, inputs[:, [row]])[:, 0] for row in range(37)]).T
    np.testing.assert_array_equal(together, alone)


def test_a_block_leaves_other_rows_alone():
    tape, count = tape_of(program_of([X, (SQUARE, 0)]))
    inputs, values = np.arange(48.0)[None, :], np.full((count, 48), -1.0)
    block(tape, count, inputs, np.zeros((0, 48)), 16, values)
    np.testing.assert_array_equal(values[1, 16:32], np.arange(16.0, 32.0) ** 2)
    assert (np.delete(values, np.s_[16:32], axis=1) == -1.0).all()


def test_nodes_that_are_not_wanted_keep_what_they_hold():
    tape, count = tape_of(program_of([X, (SQUARE, 0), (ADD, 0, 1), (MULTIPLY, 1, 2)]))
    inputs, values = np.arange(16.0)[None, :], np.full((count, 16), -1.0)
    tape.wanted[:count] = [True, True, False, True]
    block(tape, count, inputs, np.zeros((0, 16)), 0, values)
    assert (values[2] == -1.0).all()
    np.testing.assert_array_equal(values[3], -(np.arange(16.0) ** 2))


def test_kept_sines_and_cosines_are_taken_for_inputs_and_for_nothing_else():
    """The stored waves here are not sines and cosines, so that the test can see which values come from them."""
    nodes = [X, Y, (SIN, 0), (COS, 0), (SIN, 1), (COS, 1), (NEGATE, 1), (SIN, 6), (COS, 4)]
    tape, count = tape_of(program_of(nodes))
    inputs, waves, values = np.ones((2, 32)), np.arange(128.0).reshape(4, 32), np.zeros((count, 32))
    block(tape, count, inputs, waves, 16, values)
    np.testing.assert_array_equal(values[2:6, 16:], waves[:, 16:])
    np.testing.assert_array_equal(values[7, 16:], np.full(16, strict_sin(-1.0)))
    np.testing.assert_array_equal(values[8, 16:], [strict_cos(x) for x in waves[2, 16:]])


@pytest.mark.parametrize("count", [1, 15, 16, 17, 40])
def test_rows_have_the_same_bits_with_kept_sines_and_cosines_and_without(count):
    program = program_of([X, Y, (SIN, 0), (COS, 1), (MULTIPLY, 2, 3), (COS, 0), (SUBTRACT, 4, 5), (SIN, 6)])
    inputs = np.random.default_rng(2).uniform(-9.0, 9.0, (2, count))
    inputs[0, 0] = 1.1e5
    tape, nodes = tape_of(program)
    values = []
    for keeps_waves in (True, False):
        rows = padded_rows(inputs, np.zeros(count), keeps_waves)
        work = empty_work(nodes, count)
        evaluate_tape(tape, nodes, rows, work)
        values.append(work.values[:, :count])
    assert np.isnan(values[0][-1, 0])
    np.testing.assert_array_equal(*values)


@pytest.mark.parametrize(("rows", "expected"), [(1, 16), (16, 16), (17, 32), (100, 112)])
def test_rows_are_padded_to_whole_blocks(rows, expected):
    assert padded(rows) == expected


@pytest.mark.parametrize("name", BY_NAME)
@pytest.mark.parametrize("point", [(0.7, 1.9), (2.5, -0.6), (1e-3, 3.0), (0.9, 40.0)])
def test_every_operator_has_the_gradient_of_its_definition(name, point):
    """Each operand depends on its own constant, and on a variable, so that no part can be folded."""
    operator = BY_NAME[name]
    nodes = [X, *point, (MULTIPLY, 0, 1), (MULTIPLY, 0, 2), (operator.code, 3, 4 if operator.arity == 2 else 0)]
    program = program_of(nodes)
    slopes = gradient(program, [[1.25]])[:, 0]
    for constant in (1, 2):
        assert slopes[constant] == pytest.approx(derivative(program, [1.25], constant), rel=1e-13, abs=1e-300)


def test_the_gradient_of_a_power_of_a_negative_base_goes_by_the_base_alone():
    program = program_of([X, -2.0, (MULTIPLY, 0, 1), Y, (POW, 2, 3)])
    slopes = gradient(program, [[1.5], [3.0]])
    assert slopes[1, 0] == pytest.approx(3 * (-3.0) ** 2 * 1.5)


def test_at_its_kink_the_absolute_value_has_gradient_zero():
    program = program_of([X, 1.0, (MULTIPLY, 0, 1), (BY_NAME["abs"].code, 2)])
    np.testing.assert_array_equal(gradient(program, [[-2.0, 0.0, 2.0]])[1], [2.0, 0.0, 2.0])


def test_a_constant_used_several_times_gathers_all_its_parts():
    """The derivative of c x + sin(c) - c**2 with respect to c is x + cos(c) - 2 c."""
    nodes = [X, 0.8, (MULTIPLY, 0, 1), (SIN, 1), (ADD, 2, 3), (SQUARE, 1), (SUBTRACT, 4, 5)]
    slopes = gradient(program_of(nodes), [[3.0, -1.0]])
    assert slopes[1] == pytest.approx(np.array([3.0, -1.0]) + math.cos(0.8) - 1.6)


@QUICK
@given(programs(constants=st.floats(0.3, 3.0)), st.tuples(*(st.floats(0.3, 3.0) for _ in NAMES)))
def test_any_program_has_the_gradient_of_its_definition(program, row):
    """Programs have shared nodes, dead nodes and repeated arguments; no value is extreme or close to a kink."""
    inputs = np.array(row)[:, None]
    values = abs(node_values(program, inputs)[:, 0])
    assume(bool(((values > 1e-2) & (values < 1e2)).all()))
    assume(
        all(node_values(program, inputs)[program.left[i], 0] > 0.0 for i in np.flatnonzero(program.operators == POW))
    )
    slopes = gradient(program, inputs)[:, 0]
    size = np.abs(slopes).max()
    for node in live_nodes(program):
        if program.operators[node] == CONSTANT:
            assert slopes[node] == pytest.approx(derivative(program, row, node), rel=1e-10, abs=1e-12 * size)
