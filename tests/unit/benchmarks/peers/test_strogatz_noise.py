"""Noise on the labels: how results are judged."""

import numpy as np
import pytest

from benchmarks.judging.rules import NO_EQUATION, Form
from benchmarks.peers import strogatz_noise
from benchmarks.peers.strogatz_files import NAMES, rows_of, split
from benchmarks.peers.strogatz_noise import outcome

TRUTH = "2*y - x*y - y**2"


@pytest.fixture
def folder(tmp_path):
    generator = np.random.default_rng(0)
    x, y = generator.uniform(0.5, 4.0, (2, 400))
    lines = [f"{2 * b - a * b - b * b!r},{a!r},{b!r}" for a, b in zip(x.tolist(), y.tolist(), strict=True)]
    for name in NAMES:
        (tmp_path / f"{name}.csv").write_text("\n".join(["label,x,y", *lines]) + "\n")
    return tmp_path


@pytest.fixture(autouse=True)
def _quick_rule(monkeypatch):
    """Sympy takes a second to load, and is tested elsewhere."""

    def assess(text, truth, columns, labels):
        return Form("right" if text == truth else "other", reason="as told", r_squared=0.9) if text else NO_EQUATION

    monkeypatch.setattr(strogatz_noise, "assess", assess)


def result(expression, *others):
    front = [{"complexity": 5 + index, "expression": text} for index, text in enumerate((*others, expression)) if text]
    equation = {
        "expression": expression, "complexity": 11, "why": "time", "point_evaluations": 1000, "front": front
    }  # fmt: skip
    return {"equations": [equation], "search_seconds": 1.0, "seconds": 2.0}


def judged(folder, answer):
    return outcome(answer, split(rows_of(folder, "lv2"), "lv2", 0, 0.01), ("lv2", 0, 0.01), TRUTH)


def test_an_equation_is_judged_by_both_rules(folder):
    judgement = judged(folder, result("y*(2 - x - y*1.0005)", "x", "y*(2 - x)"))
    assert (judgement.srbench, judgement.strict, judgement.on_front) == (False, True, 7)
    assert judgement.constants_error == pytest.approx(5e-4, rel=1e-3)
    assert judged(folder, result(TRUTH)).srbench
