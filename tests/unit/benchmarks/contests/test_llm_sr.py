"""Rows of the problems of LLM-SR are held out as documented, and errors are normalised by the variance."""

import numpy as np
import pytest

from benchmarks.contests.llm_sr import PROBLEMS, RANDOM, Outcome, at_random, beyond, normalised_error, table


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
