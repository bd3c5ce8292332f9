"""Table I as a benchmark: what is sought, when a run has converged, and what the runs of a row come to."""

import json
import math

import numpy as np
import pytest

from atoll_core.expression.text.parsing import from_infix
from atoll_island_worker.evolution.island import Island
from benchmarks.paper import table1
from benchmarks.paper.published import ROWS
from benchmarks.paper.table1 import Run, Task, difference, largest_error, main, run, summary

X = np.linspace(0.1, 6.2, 200)


def program(text):
    return from_infix(text, ("x",))


def ended(row="P4", preset="default", *, evaluations=1000, converged=True, seed=0):
    task = Task(row, preset, seed, ROWS[row].budget)
    return Run(task, converged, evaluations, 10, "x" if converged else None, 1 if converged else None)


@pytest.mark.parametrize("name", ROWS)
def test_a_rows_points_lie_in_its_range_and_its_truth_is_finite_there(name):
    row = ROWS[name]
    x = row.points(3, "points", 500)
    assert row.between[0] <= x.min() < x.max() <= row.between[1]
    assert np.isfinite(row.values(x)).all()


def test_points_differ_by_seed_and_purpose_and_are_the_same_again():
    row = ROWS["P2"]
    first = row.points(0, "points", 20)
    assert (row.points(0, "points", 20) == first).all()
    assert not np.isin(row.points(1, "points", 20), first).any()
    assert not np.isin(row.points(0, "fresh points", 20), first).any()


def test_over_nine_tenths_of_the_gaussians_points_lie_beyond_its_fringe():
    row, deviation = ROWS["gaussian"], math.sqrt(0.5)
    x = row.points(0, "points", row.rows)
    assert (np.abs(x) > 3 * deviation).mean() > 0.9


def test_polynomials_lack_exp_and_the_identity_lacks_cos():
    assert not any("exp" in ROWS[name].operators for name in ROWS if name != "gaussian")
    assert "cos" not in ROWS["cos2x"].operators


def test_the_bar_is_the_better_published_figure():
    assert (ROWS["P5"].bar, ROWS["quintic"].bar, ROWS["gaussian"].bar) == (84.0, 93.9, 2.107e7)


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


def test_the_papers_preset_is_judged_by_what_chance_allows():
    runs = [ended(preset="paper", converged=number < 5) for number in range(10)]
    assert summary(ROWS["P4"], "paper", runs).is_met
    assert not summary(ROWS["P4"], "paper", [ended(preset="paper", converged=False)] * 10).is_met


def test_a_cost_is_met_when_every_run_converged_below_it():
    runs = [ended("gaussian", evaluations=10**6), ended("gaussian", evaluations=2 * 10**7)]
    assert summary(ROWS["gaussian"], "default", runs).is_met
    assert not summary(ROWS["gaussian"], "default", [*runs, ended("gaussian", evaluations=22 * 10**6)]).is_met
    assert not summary(ROWS["gaussian"], "default", [*runs, ended("gaussian", converged=False)]).is_met


def test_a_difference_of_shares_is_given_in_standard_deviations():
    assert difference(100.0, 50, 100.0, 50) == 0.0
    assert difference(60.0, 100, 50.0, 100) == pytest.approx(0.1 / math.sqrt(0.55 * 0.45 * 0.02))


def test_a_run_ends_when_it_converges_and_is_the_same_again():
    task = Task("P2", "default", 100, 500_000)
    judged = run(task)
    assert judged.converged
    assert judged.evaluations < 100_000
    assert largest_error(program(judged.expression), X, X**2 + X) < 1e-6
    assert run(task) == judged


def test_a_run_ends_when_its_evaluations_are_used_up():
    judged = run(Task("sextic", "paper", 100, 30_000))
    assert not judged.converged
    assert 30_000 < judged.evaluations < 45_000


def test_what_an_island_used_until_it_was_looked_at_counts(monkeypatch):
    """With all rows and no fit, two generations of 64 solutions on 20 rows after the first 64 are 3,840 evaluations."""
    looked = []
    advance = Island.advance
    monkeypatch.setattr(Island, "advance", lambda ended, number: looked.append(number) or advance(ended, number))
    judged = run(Task("P5", "paper", 100, 3_000))
    assert looked == [2]
    assert 3_840 <= judged.evaluations < 5_000


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


def test_a_row_that_falls_short_is_an_exit_code(monkeypatch):
    monkeypatch.setattr(table1, "in_parallel", lambda _, tasks, __: [ended(converged=False) for _ in tasks])
    assert main(["--row", "P4", "--preset", "default", "--seeds", "0"]) == 1


@pytest.mark.parametrize("options", [["--row", "P9"], ["--workers", "0"], ["--evaluations", "-3"]])
def test_bad_options_are_refused(options, capsys):
    with pytest.raises(SystemExit) as ended_with:
        main(options)
    assert ended_with.value.code == 2
    assert "Traceback" not in capsys.readouterr().err
