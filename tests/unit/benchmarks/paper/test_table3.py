"""Table III: what each search is given, and what the searches for one equation come to."""

import dataclasses
import json
from contextlib import nullcontext

import numpy as np

from benchmarks.harness.systems import TRUTH
from benchmarks.paper import table3
from benchmarks.paper.table3 import (
    Search,
    judged,
    main,
    summed_up,
)

GLIDER_V = ("glider", "v")
SEARCH = Search(
    "glider", "v", "given", 0, exact=True, reason="the same form", expression="-0.05*v**2 - sin(theta)", complexity=8,
    on_front=8, error=1e-10, why="target", epoch=1, point_evaluations=40_000, search_seconds=0.2, seconds=0.5,
    digest="abc",
)  # fmt: skip


def searched(*seconds, **changes):
    return [
        dataclasses.replace(
            SEARCH, seed=seed, search_seconds=took, seconds=2 * took, point_evaluations=int(1e6 * took), **changes
        )
        for seed, took in enumerate(seconds)
    ]


def test_an_equation_is_exact_in_form_and_one_that_is_not_is_looked_for_on_the_front():
    columns = {"v": np.linspace(1.0, 9.0, 200), "theta": np.linspace(-2.0, 30.0, 200)[::-1]}

    def form_of(expression):
        front = [{"complexity": 5, "expression": "v"}, {"complexity": 8, "expression": "-0.05*v**2 - sin(theta)"}]
        shown = {
            "expression": expression, "complexity": 9, "front": front, "normalized_error": 0.1, "why": "time",
            "epoch": 3, "point_evaluations": 7,
        }  # fmt: skip
        result = {"equations": [shown], "search_seconds": 1.0, "seconds": 2.0, "digest": "d"}
        return judged(GLIDER_V, "given", 4, result, columns)

    right, wrong, none = form_of("-(sin(theta) + v*v/20)"), form_of("-0.05*v**2 - cos(theta)"), form_of(None)
    assert (right.exact, right.seed, right.seconds) == (True, 4, 2.0)
    assert (wrong.exact, wrong.on_front) == (False, 8)
    assert "exact at size 8 of the front" in wrong.miss
    assert not none.exact


def test_the_median_counts_a_miss_as_infinitely_long():
    row = summed_up([*searched(0.1, exact=False), *searched(1.0, 4.0)])
    assert (row.right, row.searches, row.seconds, row.job_seconds, row.point_evaluations) == (2, 3, 4.0, 8.0, 4e6)
    assert row.is_found
    assert row.is_ahead


class Told:
    """Answers every search of the glider's first equation with the truth."""

    def solve(self, title, table, config):
        shown = {
            "expression": TRUTH["glider"]["v"] if config.seed else "v", "complexity": 8, "front": [],
            "normalized_error": 0.0, "why": "target", "epoch": 1, "point_evaluations": 1000,
        }  # fmt: skip
        return {"equations": [shown], "search_seconds": 0.2, "seconds": 0.5, "digest": "d"}


def test_all_searches_are_written_and_shown(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(table3, "searching", lambda workers: nullcontext(Told()))
    out = tmp_path / "f.json"
    words = ["--system", "glider", "--only", "v", "--derivatives", "given", "--seeds", "0-2", "--out", str(out)]
    assert main(words) == 0
    assert [search["exact"] for search in json.loads(out.read_text("utf-8"))["runs"]] == [False, True, True]
    printed = capsys.readouterr().out
    assert "2 of 3 exact in form" in printed
    assert "missed:\nglider v given seed 0" in printed
