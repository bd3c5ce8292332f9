"""Noise on the labels: how results are judged, counted and set beside the published rates."""

import dataclasses
import json
from argparse import Namespace

import numpy as np
import pytest

from atoll_core.config import PRESETS
from benchmarks.harness.record import Record
from benchmarks.judging.rules import NO_EQUATION, Form
from benchmarks.peers import strogatz_noise
from benchmarks.peers.strogatz_files import NAMES, rows_of, split
from benchmarks.peers.strogatz_noise import outcome, run

CONFIG = PRESETS["default"].model_copy(update={"data": PRESETS["default"].data.model_copy(update={"target": "label"})})
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


@dataclasses.dataclass
class Told:
    """Answers each search with the same equation."""

    expression: str
    titles: list[str] = dataclasses.field(default_factory=list)

    def solve(self, title, table, config):
        assert table.rows == 300
        self.titles.append(title)
        return result(self.expression)


@pytest.mark.parametrize(("expression", "code"), [(TRUTH, 0), ("x", 1)])
def test_all_files_levels_and_seeds_are_searched(folder, capsys, expression, code):
    options = Namespace(data=folder, file=["lv2"], noise=[0.0, 0.1], seeds=[3, 4])
    told, out = Told(expression), folder / "out.json"
    configs = dict.fromkeys(options.seeds, CONFIG)
    assert run(told, options, configs, {"lv2": TRUTH}, Record("strogatz", [], out)) == code
    assert told.titles == [f"lv2 noise {level} seed {seed}" for level in ("0", "0.1") for seed in (3, 4)]
    contents = json.loads(out.read_text())
    assert len(contents["runs"]) == 4
    assert contents["rates"]["0.1"]["srbench"] == (100.0 if code == 0 else 0.0)
    assert "highest published" in capsys.readouterr().out
