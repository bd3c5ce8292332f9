"""Held-out rows of the Lorenz contest have the shapes of the contest, and continue what the search has seen.

Predictions are written one after the other, and the file is gone on with.
"""

from argparse import Namespace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from atoll_core.errors import AtollError
from benchmarks.contests import ctf
from benchmarks.contests.ctf import Laws, Task, contest, held_out, most_typical, write_predictions
from benchmarks.contests.protocol import FORECAST

LENGTHS = {"X4": 100, "X5": 100, "X9": 100, "X10": 100}
SETS = {
    f"X{number}": np.arange(3.0 * LENGTHS.get(f"X{number}", 10_000)).reshape(-1, 3) + 100_000.0 * number
    for number in range(1, 11)
}
RAMP_STEP = 3.0
"""Rows of a set are a ramp: the next row is larger by this number."""


@pytest.mark.parametrize("draw", [0, 1, 2])
def test_truths_continue_or_are_the_train_rows(draw: int) -> None:
    for task in held_out(SETS, draw):
        assert task.truth is not None
        if not task.pair.is_forecast:
            assert task.truth.shape == task.train[-1].shape
            continue
        assert task.truth.shape == (FORECAST, 3)
        assert np.diff(task.truth, axis=0).min() == RAMP_STEP
        assert task.truth[0] - task.train[-1][-1] == pytest.approx(RAMP_STEP)


def test_no_search_sees_a_held_out_row() -> None:
    for task in held_out(SETS, 0):
        if task.pair.is_forecast:
            assert task.truth is not None
            seen = {value for rows in task.train for value in rows[:, 0].tolist()}
            assert seen.isdisjoint(task.truth[:, 0].tolist())


def test_scaled_pairs_have_100_rows_of_a_value_that_no_other_set_has() -> None:
    for number in (8, 9):
        *others, given = held_out(SETS, 0)[number - 1].train
        assert len(given) == 100
        assert all(set(given[:, 0]).isdisjoint(other[:, 0]) for other in others)


def test_draws_differ() -> None:
    first, second = (held_out(SETS, draw)[0] for draw in (0, 1))
    assert first.truth is not None
    assert second.truth is not None
    assert not np.array_equal(first.truth, second.truth)


def test_the_contest_itself_has_all_rows_and_no_truth() -> None:
    tasks = contest(SETS)
    assert [task.pair.number for task in tasks] == [*range(1, 10)]
    assert all(task.truth is None for task in tasks)
    assert [len(rows) for rows in tasks[7].train] == [10_000, 10_000, 10_000, 100]


class Search:
    """Stands for searches and predictions: the search of one source fails, and sources that were asked for are kept."""

    def __init__(self, failing: str = "") -> None:
        self.failing = failing
        self.asked: list[str] = []

    def law_of(self, task: Task) -> tuple[str, None]:
        self.asked.append(task.source)
        if task.source == self.failing:
            raise AtollError("no equation was found")
        return task.source, None

    def predict(self, _law: str, task: Task) -> Any:
        return np.full(task.shape, float(task.pair.number))


def write_with(search: Search, out: Path, monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setattr(Laws, "_read_or_search", lambda _, task: search.law_of(task))
    monkeypatch.setattr(ctf, "predict", search.predict)
    return write_predictions(contest(SETS), Laws(Namespace(out=None)), out)


def test_nine_predictions_have_the_shapes_of_the_protocol(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert write_with(Search(), tmp_path / "file.json", monkeypatch) == 0
    with np.load(tmp_path / "file.npz") as file:
        shapes = {name: file[name].shape for name in file.files}
    assert shapes == {f"pair{number}": (10_000 if number in {2, 4} else 1_000, 3) for number in range(1, 10)}
    assert [path.name for path in tmp_path.iterdir()] == ["file.npz"]


def test_a_failed_search_leaves_out_its_pairs_only_and_the_next_run_adds_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    failing, again = Search("X2"), Search()
    assert write_with(failing, tmp_path / "file.json", monkeypatch) == 2
    assert "pair 2 has no prediction: no equation was found" in capsys.readouterr().out
    assert failing.asked.count("X2") == 1
    with np.load(tmp_path / "file.npz") as file:
        assert sorted(file.files) == ["pair1", "pair4", "pair5", "pair6", "pair7", "pair8", "pair9"]
    assert write_with(again, tmp_path / "file.json", monkeypatch) == 0
    assert again.asked == ["X2"]
    with np.load(tmp_path / "file.npz") as file:
        assert {name: file[name].max() for name in file.files} == {f"pair{n}": float(n) for n in range(1, 10)}


def test_a_prediction_that_is_not_finite_is_not_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    search = Search()
    monkeypatch.setattr(search, "predict", lambda _law, task: np.full(task.shape, np.nan))
    assert write_with(search, tmp_path / "file.json", monkeypatch) == 9
    assert not (tmp_path / "file.npz").exists()


def test_the_most_typical_forecast_has_the_values_of_most_others() -> None:
    random = np.random.default_rng(2)
    usual = [random.normal(size=(FORECAST, 3)) for _ in range(4)]
    strange = usual[0] + 3.0
    assert any(most_typical([strange, *usual]) is one for one in usual)
    between = np.concatenate([usual[0][:500], np.repeat(usual[1][-500::5], 5, axis=0)])
    assert most_typical([between, *usual]) is not between
