"""Laws of many variables on derivatives whose errors differ from row to row."""

import numpy as np
import pytest

from atoll_coordinator.model.sparse.rates.rate_laws import find_rate_laws
from atoll_coordinator.model.sparse.rates.rate_rows import RateRows
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.operators import BY_NAME
from atoll_core.expression.program import constant_places
from atoll_core.expression.text.parsing import from_infix

OPERATORS = {BY_NAME[name].code for name in ("+", "-", "*", "/")}
NAMES = tuple(f"x{place + 1}" for place in range(7))


def rows_of(law, names=NAMES, count=600):
    """Return rows of a law with errors of very different sizes; some large ones are far larger than they should."""
    generator = np.random.default_rng(4)
    inputs = generator.uniform(0.1, 2.5, (len(names), count))
    exact = values_of(from_infix(law, names), inputs)
    errors = exact.std() * 10.0 ** generator.uniform(-5.0, -1.0, count)
    is_far = (generator.uniform(size=count) < 0.1) & (errors > 1e-3 * exact.std())
    far = np.where(is_far, 100.0, 0.3)
    return RateRows(inputs, exact + errors * far * generator.normal(size=count), errors), exact


@pytest.mark.parametrize(
    ("law", "variables", "constants"),
    [
        ("64*x3 - 16*x3*x6 - 13*x4 + 13*x5 - 100*x4*x7", 7, 5),
        ("128*x3 - 32*x3*x2 - 1.28*x2 - 14.6*x1*x2/(0.0731 + x2*x2*x2*x2)", 3, 5),
    ],
)
def test_the_law_is_found(law, variables, constants):
    rows, exact = rows_of(law, NAMES[:variables])
    (rate_law,) = find_rate_laws(rows, range(variables), OPERATORS)
    assert len(constant_places(rate_law.program)) == constants
    assert np.abs(values_of(rate_law.program, rows.inputs) - exact).max() < 1e-3 * exact.std()
    assert rate_law.is_tested
    assert rate_law.excess <= 1.0


def test_what_is_left_of_a_conserved_amount_saturates():
    rows, exact = rows_of("2*x1*(3 - x2)/(3.1 - x2) - 0.7*x2", NAMES[:2])
    (law,) = find_rate_laws(rows, range(2), OPERATORS)
    assert len(constant_places(law.program)) <= 4
    assert np.abs(values_of(law.program, rows.inputs) - exact).max() < 1e-3 * exact.std()


def test_the_law_of_a_node_has_its_weights_and_no_others():
    rows, exact = rows_of("0.3 - 0.4*x1 - 0.5*tanh(3*x2 + 1.2*x3 - 6)", NAMES[:4])
    (law,) = find_rate_laws(rows, range(4), {*OPERATORS, BY_NAME["tanh"].code})
    sizes = np.sort(np.abs(law.program.constants[constant_places(law.program)]))
    assert sizes == pytest.approx([0.3, 0.4, 0.5, 1.2, 3.0, 6.0], rel=1e-3)
    assert np.abs(values_of(law.program, rows.inputs) - exact).max() < 1e-3 * exact.std()


def test_what_no_short_sum_describes_has_no_law():
    generator = np.random.default_rng(5)
    rows, exact = rows_of("x1 + x2*x3")
    wrong = RateRows(rows.inputs[:3], exact + generator.normal(size=len(exact)), 1e-3 * np.ones(len(exact)))
    assert find_rate_laws(wrong, range(3), OPERATORS - {BY_NAME["/"].code}) == ()


def test_rows_known_as_well_as_the_trusted_ones_are_trusted():
    alike = RateRows(np.ones((1, 10)), np.arange(10.0), np.ones(10))
    assert len(alike.trusted().values) == 10
    different = RateRows(np.ones((1, 10)), np.arange(10.0), 1.0 + np.arange(10.0))
    assert different.trusted().values.tolist() == [0.0, 1.0, 2.0, 3.0]
