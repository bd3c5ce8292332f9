"""SRBench's rule and the strict one: what they credit, and that no expression holds them up."""

import numpy as np
import pytest

from atoll_core.errors import UsageError
from benchmarks.judging.rules import NO_EQUATION
from benchmarks.peers import srbench
from benchmarks.peers.srbench import Comparer, assess, compare_strictly
from tests.unit.benchmarks.peers.equivalents import EQUIVALENTS, OTHERS, OVERCREDITED, UNCREDITED, rows_of


@pytest.fixture(scope="module")
def comparer():
    comparer = Comparer()
    yield comparer
    comparer.close()


@pytest.fixture(autouse=True)
def _shared(monkeypatch, comparer):
    monkeypatch.setattr(srbench, "comparer", lambda: comparer)


def judged(name, form):
    truth = EQUIVALENTS[name][0]
    arguments = (form, truth, *rows_of(name))
    return assess(*arguments).is_right, compare_strictly(*arguments[:3]).is_right


@pytest.mark.parametrize("name", EQUIVALENTS)
def test_the_strict_rule_judges_all_forms(name):
    truth, columns = EQUIVALENTS[name][0], rows_of(name)[0]
    right = [*EQUIVALENTS[name], *([UNCREDITED[name]] if name in UNCREDITED else [])]
    wrong = [*OTHERS[name], *([OVERCREDITED[name]] if name in OVERCREDITED else [])]
    for form in (*right, *wrong):
        assert compare_strictly(form, truth, columns).is_right is (form in right), form


@pytest.mark.parametrize("name", ["predprey2", "vdp1"])
def test_a_float_that_is_left_over_costs_the_credit_of_srbench(name):
    assert judged(name, UNCREDITED[name]) == (False, True)


def test_a_model_that_is_not_finite_is_not_solved():
    columns, labels = rows_of("lv1")
    assert assess("x/(y - y)", "x", columns, labels).r_squared == -np.inf


def test_no_model_is_not_solved():
    assert assess(None, "x", *rows_of("lv1")) == NO_EQUATION


def test_text_that_is_no_expression_is_refused():
    with pytest.raises(UsageError):
        assess("__import__('os')", "x", *rows_of("lv1"))


@pytest.mark.slow
def test_a_comparison_that_takes_too_long_is_no_credit_and_the_next_one_works():
    impatient = Comparer(0.001)
    try:
        for _ in range(2):
            assert assess("x*(3 - 2*y - x)", EQUIVALENTS["lv1"][0], *rows_of("lv1"), impatient).reason == (
                "sympy did not answer in time"
            )
    finally:
        impatient.close()
