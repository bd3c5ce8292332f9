"""The Kalman filter along a system against matrices written out, and its slopes against differences."""

from dataclasses import replace

import numpy as np
import pytest

from atoll_coordinator.model.shooting.measurements import Measurements
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.text.parsing import from_infix
from benchmarks.scores.filtering import Filter, Filtered
from benchmarks.scores.kernels.kalman import Noise

compiles = pytest.mark.slow
"""The kernel takes ten seconds to compile, and no program of ours needs it."""

NAMES = ("x", "y")
LAW = ("0.5*y - 0.2*x", "-1.5*x - 0.1*y")
MATRIX = np.array([[-0.2, 0.5], [-1.5, -0.1]])


def measured(rows: int = 40, step: float = 0.1) -> Measurements:
    rng = np.random.default_rng(3)
    times = step * np.arange(float(rows))
    values = np.stack([np.cos(0.9 * times), -np.sin(0.9 * times)]) + 0.1 * rng.standard_normal((2, rows))
    weights = np.ones_like(values)
    weights[1, 7] = 0.0
    weights[0, 11] = 2.0
    return Measurements(
        bounds=np.array([[0, 25], [25, rows]], dtype=np.int64),
        owners=np.arange(2, dtype=np.int64),
        times=times,
        measured=values,
        weights=weights,
        smoothed=values,
        observed=np.arange(2, dtype=np.int64),
        inputs=np.zeros((0, rows)),
        input_slopes=np.zeros((0, rows)),
        scales=values.std(axis=1),
        noise=np.full(2, 0.1),
        offset=np.zeros(0, dtype=np.int64),
        variables=NAMES,
        names=("1", "2"),
    )


NOISE: Noise = (np.array([0.01, 0.02]), np.array([0.004, 0.006]), np.array([0.003, 0.0]), np.array([0.8, 0.5]))


def nats_by_matrices(data: Measurements, noise: Noise, unknown: FloatArray) -> float:
    """Return minus the log-likelihood of the linear law, each row taken in at once."""
    process, sensor, drift, decay = noise
    width = float(data.times[1] - data.times[0])
    powers, term = np.eye(2), np.eye(2)
    for order in range(1, 12):
        term = term @ MATRIX * width / order
        powers = powers + term
    move, look = np.zeros((4, 4)), np.hstack([np.eye(2), np.eye(2)])
    move[:2, :2], move[2:, 2:] = powers, np.diag(decay)
    added = np.diag([*(process * width), *(drift * (1.0 - decay**2))])
    total = 0.0
    for first, end in data.bounds.tolist():
        state, spread = np.array([*data.smoothed[:, first], 0.0, 0.0]), np.diag([*unknown, *drift])
        for row in range(first, end):
            if row > first:
                state, spread = move @ state, move @ spread @ move.T + added
            known = data.weights[:, row] > 0.0
            h = look[known]
            variance = h @ spread @ h.T + np.diag((sensor / np.where(known, data.weights[:, row], 1.0))[known])
            error = data.measured[known, row] - h @ state
            if row > first:
                total += 0.5 * float(np.linalg.slogdet(variance)[1] + error @ np.linalg.solve(variance, error))
            gain = spread @ h.T @ np.linalg.inv(variance)
            state, spread = state + gain @ error, spread - gain @ h @ spread
    return total


@compiles
def test_the_likelihood_of_a_linear_system_is_that_of_a_filter_by_matrices() -> None:
    data = measured()
    filter_ = Filter(data, NAMES)
    system = filter_.system([from_infix(text, NAMES) for text in LAW])
    filtered = filter_.run(system, NOISE)
    assert filtered.is_whole
    expected = nats_by_matrices(data, NOISE, (10.0 * data.scales) ** 2)
    assert filter_.nats(filtered) == pytest.approx(expected, abs=1e-6)


@compiles
def test_slopes_of_innovations_are_their_differences_where_gains_are_held() -> None:
    filter_ = Filter(measured(), NAMES)
    system = filter_.system([from_infix(text, NAMES) for text in LAW])
    held = filter_.run(system, NOISE)
    for place in range(system.count):
        moved = []
        for change in (1e-5, -1e-5):
            values = system.values.copy()
            values[place] += change
            moved.append(filter_.run(system.with_values(values), NOISE, held).innovations)
        slopes = (moved[0] - moved[1]) / 2e-5
        assert np.moveaxis(held.gradients, 0, 1)[:, :, place] == pytest.approx(slopes, abs=1e-6)


@compiles
def test_a_fit_finds_the_law_and_noise_is_found_where_it_is() -> None:
    rng = np.random.default_rng(5)
    times = 0.05 * np.arange(400.0)
    state, rows = np.array([1.0, 0.5]), []
    for _ in times:
        rows.append(state)
        for _ in range(20):
            state = state + 0.0025 * MATRIX @ state
    values = np.array(rows).T
    scales = values.std(axis=1)
    noisy = values + 0.02 * scales[:, None] * rng.standard_normal(values.shape)
    data = replace(
        measured(400, 0.05), bounds=np.array([[0, 400]], np.int64), owners=np.zeros(1, np.int64), measured=noisy,
        weights=np.ones_like(noisy), smoothed=values, scales=scales, noise=0.02 * scales,
    )  # fmt: skip
    filter_ = Filter(data, NAMES)
    system = filter_.system([from_infix(text, NAMES) for text in ("0.55*y - 0.18*x", "-1.4*x - 0.12*y")])
    noise = filter_.guess()
    for _ in range(2):
        system = filter_.fit(system, noise, filter_.run(system, noise))
        noise, _ = filter_.estimate(system, noise, frozenset({"process"}))
    assert np.sqrt(noise[1]) / scales == pytest.approx(0.02, rel=0.15)
    assert np.all(noise[0] * 20.0 < 1e-2 * noise[1] * 400)  # what the states gain in all is little beside the sensors'
    assert np.abs(system.values) == pytest.approx([0.5, 0.2, 1.5, 0.1], rel=0.05)


def test_innovations_that_swing_or_drift_are_fewer_independent_numbers_than_rows() -> None:
    filter_ = Filter(measured(400), NAMES)
    rng = np.random.default_rng(8)
    rows = np.arange(400.0)
    swinging = np.stack([np.cos(1.3 * rows), np.exp(-rows / 50.0)])
    for values, least, most in ((rng.standard_normal((2, 400)), 0.7, 1.0), (swinging, 0.0, 0.1)):
        filtered = Filtered(values, np.ones((2, 400)), np.zeros((400, 2, 4)), np.zeros((400, 2, 0)), True)
        shares = filter_.independent_share(filtered)
        assert np.all((shares >= least) & (shares <= most))
