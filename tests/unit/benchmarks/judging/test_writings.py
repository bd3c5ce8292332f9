"""Nodes as a reader counts them, other dresses of known laws, and what is read from saved results."""

import json

import numpy as np
import pytest

from atoll_core.expression.evaluation import values_of
from atoll_core.expression.text.infix import to_infix
from atoll_core.expression.text.parsing import from_infix
from benchmarks.judging.writings import LAWS, count_nodes, dressed, main, measured, of_result, undressed


@pytest.mark.parametrize(
    ("text", "nodes"),
    [
        ("x", 1),
        ("-x", 1),
        ("-0.1*x", 3),
        ("x**2", 3),
        ("x - (-y)", 3),
        ("cot(phi)*cos(theta)", 5),
        ("10*(y - (x**3/3 - x))", 11),
        ("x*(4 - x - y/(1 + x))", 11),
        ("1e-05*x + 2.5E+3", 5),
        ("exp(-x)", 2),
    ],
)
def test_nodes_are_what_a_reader_meets(text, nodes):
    assert count_nodes(text) == nodes


@pytest.mark.parametrize(("law", "names"), LAWS)
def test_a_dress_has_the_values_of_its_law(law, names):
    program = from_infix(law, names)
    rows = np.random.default_rng(0).uniform(0.3, 1.4, (len(names), 40))
    for seed in range(6):
        other = dressed(program, np.random.default_rng(seed), 3)
        assert to_infix(other, names) != to_infix(program, names)
        assert values_of(other, rows) == pytest.approx(values_of(program, rows), rel=1e-9, abs=1e-9)


@pytest.mark.parametrize(("law", "names"), LAWS)
def test_the_shortest_writing_comes_back_from_any_dress(law, names):
    for seed in range(12):
        found = undressed(law, names, 5000 + seed, 1 + seed % 4)
        assert found.excess <= 0, found


def test_what_cancels_and_quarter_turns_are_seen():
    right = measured("glider", "theta", 1, "v - cos(theta)/v", ("v", "theta"))
    assert (right.nodes, right.paper, right.is_short) == (6, 6, True)
    odd = measured("glider", "theta", 1, "v - v/(v/cos(theta)*v)", ("v", "theta"))
    assert (odd.nodes > odd.shortest, odd.is_short) == (True, False)
    turned = measured("", "x", None, "0.5*cos(x + 1.5707963267948966)", ("x",))
    assert (turned.has_quarter_turn, turned.paper) == (True, None)


def test_saved_results_are_read_and_the_system_is_told_from_its_states(tmp_path, capsys):
    equations = [
        {"variable": "v", "expression": "-sin(theta) - 0.05*v**2"},
        {"variable": "theta", "expression": "v - cos(theta)/v"},
    ]
    result = {"equations": equations, "symbols": {"v": "v", "theta": "theta"}}
    assert [each.paper for each in of_result(result)] == [8, 6]
    one, lines = tmp_path / "result.json", tmp_path / "noise.jsonl"
    one.write_text(json.dumps(result))
    key = {"variant": "plain", "system": "glider", "seed": 3}
    lines.write_text(json.dumps({"head": 1}) + "\n" + json.dumps({"outcome": {"key": key}, "answer": result}))
    assert main(["--results", str(one), str(lines)]) == 0
    assert "4 of 4 have at most as many nodes" in capsys.readouterr().out
