"""Like terms under one constant."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from atoll.expression.evaluation import values_of
from atoll_coordinator.model.structure.algebra import tidied
from atoll_coordinator.model.structure.like_terms import gathered
from tests.unit.coordinator.model.fitting import parsed, shown

INPUTS = np.random.default_rng(1).uniform(0.5, 2.0, (2, 30))
CASES = {
    "x + x": "2.0*x",
    "(3.0 - (x + y + y))*x": "(3.0 - x - 2.0*y)*x",
    "2.0*x - y + x": "3.0*x - y",
    "sin(x + y + y) + 1.5": "sin(x + 2.0*y) + 1.5",
    "x*y - 0.5*x*y": None,
    "x*y + y*(x + x)": None,
    "-(x + x) - x": "-3.0*x",
    "x - 0.25*y + y - x": "0.75*y",
    "1.5 + x + 2.5": "4.0 + x",
}


@pytest.mark.parametrize("text", CASES)
def test_terms_that_differ_by_a_factor_are_one(text):
    program = parsed(text)
    made = gathered(program)
    assert values_of(made, INPUTS) == pytest.approx(values_of(program, INPUTS), rel=1e-12)
    if CASES[text] is not None:
        assert sorted(shown(made)) == sorted(shown(tidied(parsed(CASES[text]))))


@pytest.mark.parametrize("text", ["3.0*x - 2.0*x*y - x*x", "x", "2.5", "sin(x) - x/(1.5 + y)"])
def test_nothing_changes_where_all_terms_differ(text):
    assert gathered(parsed(text)) == parsed(text)


PARTS = ("x", "y", "0.5*x", "-y", "sin(x + x)", "(x + y - x)*y", "1.25", "x*y")


@settings(max_examples=40, deadline=None)
@given(parts=st.lists(st.sampled_from(PARTS), min_size=1, max_size=5))
def test_the_function_stays(parts):
    program = parsed(" + ".join(f"({part})" for part in parts))
    assert values_of(gathered(program), INPUTS) == pytest.approx(values_of(program, INPUTS), rel=1e-12, abs=1e-12)
