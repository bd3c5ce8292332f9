"""Held-out rows of the Lorenz contest have the shapes of the contest, and continue what the search has seen."""

import numpy as np
import pytest

from benchmarks.contests.ctf import contest, held_out
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
