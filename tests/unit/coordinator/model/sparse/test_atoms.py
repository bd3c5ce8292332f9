"""The dictionary of terms: products, shapes and their prices, libraries, sums."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from atoll_coordinator.model.description_length import constant_nats_of, structure_length
from atoll_coordinator.model.sparse.atoms import (
    FUNCTIONS,
    Atom,
    Term,
    polynomial_and_fourier_libraries,
    powers,
    product_of,
    products,
    products_of,
    products_with_functions,
    sum_of,
)
from atoll_coordinator.settings import SETTINGS
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.operators import ADD, BY_NAME, COS, DIVIDE, MULTIPLY, SIN, SUBTRACT, VARIABLE
from atoll_core.expression.program import constant_places
from atoll_core.expression.text.parsing import from_infix
from atoll_core.wire.values import decode_value, encode_value

XYZ = ("x", "y", "z")


@pytest.mark.parametrize(
    ("text", "products"),
    [
        ("10*(y - x)", ["x", "y"]),
        ("x*(28 - z) - y", ["x", "y", "xz"]),
        ("(x + 1)**2/2", ["", "x", "xx"]),
        ("x*y - y*x + z", ["z"]),
        ("-(x*x*y)", ["xxy"]),
    ],
)
def test_products_are_those_of_the_expanded_sum(text, products):
    factors = products_of(from_infix(text, XYZ), 4)
    assert ["".join(XYZ[variable] for variable in term) for term in factors] == products


@pytest.mark.parametrize("text", ["sin(x)", "x/y", "x + 1/(y + 2)", "x*x*x*y*z", "sin(x)*0 + cos(y)"])
def test_other_functions_and_higher_degrees_are_none(text):
    assert products_of(from_infix(text, XYZ), 4) is None


INPUTS = np.random.default_rng(0).uniform(0.5, 2.0, (2, 20))


@pytest.mark.parametrize(
    ("product", "quotient", "text"),
    [
        ((), None, "2.5"),
        ((0, 0), None, "2.5*(x*x)"),
        ((), 1, "2.5/(1.5 + x)"),
        ((0, 1), 1, "2.5*(x*y)/(1.5 + x)"),
        ((1,), 0, "2.5*y/x"),
    ],
)
def test_a_term_costs_what_it_is_written_as(product, quotient, text):
    (shape,) = powers(INPUTS, [product])
    if quotient is not None:  # 1/x, 1/(c + x)
        allowed = [of for of in products_with_functions(INPUTS, (0, 1), {BY_NAME["/"].code}) if of.argument == (0, 0)]
        shape = next(of for of in allowed if of.factors == product and of.has_constant == bool(quotient))
    program = from_infix(text, ("x", "y"))
    expected = structure_length(program) + len(constant_places(program)) * constant_nats_of(100)
    assert shape.price(100) == pytest.approx(expected)


def test_products_are_powers_in_the_order_of_degrees():
    assert products((0, 1), 2) == [(), (0,), (1,), (0, 0), (0, 1), (1, 1)]
    assert powers(INPUTS, [(0, 1)])[0].product == pytest.approx(INPUTS[0] * INPUTS[1])


def test_quotients_keep_their_products_where_all_functions_are_too_many() -> None:
    inputs = np.random.default_rng(0).uniform(0.1, 1.0, (8, 20))
    quotients = {BY_NAME["/"].code}
    alone = products_with_functions(inputs, range(8), quotients)
    made = products_with_functions(
        inputs, range(8), quotients | {BY_NAME[name].code for name in ("sin", "cos", "exp", "tanh")}
    )
    assert max(len(shape.factors) for shape in alone) == 2
    assert sum(len(shape.factors) == 2 for shape in made) == sum(len(shape.factors) == 2 for shape in alone)
    assert len(made) > len(alone)


PLAIN = (ADD, MULTIPLY)


X, Y = (VARIABLE, 0), (VARIABLE, 1)
SQUARES = [1.0, X, Y, *map(product_of, ((X, X), (X, Y), (Y, Y)))]
WAVES = [(code, variable) for variable in (X, Y) for code in (SIN, COS)]


def test_polynomials_waves_and_coupled_phases_over_two_variables():
    quadratic, cubic, mixed, products, phases = polynomial_and_fourier_libraries([0, 1], [*PLAIN, SUBTRACT, SIN, COS])
    assert quadratic == SQUARES
    assert cubic == [*SQUARES, *map(product_of, ((X, X, X), (X, X, Y), (X, Y, Y), (Y, Y, Y)))]
    assert mixed == [*SQUARES, *WAVES]
    assert len(products) == 1 + 4 + 6
    assert phases == [1.0, *WAVES, *((code, (join, X, Y)) for join in (SUBTRACT, ADD) for code in (SIN, COS))]


@pytest.mark.parametrize("variables", [1, 2, 3, 5, 8])
def test_no_library_is_larger_than_allowed_and_none_has_a_term_twice(variables):
    for terms in polynomial_and_fourier_libraries(range(variables), [operator.code for operator in BY_NAME.values()]):
        assert len(terms) <= SETTINGS.effort.longest_sum
        assert len(set(terms)) == len(terms)


def test_libraries_use_only_allowed_operators():
    assert list(polynomial_and_fourier_libraries([0, 1], [MULTIPLY, DIVIDE])) == []
    assert list(polynomial_and_fourier_libraries([0, 1], [ADD, SIN, COS])) == []
    assert len(list(polynomial_and_fourier_libraries([0, 1], [*PLAIN, SIN]))) == 2
    assert len(list(polynomial_and_fourier_libraries([0, 1], [*PLAIN, SIN, COS]))) == 4
    codes = {
        code
        for terms in polynomial_and_fourier_libraries([0, 1], PLAIN)
        for code in sum_of(terms, [0.5] * len(terms)).operators
    }
    assert codes <= {0, 1, ADD, MULTIPLY, BY_NAME["square"].code}


ALL = {term for terms in polynomial_and_fourier_libraries([0, 1], [*PLAIN, SUBTRACT, SIN, COS]) for term in terms}
TERMS = st.lists(st.sampled_from(sorted(ALL, key=repr)), min_size=1, max_size=8, unique=True)


@settings(max_examples=60, deadline=None)
@given(terms=TERMS, seed=st.integers(0, 1000))
def test_a_sum_has_the_values_of_its_columns(terms, seed):
    draw = np.random.default_rng(seed)
    coefficients = draw.uniform(0.1, 0.9, len(terms)) * draw.choice([-3.0, 3.0], len(terms))
    inputs = draw.uniform(-2.0, 2.0, (2, 7))
    program = sum_of(terms, coefficients.tolist())
    columns = np.array([values_of(sum_of([term], [1.0]), inputs) for term in terms])
    assert values_of(program, inputs) == pytest.approx(coefficients @ columns, rel=1e-9, abs=1e-12)
    assert len(constant_places(program)) == len(terms)


def test_a_term_that_was_sent_has_the_values_and_the_expression_of_its_atom():
    inputs = np.random.default_rng(0).uniform(0.2, 2.0, (2, 30))
    signed = np.vstack([inputs[0], inputs[1] - 1.0])
    operators = {operator.code for operator in BY_NAME.values()}
    met = set()
    for rows in (inputs, signed):
        for shape in [*powers(rows, [(), (0, 1)]), *products_with_functions(rows, (0, 1), operators)]:
            atom = Atom(shape, shape.constants()[-1]).over(rows)
            sent = decode_value(encode_value(Term.of(atom)), Term).over(rows)
            assert np.array_equal(sent.values, atom.values, equal_nan=True)
            assert sent.shape.expression(sent.constant) == atom.shape.expression(atom.constant)
            assert sent.shape.has_constant == atom.shape.has_constant
            met.add(sent.shape.function)
    assert met == {None, *FUNCTIONS.values()}
