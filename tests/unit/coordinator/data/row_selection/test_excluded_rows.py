"""Rows that are not used, and why."""

import numpy as np

from atoll_coordinator.data.differentiation.derivatives import StateEstimate
from atoll_coordinator.data.differentiation.interpolation import END_ROWS
from atoll_coordinator.data.differentiation.smoothing import Smoother
from atoll_coordinator.data.row_selection.selected_rows import explain_excluded_rows


def estimate(rows, span=None, weights=None):
    """Return a state smoothed with this span, or interpolated."""
    values = np.zeros(rows)
    smoother = None if span is None else Smoother(span, 3, 0.1)
    return StateEstimate(values, values, values, values, values, 0.1, 1.0, smoother, robustness_weights=weights)


def excluded(times, state_estimate, uncertain, searched=None):
    rows = sum(map(len, times))
    searched = frozenset(range(rows) if searched is None else searched)
    return [
        (excluded_row.trajectory, excluded_row.row, excluded_row.reason)
        for excluded_row in explain_excluded_rows(times, state_estimate, uncertain, searched)
    ]


def test_rows_near_ends_have_their_neighbours_on_one_side():
    times = [np.arange(100.0), np.arange(50.0)]
    uncertain = [0, 9, 10, 99, 100, 112, 113]
    assert excluded(times, estimate(150, 41), uncertain) == [
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
    uncertain = [55, 56, 59, 60, 63, 64]
    reasons = [reason for *_, reason in excluded([times], estimate(100, 9), uncertain)]
    assert reasons == ["jump", "gap", "gap", "gap", "gap", "jump"]


def test_outliers_are_told_from_uncertain_rows_around_them():
    weights = np.ones(100)
    weights[[1, 50]] = 0.0
    weights[51] = 1e-3
    assert excluded([np.arange(100.0)], estimate(100, 21, weights), [0, 49]) == [
        (0, 0, "end"),
        (0, 1, "outlier"),
        (0, 49, "jump"),
        (0, 50, "outlier"),
    ]


def test_the_ends_of_clean_states_are_left_out_whatever_their_uncertainty():
    left_out = excluded([np.arange(30.0)], estimate(30), [15])
    rows = [*range(END_ROWS), *range(30 - END_ROWS, 30)]
    assert left_out == [*((0, row, "end") for row in rows[:END_ROWS]), (0, 15, "jump"),
                   *((0, row, "end") for row in rows[END_ROWS:])]  # fmt: skip


def test_rows_that_are_held_out_are_not_counted():
    times = [np.arange(30.0), np.arange(30.0)]
    assert excluded(times, estimate(60, 9), [5, 40], searched=range(30)) == [(0, 5, "jump")]


def test_what_is_known_of_all_rows_is_not_asked_again_for_each(monkeypatch):
    """It takes as long as all rows: a million of them took hours."""
    asked = []
    known = StateEstimate.is_known.fget
    monkeypatch.setattr(StateEstimate, "is_known", property(lambda estimate: asked.append(1) or known(estimate)))
    excluded([np.arange(500.0), np.arange(500.0)], estimate(1000, 21), [3])
    assert len(asked) == 1
