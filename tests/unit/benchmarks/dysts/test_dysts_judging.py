"""The error of coefficients as the published table has it, the form, and a journal that is read back."""

import numpy as np
import pytest

from benchmarks.dysts.flows import Flow
from benchmarks.dysts.judging import coefficient_error, outcome, polynomial

STATES = ("x", "y")
TRUTH = ("2*x*y - y", "x**2 - 1")


def flow() -> Flow:
    states = np.random.default_rng(0).normal(size=(2, 20, 2))
    x, y = states[..., 0], states[..., 1]
    rates = np.stack([2.0 * x * y - y, x * x - 1.0], axis=-1)
    return Flow("Some", STATES, TRUTH, np.arange(20.0), states, states, rates, 0.5)


def result(*texts: str) -> dict[str, object]:
    equations = [{"variable": state, "expression": text} for state, text in zip(STATES, texts, strict=True)]
    return {"equations": equations, "seconds": 3.0}


def test_products_and_quotients_that_cancel_are_polynomials():
    assert polynomial("(x + y)*(x - y)", STATES) == {(2, 0): 1.0, (0, 2): -1.0}
    assert polynomial("y*x*y/y", STATES) == {(1, 1): 1.0}
    assert polynomial("x/(y + 1)", STATES) is None
    assert polynomial("sin(x)", STATES) is None


def test_the_error_is_the_spectral_norm_of_the_difference_over_that_of_the_truth():
    truth = [{(1, 0): 3.0}, {(0, 1): 4.0}]
    assert coefficient_error([{(1, 0): 3.0}, {(0, 1): 4.4}], truth) == pytest.approx(0.1)
    assert coefficient_error([{(1, 0): 3.0, (2, 0): 0.4}, {(0, 1): 4.0}], truth) == pytest.approx(0.1)
    assert coefficient_error([None, {(0, 1): 4.0}], truth) is None


def test_the_truth_in_other_words_is_exact():
    judgement = outcome(flow(), 0.0, result("(2*x - 1)*y", "(x - 1)*(x + 1)"), {})
    assert judgement.is_exact
    assert judgement.error == pytest.approx(0.0, abs=1e-15)
    assert judgement.rate_error == pytest.approx(0.0, abs=1e-12)


def test_a_term_too_many_is_not_the_form():
    judgement = outcome(flow(), 0.0, result("2*x*y - y + 0.001*x", "x**2 - 1"), {})
    assert judgement.in_form == (False, True)
    assert judgement.error is not None
    assert 0.0 < judgement.error < 0.001
