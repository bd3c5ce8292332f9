"""Rows whose derivatives cannot be trusted are left out, and counted."""

import numpy as np
import pytest

from atoll_coordinator.data.differentiation.derivatives import Estimate
from atoll_coordinator.data.differentiation.smoothing import Choice
from atoll_coordinator.data.row_selection.rows import FAR_OUT, kept_rows

CHOICE = Choice(11, 3, 0.1)


def smoothed(doubt):
    """Return a smoothed state with this doubt in its rows."""
    rows = len(doubt)
    slopes = np.sin(np.arange(rows))
    return Estimate(slopes, slopes, slopes, np.full(rows, 0.1), np.asarray(doubt, float), 0.1, 1.0, CHOICE)


def interpolated(uncertainty):
    """Return an interpolated state with this uncertainty in its rows."""
    rows = len(uncertainty)
    slopes = np.sin(np.arange(rows))
    return Estimate(slopes, slopes, slopes, np.asarray(uncertainty, float), np.zeros(rows), 0.0, 1.0, None)


def with_peaks(rows, *peaks, level=1.0, size=10.0):
    values = np.full(rows, level)
    values[list(peaks)] = size * level
    return values


def kept(estimates, lengths=None, held_out=(), paper=False):
    lengths = lengths or [len(estimates[0].values)]
    rows = range(sum(lengths))
    return kept_rows(estimates, lengths, [row for row in rows if row not in held_out], list(held_out), paper=paper)


def test_doubtful_rows_of_any_state_are_left_out():
    its = kept([smoothed(with_peaks(50, 0, 49)), smoothed(with_peaks(50, 0, 20, level=7.0))])
    assert its.seen == [row for row in range(50) if row not in (0, 20, 49)]
    assert its.doubtful == (2, 2)
    assert its.warnings == (
        "3 of 50 rows have doubtful derivatives (at ends and jumps) and are left out of the search.",
    )


@pytest.mark.parametrize(("size", "left_out"), [(0.99 * FAR_OUT, 0), (1.01 * FAR_OUT, 1)])
def test_doubt_is_measured_by_the_typical_one(size, left_out):
    assert 50 - len(kept([smoothed(with_peaks(50, 7, size=size))]).seen) == left_out


def test_most_rows_are_kept_whatever_their_doubt():
    doubt = np.array([1.0] * 26 + [10.0] * 12 + [20.0] * 12)
    assert len(kept([smoothed(doubt)]).seen) == 50
    doubt[-5:] = 30.0
    assert len(kept([smoothed(doubt)]).seen) == 45
    assert len(kept([smoothed(with_peaks(5, 0))]).seen) == 5


def test_the_paper_keeps_all():
    its = kept([smoothed(with_peaks(50, 0, 49)), interpolated(with_peaks(50, 3))], paper=True)
    assert its.seen == list(range(50))
    assert (its.doubtful, its.warnings) == ((0, 0), ())


def test_held_out_rows_are_held_to_the_limits_of_the_others():
    doubt = with_peaks(80, 5, 60, 70)
    doubt[75] = 4.0
    doubt[30] = 4.0
    its = kept([smoothed(doubt)], [40, 40], held_out=range(40, 80))
    assert its.seen == [row for row in range(40) if row != 5]
    assert its.held_out == [row for row in range(40, 80) if row not in (60, 70)]
    assert its.doubtful == (1,)


def test_held_out_rows_at_the_ends_of_clean_trajectories_are_left_out():
    its = kept([interpolated(np.full(80, 1e-9))], [40, 40], held_out=range(40))
    assert its.seen == list(range(44, 76))
    assert its.held_out == list(range(4, 36))


def test_clean_and_noisy_states_share_their_rows():
    its = kept([interpolated(with_peaks(60, 10, level=1e-6, size=1e4)), smoothed(with_peaks(60, 30))])
    assert its.seen == [row for row in range(4, 56) if row not in (10, 30)]
    assert its.doubtful == (1, 1)
    assert len(its.warnings) == 3
