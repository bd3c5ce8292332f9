"""Windows along trajectories with errors of variables and of quadrature."""

import numpy as np
import pytest
from scipy.integrate import quad

from atoll_coordinator.model.sparse.weak_form import Measured
from atoll_coordinator.model.sparse.windows.window_rows import _weights, _windows, window_rows
from atoll_coordinator.settings import SETTINGS
from tests.unit.coordinator.model.sparse.windows.enzyme import NAMES, prepared


def test_weights_integrate_cubics_times_the_test_function():
    times = np.array([[0.0, 0.1, 0.25, 0.3, 0.5]])
    bump, slope = _weights(times, 3)

    def function(t):
        return 1.0 + t - 4.0 * t**2 + 7.0 * t**3

    def test(t):
        return (1.0 - ((t - 0.25) / 0.25) ** 2) ** SETTINGS.windows.smoothness

    assert (bump @ function(times[0]))[0] == pytest.approx(quad(lambda t: test(t) * function(t), 0.0, 0.5)[0])
    by_parts = quad(lambda t: test(t) * (1.0 - 8.0 * t + 21.0 * t**2), 0.0, 0.5)[0]
    assert -(slope @ function(times[0]))[0] == pytest.approx(by_parts)


def test_noise_is_that_of_the_measurements():
    recording = prepared().recording
    rows = window_rows(recording, NAMES, "b")
    deviations = np.concatenate([part.measured for part in recording.trajectories], axis=1).std(axis=1)
    assert rows.noise / deviations == pytest.approx([0.01, 0.01], rel=0.4)
    assert rows.target == 1


def test_windows_are_as_wide_as_the_sampling_resolves():
    coarse = window_rows(prepared().recording, NAMES, "a")
    fine = window_rows(prepared(runs=4, rows=121, step=0.025).recording, NAMES, "a")
    assert fine.bumps.shape[2] > coarse.bumps.shape[2]


def test_windows_apart_do_not_overlap():
    rows = window_rows(prepared().recording, NAMES, "a")
    apart = rows.apart()
    reach = rows.bumps.shape[2] - 1
    assert (np.diff(apart.first) >= reach).all()
    assert rows.independent == len(apart.first)
    assert apart.sides.shape == (2, len(apart.first))


def test_errors_reach_the_neighbours_of_the_same_trajectory():
    rows = window_rows(prepared().recording, NAMES, "a")
    last = int(np.flatnonzero(np.diff(rows.owners))[0])
    errors = np.zeros(len(rows.first))
    errors[last] = -2.0
    assert np.flatnonzero(rows.spread(errors)).tolist() == [last - 1, last]


def many_windows(runs, rows):
    """Return the windows of so many trajectories of so many rows; the variable is the number of a row."""
    numbers = np.arange(float(runs * rows))[None]
    ranges = tuple((rows * run, rows * (run + 1)) for run in range(runs))
    return _windows(Measured(numbers[0], ranges, numbers, numbers, np.zeros(1)), np.zeros(1), 0, 2)


def test_so_many_windows_stand_for_all_and_begin_early_and_late():
    windows, rows = many_windows(5000, 20), 20
    assert SETTINGS.windows.most <= len(windows.first) < 2 * SETTINGS.windows.most
    begins = windows.inputs[0, windows.first].astype(int)
    assert set((begins % rows).tolist()) == set(range(0, 16, 2))
    assert (begins // rows == windows.owners).all()


def test_terms_are_computed_on_no_more_rows_than_windows_have_however_long_the_table_is():
    long, twice = many_windows(5000, 20), many_windows(10000, 20)
    assert long.inputs.shape[1] <= 5 * len(long.first) < 5000 * 20
    assert twice.inputs.shape[1] <= 5 * len(twice.first) < 2 * 5 * SETTINGS.windows.most
    row_by_row = long.inputs[0, long.first[:, None] + np.arange(5)]
    assert (np.diff(row_by_row, axis=1) == 1.0).all()
    assert many_windows(100, 20).inputs.shape[1] == 100 * 20
