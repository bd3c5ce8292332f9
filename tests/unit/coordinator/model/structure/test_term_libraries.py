"""Libraries of terms, and their sums."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from atoll_coordinator.model.structure.term_libraries import Divisor, Factor, column_of, fractions, libraries, sum_of
from atoll_coordinator.settings import SETTINGS
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.operators import ADD, BY_NAME, COS, DIVIDE, MULTIPLY, SIN, SUBTRACT
from atoll_core.expression.program import constant_places

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
    for terms in libraries(range(variables), [operator.code for operator in BY_NAME.values()]):
        assert len(terms) <= SETTINGS.structure.largest_library
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


ALLOWED = [operator.code for operator in BY_NAME.values()]


def test_products_that_saturate_and_what_is_divided_by_a_variable():
    over_x, over_y = (Factor(v, divisor=Divisor(v, 1, (2.0, 3.0)[v])) for v in (0, 1))
    square_x, square_y = (Factor(v, divisor=Divisor(v, 2, (4.0, 9.0)[v])) for v in (0, 1))
    terms_listed = list(fractions([0, 1], PLAIN_AND_DIVIDE, [2.0, 3.0]))
    expected = []
    for own, other, under in ((X, Y, over_x), (X, Y, square_x), (Y, X, over_y), (Y, X, square_y)):
        expected += [[*SQUARES, (other, own, under)], [*SQUARES, (own, under), (other, own, under)]]
    assert terms_listed == expected
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


def test_a_term_whose_divisor_vanishes_has_no_value_and_warns_of_nothing():
    inputs = np.array([[0.0, 1.0, 2.0], [0.0, 3.0, 4.0]])
    assert np.isnan(column_of((Factor(1), Factor(0, divisor=Divisor(0))), inputs)).all()
    assert np.isnan(column_of((Factor(0, divisor=Divisor(0)), Factor(1)), inputs)).all()
