"""Rows whose derivatives cannot be trusted are left out, and counted."""

from itertools import pairwise

import numpy as np
import pytest

from atoll_coordinator.data.differentiation.derivatives import StateEstimate
from atoll_coordinator.data.differentiation.smoothing import Smoother
from atoll_coordinator.data.roles.roles import Roles
from atoll_coordinator.data.row_selection.selected_rows import FAR_OUT, select_rows
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
    return select_rows(
        Measurements(roles, {}, tuple(pairwise(ends)), held_out, trajectories, ()), estimates, paper=paper
    )


def test_uncertain_rows_of_any_state_are_left_out():
    selection = selected([smoothed(with_peaks(50, 0, 49)), smoothed(with_peaks(50, 0, 20, level=7.0))])
    assert selection.searched == [row for row in range(50) if row not in (0, 20, 49)]
    assert [*map(len, selection.uncertain)] == [2, 2]
    assert selection.warnings == (
        "3 of 50 rows have doubtful derivatives (at ends and jumps) and are left out of the search.",
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


def test_the_paper_keeps_all():
    selection = selected([smoothed(with_peaks(50, 0, 49)), interpolated(with_peaks(50, 3))], paper=True)
    assert selection.searched == list(range(50))
    assert (selection.uncertain, selection.warnings) == ((frozenset(), frozenset()), ())


def test_held_out_rows_are_held_to_the_limits_of_the_others():
    uncertainty = with_peaks(80, 5, 60, 70)
    uncertainty[75] = 4.0
    uncertainty[30] = 4.0
    selection = selected([smoothed(uncertainty)], [40, 40], held_out=(False, True))
    assert selection.searched == [row for row in range(40) if row != 5]
    assert selection.held_out == [row for row in range(40, 80) if row not in (60, 70)]
    assert [*map(len, selection.uncertain)] == [1]


def test_held_out_rows_at_the_ends_of_clean_trajectories_are_left_out():
    selection = selected([interpolated(np.full(80, 1e-9))], [40, 40], held_out=(True, False))
    assert selection.searched == list(range(44, 76))
    assert selection.held_out == list(range(4, 36))


def test_clean_and_noisy_states_share_their_rows():
    selection = selected([interpolated(with_peaks(60, 10, level=1e-6, size=1e4)), smoothed(with_peaks(60, 30))])
    assert selection.searched == [row for row in range(4, 56) if row not in (10, 30)]
    assert [*map(len, selection.uncertain)] == [1, 1]
    assert len(selection.warnings) == 3
