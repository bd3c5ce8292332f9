"""Table I as a benchmark: what is sought, when a run has converged, and what the runs of a row come to."""

import json
import math

import numpy as np
import pytest

from atoll_core.expression.text.parsing import from_infix
from benchmarks.paper import table1
from benchmarks.paper.published import ROWS
from benchmarks.paper.table1 import Run, Task, largest_error, main, run, summary

X = np.linspace(0.1, 6.2, 200)


def program(text):
    return from_infix(text, ("x",))


def ended(row="P4", preset="default", *, evaluations=1000, converged=True, seed=0):
    task = Task(row, preset, seed, ROWS[row].budget)
    return Run(task, converged, evaluations, 10, "x" if converged else None, 1 if converged else None)


def test_the_error_is_the_largest_one_and_infinite_where_there_is_none():
    assert largest_error(program("x + 1"), X, X) == pytest.approx(1.0)
    assert largest_error(program("log(x - 3)"), X, X) == math.inf


def test_a_row_is_summed_up_by_the_share_of_its_runs_within_budget_and_mark():
    runs = [ended(evaluations=250_000), ended(evaluations=400_000), ended(converged=False), ended(evaluations=100)]
    summed = summary(ROWS["P4"], "default", runs)
    assert (summed.runs, summed.converged, summed.marked, summed.median, summed.most) == (
        4,
        75.0,
        50.0,
        250_000.0,
        None,
    )
    assert not summed.is_met
    assert summary(ROWS["P4"], "default", [ended()]).is_met


def test_a_run_ends_when_it_converges_and_is_the_same_again():
    task = Task("P2", "default", 100, 500_000)
    judged = run(task)
    assert judged.converged
    assert judged.evaluations < 100_000
    assert largest_error(program(judged.expression), X, X**2 + X) < 1e-6
    assert run(task) == judged


def test_the_table_and_the_file_are_made_of_the_same_runs(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(
        table1, "in_parallel", lambda function, tasks, _: [ended(task.row, task.preset) for task in tasks]
    )
    out = tmp_path / "t.json"
    options = ["--row", "P4", "--row", "gaussian", "--seeds", "0-1", "--out", str(out)]
    assert main(options) == 0
    assert "at or above" in capsys.readouterr().out
    written = json.loads(out.read_text("utf-8"))
    assert [summary["converged"] for summary in written["summaries"]] == [100.0] * 4
    assert len(written["runs"]) == 8
