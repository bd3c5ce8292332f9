"""Windows along trajectories with errors of variables and of quadrature."""

import numpy as np
import pytest
from scipy.integrate import quad

from atoll_coordinator.model.sparse.windows.rows import _weights, window_rows
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
