"""Programs as sums of products: multiplied out, divided by numbers; none where there is a function or a quotient."""

import pytest

from atoll_coordinator.model.sparse.products import products_of
from atoll_core.expression.text.parsing import from_infix

NAMES = ("x", "y", "z")


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
    factors = products_of(from_infix(text, NAMES), 4)
    assert ["".join(NAMES[variable] for variable in term) for term in factors] == products


@pytest.mark.parametrize("text", ["sin(x)", "x/y", "x + 1/(y + 2)", "x*x*x*y*z", "sin(x)*0 + cos(y)"])
def test_other_functions_and_higher_degrees_are_none(text):
    assert products_of(from_infix(text, NAMES), 4) is None
