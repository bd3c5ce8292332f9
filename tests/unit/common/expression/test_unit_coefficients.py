"""Factors of one that are not written become constants, as many as are not redundant; the function stays."""

import numpy as np
import pytest

from atoll_core.expression.evaluation import values_of
from atoll_core.expression.program import constant_places, with_constants
from atoll_core.expression.unit_coefficients import make_coefficients_explicit, write_factors
from atoll_core.expression.writing.shortest import shortest
from tests.unit.coordinator.model.fitting import parsed, shown

DRAW = np.random.default_rng(3)
INPUTS = DRAW.uniform(0.5, 2.0, (2, 60))

CASES = {
    "3.0*x - 2.0*x*y - x*x": (("x",), 3),
    "(2.0 - x - y)*y": (("x", "y"), 3),
    "x*(4.0 - x - y/(1.0 + x))": (("x", "y"), 4),
    "0.5*(x - y)": (("y",), 2),
    "cos(x)*cos(y)/sin(x)": (("cot(x)*cos(y)",), 1),
    "-0.1*x": ((), 1),
    "(1.5 + x)*(2.0 - y)": (("y",), 3),
    "y - cos(x)/y": (("y", "cos(x)"), 2),
    "-x/(0.4 + 0.8*x)": ((), 2),
    "y - x/(0.4 + 0.8*x)": (("y",), 3),
    "x/((0.4 + 0.8*x)*(0.3 + y))": ((), 3),
    "x/(0.3 + y*(0.4 + 0.8*x))": ((), 3),
    "x/(0.4 + 0.8*x)**2": ((), 2),
    "(y + x*x)/(0.4 + 0.8*x)": (("x**2",), 3),
}
"""By expression: what has a factor of one, and how many constants there are with these."""


@pytest.mark.parametrize("text", CASES)
def test_terms_without_a_factor_get_one(text):
    terms, count = CASES[text]
    explicit = make_coefficients_explicit(shortest(parsed(text)))
    assert tuple(map(shown, explicit.terms)) == terms
    assert len(explicit.origins) == count == len(constant_places(explicit.program))
    assert sum(origin is None for origin in explicit.origins) == len(terms)


@pytest.mark.parametrize("text", CASES)
def test_the_function_stays_and_the_constants_know_where_they_come_from(text):
    program = shortest(parsed(text))
    explicit = make_coefficients_explicit(program)
    assert values_of(explicit.program, INPUTS) == pytest.approx(values_of(program, INPUTS), rel=1e-13)
    values = program.constants[constant_places(program)].tolist()
    expected = [1.0 if origin is None else values[origin] for origin in explicit.origins]
    assert explicit.program.constants[constant_places(explicit.program)].tolist() == expected
    assert sorted(origin for origin in explicit.origins if origin is not None) == list(range(len(values)))


@pytest.mark.parametrize("text", CASES)
def test_no_constant_is_redundant(text):
    """The derivatives with respect to the constants are linearly independent."""
    explicit = make_coefficients_explicit(shortest(parsed(text))).program
    places = constant_places(explicit)
    columns = []
    for place in places:
        moved = [explicit.constants.copy(), explicit.constants.copy()]
        moved[0][place] += 1e-5
        moved[1][place] -= 1e-5
        high, low = (
            type(explicit)(explicit.operators, explicit.left, explicit.right, constants) for constants in moved
        )
        columns.append((values_of(high, INPUTS) - values_of(low, INPUTS)) / 2e-5)
    unit = np.array([column / np.linalg.norm(column) for column in columns])
    assert np.linalg.svd(unit, compute_uv=False).min() > 1e-4


@pytest.mark.parametrize(
    ("text", "chosen", "expected"),
    [("3.0*x - y + x*y", [0], "3.0*x - 2.0*y + x*y"), ("3.0*x - y + x*y", [1], "3.0*x - y + 2.0*x*y"),
     ("3.0*x - y + x*y", [], "3.0*x - y + x*y"), ("sin(x)", [0], "2.0*sin(x)")],
)  # fmt: skip
def test_chosen_factors_are_written(text, chosen, expected):
    explicit = make_coefficients_explicit(parsed(text))
    numbers = dict(zip(constant_places(explicit.program), explicit.origins, strict=True))
    fitted = with_constants(explicit.program, {place: 2.0 for place, origin in numbers.items() if origin is None})
    made = write_factors(explicit, fitted, chosen)
    assert values_of(made, INPUTS) == pytest.approx(values_of(parsed(expected), INPUTS))
    assert len(constant_places(made)) == len(constant_places(parsed(text))) + len(chosen)
