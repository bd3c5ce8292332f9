"""Operon's models are read as ours are, without the offset that its scaling always adds."""

import pytest

from benchmarks.corpus.cases import Key, make_case
from benchmarks.judging.forms import judge_form
from benchmarks.peers import operon_models
from benchmarks.peers.operon_models import solve, without_small_offset


def test_only_a_small_offset_is_left_out():
    assert without_small_offset("(0.001 + (2.0 * x))", 0.01) == "2.0 * x"
    assert without_small_offset("((-0.001) + (2.0 * x))", 0.01) == "2.0 * x"
    assert without_small_offset("(0.1 + (2.0 * x))", 0.01) == "(0.1 + (2.0 * x))"
    assert without_small_offset("(y + (2.0 * x))", 0.01) == "(y + (2.0 * x))"


def test_a_law_is_found_and_read(monkeypatch):
    pytest.importorskip("pyoperon")
    monkeypatch.setattr(operon_models, "EVALUATIONS", 50_000)
    case = make_case(Key("lotka_volterra", 2, 1, "even", "noise-1e-4", 0))
    answer = solve(case.table, ("+", "-", "*", "/"), 0)
    for equation in answer["equations"]:
        truth = case.system.truths[equation["variable"]]
        assert equation["expression"] == equation["front"][0]["expression"]
        assert any(judge_form(member["expression"], truth, case.clean).is_right for member in equation["front"])
