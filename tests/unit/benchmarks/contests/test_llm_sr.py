"""Rows of the problems of LLM-SR are held out as documented, and errors are normalised by the variance."""

from argparse import Namespace
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import atoll
from benchmarks.contests.llm_sr import PROBLEMS, RANDOM, Outcome, at_random, beyond, normalised_error, search, table


def test_a_random_quarter_is_the_same_each_time() -> None:
    columns = {"x": np.arange(400.0)}
    held_out = at_random(columns)
    assert held_out.sum() == 100
    assert np.array_equal(held_out, at_random(columns))


def test_rows_beyond_a_threshold_are_outside_of_the_range_of_the_others() -> None:
    values = np.random.default_rng(1).normal(size=1_000)
    held_out = beyond(lambda columns: columns["x"])({"x": values})
    assert abs(held_out.sum() - 250) <= 1
    assert values[held_out].min() > values[~held_out].max()


def test_a_value_of_many_rows_is_held_out_whole_or_not_at_all() -> None:
    values = np.repeat([1.0, 2.0, 3.0], [600, 300, 100])
    held_out = beyond(lambda columns: columns["x"])({"x": values})
    assert set(values[held_out]) == {3.0}


def test_the_error_of_the_mean_is_1() -> None:
    target = np.array([1.0, 2.0, 6.0])
    assert normalised_error(target, target) == 0.0
    assert normalised_error(target, np.full(3, 3.0)) == pytest.approx(1.0)
    assert normalised_error(target, np.full(3, np.nan)) == pytest.approx(1.0)


def test_the_table_has_the_published_error_of_the_same_kind() -> None:
    for name, problem in PROBLEMS.items():
        for split in problem.splits:
            line = table([Outcome(name, split, 10, 1.0, "x", "good", "", 0.5, 0.25)]).splitlines()[-1]
            assert f"{problem.published[split != RANDOM]:.2g}" in line


def test_a_prediction_holds_if_it_explains_nine_tenths() -> None:
    assert Outcome("oscillator1", RANDOM, 10, 1.0, held_out_error=0.05).held
    assert not Outcome("oscillator1", RANDOM, 10, 1.0, held_out_error=0.2).held
    assert not Outcome("oscillator1", RANDOM, 10, 1.0, failure="no rows").held


def test_further_files_search_factors_with_the_weights_of_squared_errors(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    x, v = np.random.default_rng(0).uniform(1.0, 2.0, (2, 40))
    np.savetxt(tmp_path / "llmsr_oscillator1_train.csv", np.stack([x, v, x * v], axis=1), "%.17g", ",", header="x,v,a",
               comments="")  # fmt: skip
    asked: list[tuple[dict[str, Any], dict[str, Any]]] = []

    def discover(columns: dict[str, Any], **options: Any) -> Any:
        asked.append((columns, options))
        law: Callable[[Any], Any] = (lambda part: part["x"]) if len(asked) == 1 else (lambda part: part["v"])
        equation = SimpleNamespace(expression="xv"[len(asked) - 1], verdict="doubtful", reason=None)
        return SimpleNamespace(predict=law, equations=[equation])

    monkeypatch.setattr(atoll, "discover", discover)
    options = Namespace(data=tmp_path, config=["one.toml", "two.toml"], seed=5, workers=1, max_time=None)
    outcome = search("oscillator1", RANDOM, options)
    assert (outcome.equation, outcome.verdict) == ("(x) * (v)", "doubtful, doubtful")
    assert outcome.held_out_error == pytest.approx(0.0, abs=1e-20)
    (first, settings), (second, further) = asked
    assert (settings["config"], settings["seed"], "weights" in settings) == ("one.toml", 5, False)
    assert (further["config"], further["seed"], further["inputs"]) == ("two.toml", 6, ["x", "v"])
    assert second["a"] == pytest.approx(first["v"])
    assert second[further["weights"]] == pytest.approx(first["x"] ** 2 / np.mean(first["x"] ** 2))
