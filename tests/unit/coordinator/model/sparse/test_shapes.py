"""Products with functions: what a term costs in a sum."""

import numpy as np
import pytest

from atoll_coordinator.model.criteria import constant_nats_of, structure_length
from atoll_coordinator.model.sparse.products import products
from atoll_coordinator.model.sparse.shapes import powers, shapes
from atoll_core.expression.operators import BY_NAME
from atoll_core.expression.program import constant_places
from atoll_core.expression.text.parsing import from_infix

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
        allowed = [of for of in shapes(INPUTS, (0,), {BY_NAME["/"].code}, [shape]) if of.argument == (0, 0)]
        (shape,) = (of for of in allowed if of.has_constant == bool(quotient))
    program = from_infix(text, ("x", "y"))
    expected = structure_length(program) + len(constant_places(program)) * constant_nats_of(100)
    assert shape.price(100) == pytest.approx(expected)


def test_products_are_powers_in_the_order_of_degrees():
    assert products((0, 1), 2) == [(), (0,), (1,), (0, 0), (0, 1), (1, 1)]
    assert powers(INPUTS, [(0, 1)])[0].product == pytest.approx(INPUTS[0] * INPUTS[1])
