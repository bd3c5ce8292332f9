"""Rows that are not used, and why."""

import numpy as np

from atoll_coordinator.data.differentiation.derivatives import END_ROWS, Estimate
from atoll_coordinator.data.differentiation.smoothing import Choice
from atoll_coordinator.data.row_selection.excluded_rows import doubts_of


def estimate(rows, span=None, trust=None):
    """Return a state smoothed with this span, or interpolated."""
    values = np.zeros(rows)
    choice = None if span is None else Choice(span, 3, 0.1)
    return Estimate(values, values, values, values, values, 0.1, 1.0, choice, trust=trust)


def found(times, its, doubted, seen=None):
    rows = sum(map(len, times))
    its = doubts_of(times, its, frozenset(doubted), frozenset(range(rows) if seen is None else seen))
    return [(each.trajectory, each.row, each.reason) for each in its]


def test_rows_near_ends_have_their_neighbours_on_one_side():
    times = [np.arange(100.0), np.arange(50.0)]
    doubted = [0, 9, 10, 99, 100, 112, 113]
    assert found(times, estimate(150, 41), doubted) == [
        (0, 0, "end"),
        (0, 9, "end"),
        (0, 10, "jump"),
        (0, 99, "end"),
        (1, 0, "end"),
        (1, 12, "jump"),
        (1, 13, "jump"),
    ]


def test_rows_near_a_long_step_are_near_a_gap():
    times = np.arange(100.0)
    times[60:] += 5.0
    doubted = [55, 56, 59, 60, 63, 64]
    reasons = [reason for *_, reason in found([times], estimate(100, 9), doubted)]
    assert reasons == ["jump", "gap", "gap", "gap", "gap", "jump"]


def test_outliers_are_told_from_doubtful_rows_around_them():
    trust = np.ones(100)
    trust[[1, 50]] = 0.0
    trust[51] = 1e-3
    assert found([np.arange(100.0)], estimate(100, 21, trust), [0, 49]) == [
        (0, 0, "end"),
        (0, 1, "outlier"),
        (0, 49, "jump"),
        (0, 50, "outlier"),
    ]


def test_the_ends_of_clean_states_are_left_out_whatever_their_doubt():
    its = found([np.arange(30.0)], estimate(30), [15])
    rows = [*range(END_ROWS), *range(30 - END_ROWS, 30)]
    assert its == [*((0, row, "end") for row in rows[:END_ROWS]), (0, 15, "jump"),
                   *((0, row, "end") for row in rows[END_ROWS:])]  # fmt: skip


def test_rows_that_are_held_out_are_not_counted():
    times = [np.arange(30.0), np.arange(30.0)]
    assert found(times, estimate(60, 9), [5, 40], seen=range(30)) == [(0, 5, "jump")]
