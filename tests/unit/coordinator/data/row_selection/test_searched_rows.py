"""Rows whose derivatives are too uncertain are left out, counted and explained; many rows are thinned."""

from itertools import pairwise

import numpy as np
import pytest

from atoll_coordinator.data.differentiation.derivatives import StateEstimate
from atoll_coordinator.data.differentiation.interpolation import END_ROWS
from atoll_coordinator.data.differentiation.smoothing import Smoother
from atoll_coordinator.data.roles.roles import Roles
from atoll_coordinator.data.searched_rows import (
    FAR_OUT,
    SelectedRows,
    explain_excluded_rows,
    select_searched_rows,
    thin_searched_rows,
)
from atoll_coordinator.data.trajectories.measurements import Measurements, Trajectories

SMOOTHER = Smoother(11, 3, 0.1)


def smoothed(uncertainty):
    """Return a smoothed state with this total uncertainty in its rows."""
    rows = len(uncertainty)
    slopes = np.sin(np.arange(rows))
    return StateEstimate(slopes, slopes, slopes, np.full(rows, 0.1), np.asarray(uncertainty, float), 0.1, 1.0, SMOOTHER)


def interpolated(uncertainty):
    """Return an interpolated state with this uncertainty in its rows."""
    uncertainty = np.asarray(uncertainty, float)
    slopes = np.sin(np.arange(len(uncertainty)))
    return StateEstimate(slopes, slopes, slopes, uncertainty, uncertainty, 0.0, 1.0, None)


def with_peaks(rows, *peaks, level=1.0, size=10.0):
    values = np.full(rows, level)
    values[list(peaks)] = size * level
    return values


def selected(estimates, lengths=None, held_out=None, paper=False):
    """Return the rows selected of trajectories of these lengths, of which some may be held out."""
    lengths = lengths or [len(estimates[0].values)]
    ends = np.cumsum([0, *lengths]).tolist()
    trajectories = Trajectories(("1",) * len(lengths), tuple(np.arange(float(rows)) for rows in lengths), 0.0, {})
    held_out = held_out or (False,) * len(lengths)
    roles = Roles("t", None, ("x",), ())
    return select_searched_rows(
        Measurements(roles, {}, tuple(pairwise(ends)), held_out, trajectories, ()), estimates, paper=paper
    )


def test_uncertain_rows_of_any_state_are_left_out():
    selection = selected([smoothed(with_peaks(50, 0, 49)), smoothed(with_peaks(50, 0, 20, level=7.0))])
    assert selection.searched == [row for row in range(50) if row not in (0, 20, 49)]
    assert [*map(len, selection.uncertain)] == [2, 2]
    assert selection.warnings == (
        "3 of 50 rows have uncertain derivatives (at ends and jumps) and are left out of the search.",
    )


@pytest.mark.parametrize(("size", "left_out"), [(0.99 * FAR_OUT, 0), (1.01 * FAR_OUT, 1)])
def test_uncertainty_is_measured_by_the_typical_one(size, left_out):
    assert 50 - len(selected([smoothed(with_peaks(50, 7, size=size))]).searched) == left_out


def test_most_rows_are_kept_whatever_their_uncertainty():
    uncertainty = np.array([1.0] * 26 + [10.0] * 9 + [20.0] * 15)
    assert len(selected([smoothed(uncertainty)]).searched) == 35
    uncertainty[26:36] = 20.0
    assert len(selected([smoothed(uncertainty)]).searched) == 50
    assert len(selected([smoothed(with_peaks(5, 0))]).searched) == 5


def test_held_out_rows_are_held_to_the_limits_of_the_others():
    uncertainty = with_peaks(80, 5, 60, 70)
    uncertainty[75] = 4.0
    uncertainty[30] = 4.0
    selection = selected([smoothed(uncertainty)], [40, 40], held_out=(False, True))
    assert selection.searched == [row for row in range(40) if row != 5]
    assert selection.held_out == [row for row in range(40, 80) if row not in (60, 70)]
    assert [*map(len, selection.uncertain)] == [1]


def test_clean_and_noisy_states_share_their_rows():
    selection = selected([interpolated(with_peaks(60, 10, level=1e-6, size=1e4)), smoothed(with_peaks(60, 30))])
    assert selection.searched == [row for row in range(4, 56) if row not in (10, 30)]
    assert [*map(len, selection.uncertain)] == [1, 1]
    assert len(selection.warnings) == 3


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


def selection(rows: list[int]) -> SelectedRows:
    return SelectedRows(rows, [7], (frozenset(),), ((),), ("said",))


def test_many_rows_become_about_as_many_as_are_allowed_first_and_last_among_them() -> None:
    state = np.sin(np.linspace(0.0, 20.0, 10_000))
    thinned = thin_searched_rows(selection(list(range(10_000))), [state], 500)
    assert 400 <= len(thinned.searched) <= 500
    assert (thinned.searched[0], thinned.searched[-1]) == (0, 9_999)
    assert max(np.diff(thinned.searched)) <= 41
    assert thinned.held_out == [7]
    assert "of 10000 rows" in thinned.warnings[-1]


def test_a_jump_of_a_few_rows_keeps_them() -> None:
    state = np.concatenate([np.zeros(5_000), np.linspace(0.0, 1.0, 20), np.ones(5_000)])
    kept = set(thin_searched_rows(selection(list(range(len(state)))), [state], 100).searched)
    assert len(kept & set(range(5_000, 5_020))) >= 18


def test_a_state_that_rests_leaves_the_rows_even() -> None:
    kept = thin_searched_rows(selection(list(range(0, 4_000, 2))), [np.ones(4_000)], 200).searched
    assert set(np.diff(kept)) <= {20, 22}
