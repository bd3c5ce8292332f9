"""Points beside measured curves keep the weighted sums that the measured points keep, and no others."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from atoll_coordinator.model.inference.prediction import _OtherInitialStates
from atoll_coordinator.model.shooting.points_between import points_between, points_in_boxes, remove_conserved_directions
from tests.unit.coordinator.model.shooting.made import Known, measurements

TIMES = np.linspace(0.0, 12.0, 60)
EPIDEMIC = Known(("S", "I", "R"), lambda _, z: [-1.5 * z[0] * z[1], 1.5 * z[0] * z[1] - 0.5 * z[1], 0.5 * z[1]])


def course(noise: float = 0.0) -> np.ndarray:
    """Return S, I and R/2 of an epidemic, whose sum S + I + 2*(R/2) is 1."""
    points = solve_ivp(EPIDEMIC.rates, (0.0, 12.0), [0.97, 0.03, 0.0], t_eval=TIMES, rtol=1e-10, atol=1e-12).y
    points[2] *= 0.5
    return points + noise * np.random.default_rng(3).standard_normal(points.shape)


def test_points_between_keep_a_weighted_sum_that_is_measured_to_be_constant():
    np.testing.assert_allclose(points_between(course()) @ [1.0, 1.0, 2.0], 1.0, atol=1e-8)


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_moves_of_smoothed_points_keep_sums_that_are_constant_but_for_noise(noise):
    """Smoothing leaves a part of the noise."""
    moves = remove_conserved_directions(np.eye(3), course(0.3 * noise), np.full(3, noise))
    np.testing.assert_allclose(moves @ [1.0, 1.0, 2.0], 0.0, atol=max(noise, 1e-8))


def test_what_varies_more_than_the_noise_is_no_sum_that_is_kept():
    points = course()
    points[2] += 0.05 * np.sin(TIMES)
    moves = np.eye(3)
    np.testing.assert_allclose(remove_conserved_directions(moves, points, np.full(3, 1e-3)), moves)
    assert not np.allclose(remove_conserved_directions(moves, points, np.full(3, 0.1)), moves)


def test_few_rows_show_no_sum():
    moves = np.eye(3)
    np.testing.assert_array_equal(remove_conserved_directions(moves, course()[:, :3], np.zeros(3)), moves)


def test_inputs_stay_as_they_are_at_a_measured_point():
    points = np.vstack([course(), TIMES])
    beside = points_in_boxes(points, 3)
    assert np.isin(beside[:, 3], TIMES).all()


def test_initial_states_near_measured_ones_keep_their_sum():
    made = measurements(EPIDEMIC, ([0.97, 0.03, 0.0], [0.8, 0.2, 0.0]), TIMES, noise=0.0)
    starts = _OtherInitialStates(made, 1e-6, is_near=True).starts
    np.testing.assert_allclose(starts.sum(axis=1), 1.0, atol=1e-8)
    assert np.abs(starts[:, :, None] - made.smoothed).max(axis=1).min() > 1e-6
