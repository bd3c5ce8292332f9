"""Fits: coefficients against numpy's least squares, constants against known ones, and the number of evaluations."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from atoll_core.expression.operators import (
    ADD,
    CONSTANT,
    COS,
    DIVIDE,
    EXP,
    LOG,
    MULTIPLY,
    NEGATE,
    SIN,
    SQRT,
    SUBTRACT,
    VARIABLE,
)
from atoll_island_worker.evolution.kernels.fit import (
    collect_terms,
    errors,
    fit,
    fit_terms,
    measure_tape,
    residual_of,
)
from atoll_island_worker.evolution.kernels.measured_rows import product
from atoll_island_worker.evolution.structures import MOST_TERMS, Fit, empty_work
from tests.oracles import fitting as oracle
from tests.oracles.programs import program_of
from tests.oracles.tapes import SPACE, node_values, program_on, rows_of, tape_of, top_level_terms
from tests.property.programs import NAMES, programs

X, Y = (VARIABLE, 0), (VARIABLE, 1)
QUICK = settings(max_examples=200, deadline=None, derandomize=True, database=None)
SCALED, AS_IT_STANDS = Fit(4, 3, 2, 0, math.inf), Fit(4, 0, 2, 0, math.inf)


def fitted(program, inputs, target, options=SCALED, steps=20, most=100):
    """Return (program after the fit, scale, mean absolute error, mean squared error, point evaluations)."""
    tape, count = tape_of(program)
    rows = rows_of(inputs, target)
    scale, result = np.zeros(1 + MOST_TERMS), np.zeros(2)
    used = fit(tape, count, rows, options, most, steps, math.inf, empty_work(SPACE, rows.length), scale, result)
    return program_on(tape, count), scale, float(result[0]), float(result[1]), used


def random_inputs(seed, rows=40, variables=2):
    return np.random.default_rng(seed).uniform(0.5, 3.0, (variables, rows))


@pytest.mark.slow
@QUICK
@given(programs(constants=st.floats(0.3, 3.0)), st.integers(0, MOST_TERMS))
def test_the_terms_are_those_of_the_definition(program, most):
    tape, count = tape_of(program)
    terms = empty_work(SPACE, 1).terms
    number = collect_terms(tape, count, most, terms)
    assert set(terms[:number].tolist()) == (top_level_terms(program, most) if most else {count - 1})
    assert number <= max(1, most)


@pytest.mark.slow
@QUICK
@given(programs(constants=st.floats(0.3, 3.0)), st.integers(1, MOST_TERMS))
def test_the_output_is_a_combination_of_its_terms(program, most):
    inputs = random_inputs(1, variables=len(NAMES))
    values = node_values(program, inputs)
    assume(np.isfinite(values).all() and np.abs(values).max() < 1e3)
    tape, count = tape_of(program)
    terms = empty_work(SPACE, 1).terms
    number = collect_terms(tape, count, most, terms)
    output, nearest = oracle.combination(program, inputs, set(terms[:number].tolist()))
    np.testing.assert_allclose(nearest, output, rtol=1e-9, atol=1e-9)


def errors_of(output, rows, beyond=-3.0):
    """Return the errors of `output` (R,) as a single unscaled term, with the value `beyond` in the padding."""
    work, scale, result = empty_work(1, rows.length), np.array([0.0, 1.0, 0.0, 0.0, 0.0]), np.zeros(2)
    work.values[:] = beyond
    work.values[0, : rows.length] = output
    residual_of(1, rows, work, scale)
    errors(rows, work, result)
    assert (work.residual[0, rows.length :] == 0.0).all()
    return result.tolist()


@QUICK
@given(st.integers(1, 40), st.integers(0, 2**32 - 1))
def test_sums_and_errors_are_those_of_their_definitions(length, seed):
    random = np.random.default_rng(seed)
    output, target = random.normal(size=(2, length)) * 10.0 ** random.integers(-3, 4)
    rows = rows_of(np.zeros((1, length)), target)
    assert errors_of(output, rows) == pytest.approx(oracle.errors(output, target), rel=1e-13)
    assert product(rows.target, 0, rows.mask, 0, length) == pytest.approx(
        math.fsum(target), rel=1e-12, abs=1e-12 * abs(target).sum()
    )
    assert rows.facts == pytest.approx([target.mean(), (target**2).mean()], rel=1e-12, abs=1e-12 * abs(target).mean())


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e200])
@pytest.mark.parametrize("row", [0, 15, 16, 20])
def test_one_value_that_is_not_finite_makes_both_errors_infinite(bad, row):
    rows = rows_of(np.zeros((1, 21)), np.ones(21))
    output = np.zeros(21)
    output[row] = bad
    assert errors_of(output, rows) == [math.inf, math.inf]


def test_what_stands_beyond_the_last_row_does_not_count():
    rows = rows_of(np.zeros((1, 21)), np.ones(21))
    assert errors_of(np.zeros(21), rows, beyond=1e100) == [1.0, 1.0]


def terms_fitted(terms, target):
    """Return `scale` for the given terms, and the values of their combination (R,); the padding has other values."""
    rows = rows_of(np.zeros((1, len(target))), target)
    work = empty_work(8, rows.length)
    work.terms[: len(terms)] = np.arange(len(terms))
    work.values[:] = 1e9
    work.values[: len(terms), : rows.length] = terms
    scale = np.zeros(1 + MOST_TERMS)
    fit_terms(len(terms), rows, work, scale)
    assert (work.residual[0, rows.length :] == 0.0).all()
    left = work.residual.copy()
    residual_of(len(terms), rows, work, scale)
    size = np.abs(target).max() + np.abs(scale[1 : 1 + len(terms), None] * terms).max()
    np.testing.assert_allclose(work.residual, left, atol=1e-12 * size)
    return scale, target - left[0, : rows.length]


@pytest.mark.slow
@QUICK
@given(st.integers(1, MOST_TERMS), st.integers(6, 50), st.integers(0, 2**32 - 1))
def test_coefficients_are_those_of_least_squares(number, length, seed):
    random = np.random.default_rng(seed)
    terms, target = random.normal(size=(number, length)) + random.normal(size=(number, 1)), random.normal(size=length)
    scale, output = terms_fitted(terms, target)
    expected, nearest = oracle.least_squares(terms, target)
    np.testing.assert_allclose(scale[: number + 1], expected, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(output, nearest, rtol=1e-7, atol=1e-9)


def test_a_term_that_repeats_earlier_ones_or_is_constant_gets_no_coefficient():
    random = np.random.default_rng(3)
    one, two = random.normal(size=(2, 30))
    target = 2.0 * one - two + 0.5
    scale, output = terms_fitted(np.array([one, two, one + 2.0 * two, np.full(30, 7.3)]), target)
    assert scale == pytest.approx([0.5, 2.0, -1.0, 0.0, 0.0])
    assert output == pytest.approx(target)


def test_large_shifts_cost_no_accuracy():
    """Sums are centred, so that coefficients of terms far from zero, such as years, are accurate."""
    random = np.random.default_rng(4)
    year, other = 1900.0 + random.uniform(0, 20, 60), random.normal(size=60)
    scale, _ = terms_fitted(np.array([year, other]), 0.25 * year - 3.0 * other)
    assert scale[1:3] == pytest.approx([0.25, -3.0], rel=1e-11)


CASES = {
    "decay": ([X, 0.4, (MULTIPLY, 0, 1), (NEGATE, 2), (EXP, 3)], lambda x, y: 3.0 * np.exp(-0.9 * x) - 1.0),
    "saturation": ([X, 0.4, (ADD, 0, 1), Y, (DIVIDE, 3, 2)], lambda x, y: 2.0 * y / (x + 1.7) + 0.5),
    "phase": ([X, 1.1, (MULTIPLY, 0, 1), 0.1, (ADD, 2, 3), (SIN, 4)], lambda x, y: 1.5 * np.sin(1.2 * x + 0.3) - y * 0),
    "two terms": (
        [X, 0.7, (MULTIPLY, 0, 1), (COS, 2), Y, (SQRT, 4), (SUBTRACT, 3, 5)],
        lambda x, y: 0.3 * np.cos(0.8 * x) + 4.0 * np.sqrt(y) - 2.0,
    ),
    "logarithm": ([X, 0.5, (ADD, 0, 1), (LOG, 2)], lambda x, y: -2.0 * np.log(x + 0.9) + 3.0),
}


@pytest.mark.parametrize("case", CASES)
def test_known_constants_are_found_to_many_digits(case):
    nodes, truth = CASES[case]
    inputs = random_inputs(5)
    target = truth(*inputs)
    _, _, absolute, squared, _ = fitted(program_of(nodes), inputs, target, steps=30)
    assert absolute < 1e-10 * target.std()
    assert squared < 1e-20 * target.var()


SUPERFLUOUS = {
    "a factor that the exponential's shift repeats": (
        [X, -0.4, (MULTIPLY, 0, 1), 0.3, (ADD, 2, 3), (EXP, 4)],
        {3},
        lambda x, y: 3.0 * np.exp(-0.9 * x) - 1.0,
    ),
    "a factor within a product": (
        [X, 1.1, (MULTIPLY, 0, 1), (SIN, 2), 0.7, (MULTIPLY, 0, 4), (MULTIPLY, 3, 5)],
        {4},
        lambda x, y: 3.0 * x * np.sin(1.4 * x) - 1.0,
    ),
    "two of them": (
        [X, 1.4, (MULTIPLY, 0, 1), 0.7, (MULTIPLY, 0, 3), (MULTIPLY, 2, 4), 1.5, (MULTIPLY, 0, 6), (SIN, 7),
         (MULTIPLY, 8, 5)],
        {1, 3},
        lambda x, y: 2.0 * x * x * np.sin(1.8 * x) + 0.5,
    ),
    "a shift that the logarithm's factor repeats": (
        [X, 1.4, (ADD, 0, 1), 2.0, (MULTIPLY, 2, 3), (LOG, 4)],
        {3},
        lambda x, y: 2.0 * np.log(x + 0.7) + 0.5,
    ),
}  # fmt: skip


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("case", SUPERFLUOUS)
def test_constants_that_coefficients_make_superfluous_stay_and_the_others_are_found(case, seed):
    """After projection their columns are only rounding errors; a step along them would spoil all other constants."""
    nodes, superfluous, truth = SUPERFLUOUS[case]
    inputs = random_inputs(seed)
    target, program = truth(*inputs), program_of(nodes)
    after, _, absolute, _, _ = fitted(program, inputs, target, steps=30)
    assert absolute < 1e-10 * target.std()
    stayed = {i for i in np.flatnonzero(program.operators == CONSTANT) if after.constants[i] == program.constants[i]}
    assert stayed == superfluous


def jacobian_of(program, inputs, target, options):
    """Return (Kaufman's columns, their fitted nodes, gradient, matrix) at the program's constants."""
    tape, count = tape_of(program)
    rows, work = rows_of(inputs, target), empty_work(SPACE, len(target))
    scale, result = np.zeros(1 + MOST_TERMS), np.zeros(2)
    fit(tape, count, rows, options, 100, 1, math.inf, work, scale, result)
    fitted_nodes = [int(i) for i in np.flatnonzero(program.operators == CONSTANT) if i in work.fitted.tolist()]
    size = len(fitted_nodes)
    assert (work.columns[:size, len(target) :] == 0.0).all()
    lower = np.tril(work.matrix[:size, :size])
    return work.columns[:size, : len(target)], fitted_nodes, work.gradient[:size], lower + np.tril(lower, -1).T


@pytest.mark.parametrize("rows", [16, 40, 45])
@pytest.mark.parametrize("case", CASES)
def test_the_columns_are_derivatives_less_what_terms_can_express(case, rows):
    """Expected: difference quotients with fixed coefficients, minus numpy's least-squares projection (Kaufman 1975)."""
    nodes, truth = CASES[case]
    inputs, program = random_inputs(11, rows), program_of(nodes)
    target = truth(*inputs) + np.random.default_rng(12).normal(size=rows)
    columns, fitted_nodes, gradient, matrix = jacobian_of(program, inputs, target, SCALED)
    terms = sorted(top_level_terms(program, SCALED.terms))
    values = node_values(program, inputs)
    scale, nearest = oracle.least_squares(values[terms], target)
    for k, node in enumerate(fitted_nodes):
        step = 1e-6
        ahead, behind = (
            scale[1:] @ node_values(oracle.with_constant(program, node, by), inputs)[terms] for by in (step, -step)
        )
        slope = (ahead - behind) / (2.0 * step)
        expected = slope - oracle.least_squares(values[terms], slope)[1]
        np.testing.assert_allclose(columns[k], expected, rtol=1e-5, atol=1e-7 * np.abs(slope).max())
    np.testing.assert_allclose(gradient, -columns @ (target - nearest), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(matrix, columns @ columns.T, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("rows", [40, 45])
@pytest.mark.parametrize("case", CASES)
def test_with_noise_the_least_squares_are_those_of_another_solver(case, rows):
    """The fit uses variable projection; the other solver fits all parameters at once, from the same initial values."""
    nodes, truth = CASES[case]
    inputs, program = random_inputs(13, rows), program_of(nodes)
    clean = truth(*inputs)
    target = clean + 0.05 * clean.std() * np.random.default_rng(14).normal(size=rows)
    after, scale, _, squared, _ = fitted(program, inputs, target, steps=100)
    constants, coefficients, least = oracle.best(program, inputs, target, sorted(top_level_terms(program, 3)))
    assert squared == pytest.approx(least, rel=1e-3)
    assert squared <= least * (1.0 + 1e-3)
    moved = np.flatnonzero(after.constants != program.constants)
    np.testing.assert_allclose(after.constants[moved], constants[moved], rtol=0.1, atol=0.05)
    assert scale[0] == pytest.approx(coefficients[0], rel=0.3, abs=0.1)


def test_without_terms_every_constant_is_fitted_in_its_place():
    nodes = [X, 1.5, (MULTIPLY, 0, 1), 0.5, (ADD, 2, 3)]
    inputs = random_inputs(6)
    program, scale, absolute, _, _ = fitted(program_of(nodes), inputs, 3.25 * inputs[0] - 2.0, AS_IT_STANDS)
    assert program.constants[[1, 3]] == pytest.approx([3.25, -2.0])
    assert scale.tolist() == [0.0, 1.0, 0.0, 0.0, 0.0]
    assert absolute < 1e-10


@QUICK
@given(programs(), st.integers(0, 8), st.sampled_from([SCALED, AS_IT_STANDS]), st.integers(0, 2**32 - 1))
def test_a_fit_never_increases_the_squared_error_and_counts_what_it_computes(program, steps, options, seed):
    random = np.random.default_rng(seed)
    inputs, target = random.uniform(-3.0, 3.0, (len(NAMES), 20)), random.normal(size=20)
    _, _, _, before, once = fitted(program, inputs, target, options, steps=0)
    after, scale, absolute, squared, used = fitted(program, inputs, target, options, steps=steps)
    assert once == 20
    assert squared <= before
    assert used % 20 == 0
    assert 1 <= used // 20 <= 1 + 3 * steps
    tape, count = tape_of(after)
    rows, work, result = rows_of(inputs, target), empty_work(SPACE, 20), np.zeros(2)
    work.number[0] = collect_terms(tape, count, options.terms, work.terms)
    tape.wanted[:count] = True
    measure_tape(tape, count, rows, False, False, work, scale, result)
    as_it_stands = (result[0], result[1])
    if options.terms == 0:
        assert as_it_stands == (absolute, squared)
    elif math.isfinite(squared):
        size = np.abs(scale[1:, None] * work.values[work.terms[:MOST_TERMS], :20]).max()
        assert as_it_stands[0] == pytest.approx(absolute, rel=1e-9, abs=1e-13 * size)


@pytest.mark.parametrize("length", [1, 15, 16, 17, 31, 45])
@pytest.mark.parametrize("options", [SCALED, AS_IT_STANDS])
def test_padding_never_counts(length, options):
    """Every bit of the fit stays the same for any finite numbers in the padding."""
    nodes = [X, 0.7, (MULTIPLY, 0, 1), (COS, 2), Y, (SQRT, 4), (MULTIPLY, 3, 5), 0.4, (ADD, 4, 7), (ADD, 6, 8)]
    inputs, target = random_inputs(15, length), np.random.default_rng(16).normal(size=length)
    fits = []
    for beyond in (None, 2.5, 0.01):
        rows = rows_of(inputs, target)
        assert rows.mask.tolist() == [[1.0] * length + [0.0] * (rows.mask.shape[1] - length)]
        if beyond is not None:
            rows.inputs[:, length:], rows.target[:, length:] = beyond, 1e3 * beyond
        tape, count = tape_of(program_of(nodes))
        work, scale, result = empty_work(SPACE, length), np.zeros(1 + MOST_TERMS), np.zeros(2)
        used = fit(tape, count, rows, options, 100, 6, math.inf, work, scale, result)
        fits.append((used, tape.constants[:count].tolist(), scale.tolist(), result.tolist()))
    assert fits[0] == fits[1] == fits[2]


def test_the_count_of_point_evaluations_is_the_documented_one():
    """The count per row is 1 for the first values; then for each step 2 for the gradient and 1 for the trial.

    After a failed step the gradient is not computed again.
    """
    inputs = random_inputs(7, rows=30)
    line = program_of([X, 1.0, (MULTIPLY, 0, 1)])
    assert fitted(line, inputs, inputs[0], AS_IT_STANDS)[4] == 30  # exact before any step
    assert fitted(line, inputs, 2.0 * inputs[0], AS_IT_STANDS, steps=1)[4] == 30 + 60 + 30
    assert fitted(line, inputs, 2.0 * inputs[0], SCALED, steps=9)[4] == 30  # no constant is inside the term
    assert fitted(program_of([X, (SIN, 0)]), inputs, inputs[1], SCALED, steps=9)[4] == 30


def test_a_program_that_is_not_finite_is_left_as_it_is():
    program = program_of([X, -1.0, (ADD, 0, 1), (SQRT, 2), 2.0, (MULTIPLY, 2, 4), (MULTIPLY, 3, 5)])
    inputs = random_inputs(9)
    after, _, absolute, squared, used = fitted(program, inputs, inputs[1], AS_IT_STANDS)
    assert after == program
    assert (absolute, squared) == (math.inf, math.inf)
    assert used == inputs.shape[1]
