"""PySINDy's models are read and judged as ours are."""

import dataclasses

import pytest

from benchmarks.noise.data import Key, case
from benchmarks.noise.judging import outcome
from benchmarks.peers import pysindy_models
from benchmarks.peers.pysindy_models import WAVES, WEAK, as_infix, solve

KEY = Key(WEAK, "bar_magnets", 0.0, 100)


def test_terms_become_our_expressions():
    terms = ["1", "x", "x^2 y", "sin(1 x)", "cos(2 x) sin(1 y)"]
    text = "0.5 + -2.0*x**2*y + 1.5*sin(1*x) + 3.0*cos(2*x)*sin(1*y)"
    assert as_infix(terms, [0.5, 0.0, -2.0, 1.5, 3.0]) == text
    assert as_infix(["x"], [0.0]) == "0.0"


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("method", [WAVES, WEAK])
def test_an_equation_within_its_library_is_found(method, monkeypatch):
    pytest.importorskip("pysindy")
    monkeypatch.setattr(pysindy_models, "PLAIN_LIBRARIES", ())
    monkeypatch.setattr(pysindy_models, "WAVY_LIBRARIES", ((1, 1, True),))
    monkeypatch.setattr(pysindy_models, "THRESHOLDS", (0.07,))
    key = dataclasses.replace(KEY, method=method)
    judgement = outcome(key, case(key), solve(method, key.seed, case(key)), {})
    assert all(equation.in_form for equation in judgement.equations)
    assert max(equation.constants_error for equation in judgement.equations) < 0.05
