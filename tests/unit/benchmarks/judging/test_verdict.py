"""Verdicts on the equations of a result: what counts as found, and what is said of a miss."""

import numpy as np
import pytest

from atoll_core.data.dataset import Dataset, Target
from benchmarks.judging.verdict import COLUMNS, Question, judged, miss

TRUTH = "3*x - x*y"


def question(singular=()):
    x, y = np.linspace(0.5, 2.0, 40), np.cos(np.linspace(0.0, 3.0, 40))
    values = 3 * x - x * y
    target = Target("x", "dx/dt", values, 1e-12, float(values.std()))
    dataset = Dataset(("x", "y"), np.array([x, y]), (target,), {"x": "x", "y": "y"})
    return Question("some system", 4, {"x": TRUTH}, dataset, frozenset(singular))


def result(expression, front=()):
    equation = {
        "variable": "x", "lhs": "dx/dt", "expression": expression, "complexity": 7, "normalized_error": 1e-11,
        "derivative_floor": 1e-12, "target_error": 1e-9, "converged": True, "why": "target", "epoch": 2,
        "generation": 130, "point_evaluations": 12_000, "seconds": 0.25,
        "front": [{"expression": text, "complexity": size} for text, size in front],
    }  # fmt: skip
    return {"equations": [equation], "search_seconds": 0.3, "seconds": 0.7, "digest": "abc"}


def verdict(expression, front=(), singular=()):
    (only,) = judged(question(singular), result(expression, front))
    return only


def test_the_true_form_counts_as_found():
    it = verdict("x*(3.001 - y)")
    assert it.found
    assert it.exact
    assert it.constants_error == pytest.approx(1e-3 / 3, rel=1e-6)
    assert it.exact_on_front is None


def test_a_wrong_form_is_a_miss_and_the_front_is_searched_for_the_true_one():
    it = verdict("3*x - x*y + 0.01", front=[("x", 1), ("x*(3 - y)", 5), ("x*(3 - y)*1.0", 7)])
    assert not it.found
    assert it.exact_on_front == 5
    assert "converged" in miss(it)
    assert "size 5 of the front" in miss(it)


def test_no_equation_is_a_miss():
    it = verdict(None)
    assert not it.found
    assert it.reason == "no equation was found"


@pytest.mark.parametrize(("expression", "found"), [("3.01*x - x*y", True), ("3*x - 1.02*x*y", True), ("3.9*x", False)])
def test_beside_a_singularity_the_function_error_decides(expression, found):
    assert verdict(expression, singular=["x"]).found is found


def test_a_row_has_a_cell_for_each_head():
    assert len(COLUMNS.row(verdict("x"))) == len(COLUMNS.heads)
