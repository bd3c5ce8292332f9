"""Inputs between rows: as smooth as they look, and no smoother."""

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from atoll_coordinator.data.differentiation.inputs import estimate_input_slopes


def steps(rows, seed=0):
    return np.cumsum(np.random.default_rng(seed).uniform(0.05, 0.15, rows))


@pytest.mark.parametrize("scale", [1.0, 1e-300, 1e300])
def test_a_linear_input_is_exact(scale):
    times = steps(30)
    (slopes,) = estimate_input_slopes([times], [scale * (3.0 - 0.7 * times)])
    assert slopes / scale == pytest.approx(np.full(30, -0.7), rel=1e-12)


def test_a_smooth_input_is_interpolated_to_the_fourth_order():
    times = steps(100)
    (slopes,) = estimate_input_slopes([times], [np.sin(times)])
    between = np.linspace(times[3], times[-4], 999)
    curve = CubicHermiteSpline(times, np.sin(times), slopes)
    assert np.abs(curve(between) - np.sin(between)).max() < 3e-6


def test_a_switched_input_does_not_overshoot():
    times = [steps(60), steps(40, 1)]
    values = [np.where(part_times % 2.0 < 1.0, 0.0, 5.0) for part_times in times]
    for part_times, part, slopes in zip(times, values, estimate_input_slopes(times, values), strict=True):
        curve = CubicHermiteSpline(part_times, part, slopes)(np.linspace(part_times[0], part_times[-1], 2000))
        assert -1e-12 < curve.min() <= curve.max() < 5.0 + 1e-12


def test_all_trajectories_of_an_input_are_taken_alike():
    """A short smooth piece of an input that is switched elsewhere is shape-preserving too."""
    switched, smooth = steps(60), steps(8, 1)
    alone = estimate_input_slopes([smooth], [np.sin(smooth)])[0]
    both = estimate_input_slopes([switched, smooth], [np.where(switched % 2.0 < 1.0, 0.0, 5.0), np.sin(smooth)])[1]
    assert not np.allclose(alone, both)


@pytest.mark.parametrize("rows", [5, 6, 7])
def test_short_trajectories_have_slopes(rows):
    times = np.arange(float(rows))
    (slopes,) = estimate_input_slopes([times], [times**2])
    assert slopes == pytest.approx(2 * times)
