"""Sums of library terms, and how the least significant go one after another."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from atoll.data.dataset import Problem, Target
from atoll.expression.operators import ADD, BY_NAME, COS, DIVIDE, MULTIPLY, SIN, SUBTRACT
from atoll_coordinator.model.regression.gradient import values_of
from atoll_coordinator.model.structure import term_libraries as its_module
from atoll_coordinator.model.structure.rewriting import constant_places
from atoll_coordinator.model.structure.term_libraries import (
    MOST_TERMS,
    Divisor,
    Factor,
    column_of,
    eliminated,
    fractions,
    libraries,
    sum_of,
)
from tests.unit.coordinator.model.shooting.made import SWING, Known, contest, measurements_of, recording

PLAIN = (ADD, MULTIPLY)


X, Y = Factor(0), Factor(1)
SQUARES = [(), (X,), (Y,), (X, X), (X, Y), (Y, Y)]
WAVES = [(Factor(variable, code),) for variable in (0, 1) for code in (SIN, COS)]


def test_polynomials_waves_and_coupled_phases_over_two_variables():
    quadratic, cubic, mixed, products, phases = libraries([0, 1], [*PLAIN, SUBTRACT, SIN, COS])
    assert quadratic == SQUARES
    assert cubic == [*SQUARES, (X, X, X), (X, X, Y), (X, Y, Y), (Y, Y, Y)]
    assert mixed == [*SQUARES, *WAVES]
    assert len(products) == 1 + 4 + 6
    assert phases == [(), *WAVES, *((Factor(0, code, 1, join),) for join in (SUBTRACT, ADD) for code in (SIN, COS))]


@pytest.mark.parametrize("variables", [1, 2, 3, 5, 8])
def test_no_library_is_larger_than_allowed_and_none_has_a_term_twice(variables):
    for terms in libraries(range(variables), [its.code for its in BY_NAME.values()]):
        assert len(terms) <= MOST_TERMS
        assert len(set(terms)) == len(terms)


def test_libraries_use_only_allowed_operators():
    assert list(libraries([0, 1], [MULTIPLY, DIVIDE])) == []
    assert list(libraries([0, 1], [ADD, SIN, COS])) == []
    assert len(list(libraries([0, 1], [*PLAIN, SIN]))) == 2
    assert len(list(libraries([0, 1], [*PLAIN, SIN, COS]))) == 4
    codes = {code for terms in libraries([0, 1], PLAIN) for code in sum_of(terms, [0.5] * len(terms)).operators}
    assert codes <= {0, 1, ADD, MULTIPLY, BY_NAME["square"].code}


ALL = {term for terms in libraries([0, 1], [*PLAIN, SUBTRACT, SIN, COS]) for term in terms}
TERMS = st.lists(st.sampled_from(sorted(ALL, key=repr)), min_size=1, max_size=8, unique=True)


@settings(max_examples=60, deadline=None)
@given(terms=TERMS, seed=st.integers(0, 1000))
def test_a_sum_has_the_values_of_its_columns(terms, seed):
    draw = np.random.default_rng(seed)
    coefficients = draw.uniform(0.1, 0.9, len(terms)) * draw.choice([-3.0, 3.0], len(terms))
    inputs = draw.uniform(-2.0, 2.0, (2, 7))
    program = sum_of(terms, coefficients.tolist())
    columns = np.array([column_of(term, inputs) for term in terms])
    assert values_of(program, inputs) == pytest.approx(coefficients @ columns, rel=1e-9, abs=1e-12)
    assert len(constant_places(program)) == len(terms)


TIMES = 0.1 * np.arange(40.0)
DUFFING = Known(("x", "y"), lambda _, z: [z[1], -1.5 * z[0] - 0.7 * z[0] ** 3 - 0.2 * z[1]])


def duffing(noise):
    """Return the contest of y alone, and its problem as a smoother would make it."""
    whole = recording(DUFFING, ([1.0, 1.0], [-1.5, 0.5], [0.4, -2.0]), TIMES, noise=noise)
    rows = measurements_of(whole, [1])
    alone = contest(DUFFING, rows, 1e-5)
    inputs = np.concatenate([part.smoothed for part in whole.trajectories], axis=1)
    slopes = np.concatenate([part.slopes[1] for part in whole.trajectories])
    labels = slopes + noise * np.random.default_rng(3).standard_normal(len(slopes))
    return alone, Problem(DUFFING.names, inputs, Target("y", "dy/dt", labels, 0.01, float(labels.std()), noise))


def test_elimination_goes_past_the_truth():
    alone, problem = duffing(0.02)
    (terms,) = (each for each in libraries([0, 1], PLAIN) if len(each) == 10)
    found = eliminated(alone, problem, terms)
    assert [len(constant_places(each.programs[0])) for each in found] == list(range(10, 0, -1))
    best = min(found, key=lambda each: each.nats)
    assert sorted(best.shot.system.values.tolist()) == pytest.approx([-1.5, -0.7, -0.2], abs=0.06)
    text = DUFFING.text(best.programs[0])
    assert (text.count("x"), text.count("y")) == (2, 1) or (text.count("x"), text.count("y")) == (4, 1)


def test_where_a_sum_cannot_be_simulated_the_smallest_term_goes(monkeypatch):
    alone, problem = duffing(0.02)
    monkeypatch.setattr(alone, "stand", lambda *_: None)
    seen = []
    monkeypatch.setattr(
        its_module, "_fitted", lambda columns, scales, target: seen.append(len(scales)) or [1.0] * len(scales)
    )
    assert eliminated(alone, problem, [(), (X,), (Y,)]) == []
    assert seen == [3, 2, 1]


def test_columns_that_repeat_each_other_are_no_trouble():
    """With y = 0 the products of y have no part in the fit, and their coefficients none in the program."""
    alone, problem = duffing(0.02)
    inputs = problem.inputs.copy()
    inputs[1] = 0.0
    flat = Problem(problem.names, inputs, problem.target)
    assert eliminated(alone, flat, [(), (X,), (Y,), (X, Y)])


def test_a_linear_system_is_found_alone():
    whole = recording(SWING, ([1.0, 1.0], [-1.5, 0.5]), TIMES, noise=0.01)
    alone = contest(SWING, measurements_of(whole, [1]), 1e-5)
    inputs = np.concatenate([part.smoothed for part in whole.trajectories], axis=1)
    slopes = np.concatenate([part.slopes[1] for part in whole.trajectories])
    problem = Problem(SWING.names, inputs, Target("y", "dy/dt", slopes, 0.01, float(slopes.std()), 0.01))
    found = eliminated(alone, problem, SQUARES)
    best = min(found, key=lambda each: each.nats)
    assert sorted(best.shot.system.values.tolist()) == pytest.approx([-2.0, -0.3], abs=0.03)


ALLOWED = [its.code for its in BY_NAME.values()]


def test_products_that_saturate_and_what_is_divided_by_a_variable():
    over_x, over_y = (Factor(v, divisor=Divisor(v, 1, (2.0, 3.0)[v])) for v in (0, 1))
    square_x, square_y = (Factor(v, divisor=Divisor(v, 2, (4.0, 9.0)[v])) for v in (0, 1))
    found = list(fractions([0, 1], PLAIN_AND_DIVIDE, [2.0, 3.0]))
    expected = []
    for own, other, under in ((X, Y, over_x), (X, Y, square_x), (Y, X, over_y), (Y, X, square_y)):
        expected += [[*SQUARES, (other, own, under)], [*SQUARES, (own, under), (other, own, under)]]
    assert found == expected
    over = Factor(0, divisor=Divisor(0))
    assert list(fractions([0, 1], ALLOWED, [2.0, 3.0]))[8] == [
        (), (X,), (Y,), *WAVES, (over,), (Y, over), *((*wave, over) for wave in WAVES)
    ]  # fmt: skip


PLAIN_AND_DIVIDE = (*PLAIN, DIVIDE)


def test_quotients_use_only_allowed_operators():
    assert list(fractions([0, 1], PLAIN, [1.0, 1.0])) == []
    assert list(fractions([0, 1], [MULTIPLY, DIVIDE], [1.0, 1.0])) == []


@pytest.mark.parametrize("place", range(10))
def test_terms_with_equal_denominators_have_one_constant_in_common(place):
    terms = list(fractions([0, 1], ALLOWED, [2.0, 3.0]))[place]
    coefficients = np.random.default_rng(place).uniform(2.0, 3.0, len(terms))
    inputs = np.random.default_rng(7).uniform(0.5, 2.0, (2, 6))
    program = sum_of(terms, coefficients.tolist())
    columns = np.array([column_of(term, inputs) for term in terms])
    assert values_of(program, inputs) == pytest.approx(coefficients @ columns, rel=1e-9)
    assert len(constant_places(program)) == len(terms) + (place < 8)


PREY = Known(("x", "y"), lambda _, z: [4.0 * z[0] - z[0] ** 2 - z[0] * z[1] / (1.0 + z[0]), 0.5 * z[1]])


def test_elimination_goes_past_a_law_that_saturates():
    """Its half-saturation is found from elsewhere, and goes on from where the fit before has left it."""
    whole = recording(PREY, ([5.0, 1.0], [0.5, 2.0], [2.0, 3.0]), TIMES, noise=0.01)
    alone = contest(PREY, measurements_of(whole, [0]), 1e-5)
    inputs = np.concatenate([part.smoothed for part in whole.trajectories], axis=1)
    slopes = np.concatenate([part.slopes[0] for part in whole.trajectories])
    problem = Problem(PREY.names, inputs, Target("x", "dx/dt", slopes, 0.01, float(slopes.std()), 0.01))
    found = eliminated(alone, problem, next(fractions([0, 1], PLAIN_AND_DIVIDE, [3.0, 3.0])))
    best = min(found, key=lambda each: each.nats)
    assert sorted(best.shot.system.values.tolist()) == pytest.approx([-1.0, -1.0, 1.0, 4.0], abs=0.15)


def test_what_has_no_value_is_left_out():
    alone, problem = duffing(0.02)
    inputs = problem.inputs.copy()
    inputs[1, 0] = 0.0
    flat = Problem(problem.names, inputs, problem.target)
    assert eliminated(alone, flat, [(), (X, Factor(1, divisor=Divisor(1)))]) == []
