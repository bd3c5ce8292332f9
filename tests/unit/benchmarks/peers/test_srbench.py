"""SRBench's rule and the strict one: what they credit, and that no expression holds them up."""

import numpy as np
import pytest

from atoll_core.errors import UsageError
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.text.parsing import from_infix
from benchmarks.peers.srbench import Comparer, assess, compare_strictly

GENERATOR = np.random.default_rng(0)
COLUMNS = {name: GENERATOR.uniform(0.3, 8.0, 200) for name in "xy"}
VOLTERRA, PREDATOR = "3*x - 2*x*y - x**2", "y*(x/(1 + x) - 0.075*y)"


def labels(truth):
    return values_of(from_infix(truth, ("x", "y")), np.array([*COLUMNS.values()]))


@pytest.fixture(scope="module")
def comparer():
    comparer = Comparer()
    yield comparer
    comparer.close()


@pytest.mark.parametrize(
    ("truth", "form", "is_credited", "is_strict"),
    [
        (VOLTERRA, "x*(2.9999999999 - 1.9999999999*y - x)", True, True),
        (PREDATOR, "0.075*y*(13.333333333333*x/(1 + x) - y)", False, True),
        (PREDATOR, "y*(x/(1 + x) - 0.0754*y)", True, False),
        (VOLTERRA, "3*x - 2*x*y - x**2 + 0.1", True, False),
        (VOLTERRA, "3*x - 2.01*x*y - x**2", False, False),
        (VOLTERRA, None, False, False),
    ],
)
def test_what_each_rule_credits(comparer, truth, form, is_credited, is_strict):
    assert assess(form, truth, COLUMNS, labels(truth), comparer).is_right is is_credited
    assert compare_strictly(form, truth, COLUMNS).is_right is is_strict


def test_text_that_is_no_expression_is_refused(comparer):
    with pytest.raises(UsageError):
        assess("__import__('os')", "x", COLUMNS, COLUMNS["x"], comparer)


@pytest.mark.slow
def test_a_comparison_that_takes_too_long_is_no_credit_and_the_next_one_works():
    impatient = Comparer(0.001)
    try:
        for _ in range(2):
            form = assess("x*(3 - 2*y - x)", VOLTERRA, COLUMNS, labels(VOLTERRA), impatient)
            assert form.reason == "sympy did not answer in time"
    finally:
        impatient.close()
