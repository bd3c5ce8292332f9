"""Readings of the paper as a benchmark: what they change, what is kept of runs, and at which budgets a row agrees."""

import math
from dataclasses import replace

import pytest

from atoll_core.config import PRESETS
from atoll_core.errors import DataError, UsageError
from benchmarks.paper import readings, readings_runs
from benchmarks.paper.readings import Journal, agreement, best_budget, equation_rows, main
from benchmarks.paper.readings_runs import READINGS, Run, Task, config_of, run


def ended(problem, cost, seed=0, budget=1000):
    return Run(Task("paper", problem, seed, budget), cost, cost or budget, 0.5, 0.1, None if cost is None else "x")


@pytest.mark.parametrize("name", READINGS)
def test_every_reading_is_a_valid_configuration_of_its_own(name):
    config = config_of(name, 3, ("+", "*"))
    assert type(config).model_validate(config.model_dump()) == config
    assert (config == config_of("paper", 3, ("+", "*"))) == (name in ("paper", "near"))


def test_reading_paper_is_the_preset():
    chosen = config_of("paper", 0, PRESETS["paper"].space.operators)
    for group in ("space", "evolution", "predictors", "migration"):
        assert getattr(chosen, group) == getattr(PRESETS["paper"], group)


def test_readings_are_joined_and_unknown_ones_refused():
    config = config_of("seldom+scaled", 0, ("+",), islands=2)
    assert (config.migration.generations, config.evolution.scaled_constants) == (10_000, True)
    assert config.evolution.islands == 2
    with pytest.raises(UsageError, match="no reading 'lag'"):
        config_of("seldom+lag", 0, ("+",))


@pytest.mark.parametrize("problem", ["P2", "van_der_pol y"])
def test_a_run_ends_where_it_converges_or_its_budget_does(problem):
    found = run(Task("paper", problem, 1, 40_000_000))
    assert found.cost is not None
    assert found.cost == found.evaluations <= 40_000_000
    short = run(Task("paper", problem, 1, found.cost - 1))
    assert short.cost is None
    assert short.evaluations < found.cost


def test_a_run_that_was_interrupted_goes_on_where_it_was(tmp_path, monkeypatch):
    monkeypatch.setattr(readings_runs, "KEPT_EVERY_S", -1.0)
    small, whole = (Task("relative", "predator_prey y", 1, budget) for budget in (1_000_000, 1_900_000))
    run(small, tmp_path)
    assert len(list(tmp_path.iterdir())) == 1
    resumed = run(whole, tmp_path)
    assert resumed.cost is None
    assert resumed == replace(run(whole), seconds=resumed.seconds)


def test_a_row_agrees_between_two_budgets():
    """62 % of 50 runs in the paper: of 20 runs 8 to 17 cannot be told from that."""
    runs = [ended("P4", 100 * (seed + 1), seed) for seed in range(20)]
    assert agreement(runs) == (800.0, 1800.0)
    assert agreement([ended("P4", None, seed) for seed in range(20)]) == (math.inf, math.inf)
    assert best_budget(runs + [ended("P2", 1400, seed) for seed in range(20)]) == (1400.0, 2)


def test_a_run_without_convergence_costs_infinitely_much():
    (row,) = equation_rows([ended("glider v", None), ended("glider v", 10, 1), ended("glider v", 30, 2)])
    assert row[1:3] == ("2 of 3", "30")


def test_a_journal_is_gone_on_with(tmp_path, monkeypatch, capsys):
    path, asked = tmp_path / "runs.jsonl", []

    def answered(_, tasks, __):
        asked.extend(tasks)
        return [ended(task.problem, 5 if task.seed else None, task.seed, task.budget) for task in tasks]

    monkeypatch.setattr(readings, "in_parallel", answered)
    arguments = ["--reading", "paper", "--problem", "glider v", "--seeds", "0-1", "--resume", str(path)]
    assert main([*arguments, "--most", "1000"]) == 0
    assert main([*arguments, "--most", "2000"]) == 0
    assert [(task.seed, task.budget) for task in asked] == [(0, 1000), (1, 1000), (0, 2000)]
    assert "1 of 2" in capsys.readouterr().out
    path.write_text('{"outcome": 3}\n')
    with pytest.raises(DataError):
        Journal("readings", Run, path, [], resume=True)
