"""The Kalman smoother with free forces, compared with the posterior of all states at once."""

import numpy as np
import pytest

from atoll_coordinator.model.hidden.kalman_smoother import KalmanSmoother, Series

TIMES = np.array([0.0, 0.1, 0.25, 0.3, 0.5, 0.6, 0.85, 1.0])
NOISE = 0.1


def move(states, inputs, forces):
    """A position, its velocity, and an acceleration that is free, beside one that is an input."""
    return np.array([states[1], forces[0] + inputs[0]])


SMOOTHER = KalmanSmoother(move, lambda states, _: states[:1], 2, np.array([1.0, 1.0, 3.0]), np.array([NOISE]))


def series(measured):
    return Series(TIMES, 0.5 + TIMES[None], np.array([measured]), np.array([1.0, 0.0]), np.array([1.0, 2.0]), 1.0)


def posterior(measured, factor):
    """Return mean and variances of position, velocity and force (3, R): with the normal equations of all rows."""
    rows = len(TIMES)
    first_variances = np.array([1.0, 4.0, 9.0 * factor])
    means, ways = [np.array([1.0, 0.0, 0.0])], [np.eye(3, 3 + rows - 1)]
    for row in range(1, rows):
        span, before = TIMES[row] - TIMES[row - 1], 0.5 + TIMES[row - 1]
        change = np.array([[1.0, span, span**2 / 2.0], [0.0, 1.0, span], [0.0, 0.0, 1.0]])
        pushed = np.array([before * span**2 / 2.0 + span**3 / 6.0, before * span + span**2 / 2.0, 0.0])
        means.append(change @ means[-1] + pushed)
        way = change @ ways[-1]
        way[2, 2 + row] = 1.0
        ways.append(way)
    variances = np.concatenate([first_variances, 9.0 * factor * np.diff(TIMES) / TIMES[-1]])
    whole, mean = np.concatenate(ways), np.concatenate(means)
    prior = whole @ np.diag(variances) @ whole.T
    known = np.flatnonzero(np.isfinite(measured))
    seen = prior[:, 3 * known]
    gain = seen @ np.linalg.inv(seen[3 * known] + NOISE**2 * np.eye(len(known)))
    course = mean + gain @ (measured[known] - mean[3 * known])
    return course.reshape(rows, 3).T, np.diag(prior - gain @ seen.T).reshape(rows, 3).T


def test_the_course_is_the_posterior_mean_and_its_variances_are_those_of_the_posterior():
    measured = np.array([1.0, 0.8, np.nan, 0.9, 1.3, np.nan, 2.0, 2.4])
    (found,) = SMOOTHER.smooth([series(measured)], is_free=True)
    course, variances = posterior(measured, 1e4)
    assert found.states == pytest.approx(course[:2], rel=1e-5, abs=1e-6)
    assert found.forces == pytest.approx(course[2:], rel=1e-4, abs=1e-4)
    assert found.variances == pytest.approx(variances[:2], rel=1e-4)


def test_the_force_is_as_free_as_the_measured_values_demand():
    times = np.linspace(0.0, 6.0, 121)
    rng = np.random.default_rng(3)

    def made(force):
        velocity = np.concatenate([[0.0], np.cumsum(0.05 * force[:-1])])
        position = 1.0 + np.concatenate([[0.0], np.cumsum(0.05 * velocity[:-1] + 0.00125 * force[:-1])])
        measured = position + NOISE * rng.standard_normal(len(times))
        start, spread = np.array([1.0, 0.0]), np.array([1.0, 1.0])
        return Series(times, np.zeros((1, len(times))), measured[None], start, spread, 6.0)

    (still,) = SMOOTHER.smooth([made(np.zeros(121))])
    wave = 4.0 * np.sin(2.0 * times)
    (moving,) = SMOOTHER.smooth([made(wave)])
    assert np.abs(still.forces).max() < 0.5
    assert np.sqrt(np.mean((moving.forces[0] - wave)[5:-5] ** 2)) < 1.0


def test_a_system_that_cannot_be_integrated_has_no_course():
    broken = KalmanSmoother(
        lambda states, *_: np.full_like(states, np.nan), SMOOTHER.columns, 2, SMOOTHER.scales, SMOOTHER.noise
    )
    assert broken.smooth([series(np.ones(8))]) is None
