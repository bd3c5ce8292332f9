import numpy as np

from atoll_coordinator.data.increments.bins import split_into_bins
from atoll_coordinator.data.increments.moments import bin_moments, noise_shares
from atoll_coordinator.data.increments.steps import Steps
from atoll_coordinator.settings import SETTINGS


def steps_of(states: np.ndarray, step: float) -> Steps:
    count = states.shape[1] - 1
    return Steps(states[:, :-1].copy(), np.full(count, step), np.diff(states, axis=1), np.arange(count) > 0)


def circling(rows: int, seed: int, correlation: float) -> np.ndarray:
    """Return two states that turn about each other, with noise of variance 0.04 per time."""
    random, step = np.random.default_rng(seed), 0.05
    normal = random.standard_normal((2, rows))
    normal[1] = correlation * normal[0] + np.sqrt(1.0 - correlation**2) * normal[1]
    found = [np.array([1.0, 0.0])]
    for row in range(rows - 1):
        x, y = found[-1]
        found.append(found[-1] + step * np.array([y - 0.1 * x, -x - 0.1 * y]) + 0.2 * np.sqrt(step) * normal[:, row])
    return np.array(found).T


def test_bins_part_the_rows_evenly() -> None:
    positions = np.random.default_rng(1).random((2, 1000))
    bins = split_into_bins(positions, 70)
    assert len(bins) == 64
    assert sorted(np.concatenate(bins).tolist()) == [*range(1000)]
    assert {len(rows) for rows in bins} <= {15, 16}
    assert max(np.ptp(positions[:, rows], axis=1).max() for rows in bins) < 0.4


def test_products_are_those_of_the_noise_and_not_of_the_drift() -> None:
    found = bin_moments(steps_of(circling(4000, 1, 0.0), 0.05))
    assert [*found.products] == [(0, 0), (1, 1)], "the drift moves both states together, their noises do not"
    assert not found.noise.any()
    assert abs(found.products[0, 0].mean() - 0.04) < 4.0 * 0.04 * np.sqrt(2.0 / 4000)
    slope = np.polyfit(found.points[1], found.drift[0] + 0.1 * found.points[0], 1)[0]
    assert abs(slope - 1.0) < 0.1


def test_states_whose_noise_is_correlated_have_a_covariation() -> None:
    found = bin_moments(steps_of(circling(2000, 2, 0.5), 0.05))
    assert [*found.products] == [(0, 0), (1, 1), (0, 1)]
    assert abs(found.products[0, 1].mean() - 0.02) < 4.0 * 0.04 / np.sqrt(2000)


def test_errors_of_measurement_are_told_from_the_noise_of_the_process() -> None:
    states = circling(4000, 3, 0.0)
    states[0] += 0.1 * np.random.default_rng(4).standard_normal(4000)
    found = bin_moments(steps_of(states, 0.05))
    assert found.noise[1] == 0.0
    assert abs(found.noise[0] - 0.01) < 0.001
    assert abs(found.products[0, 0].mean() - 0.04) < 0.015, "noise alone would add 0.4"


def test_smooth_motion_is_told_from_small_noise() -> None:
    times = 0.02 * np.arange(1000)
    smooth = np.array([np.sin(2.0 * times), np.exp(-0.1 * times) * np.cos(times)])
    noisy = smooth + np.cumsum(1e-4 * np.random.default_rng(5).standard_normal(smooth.shape), axis=1)
    limit = SETTINGS.process.least_noise
    assert (noise_shares(steps_of(smooth, 0.02)) < 1e-3 * limit).all()
    assert (noise_shares(steps_of(noisy, 0.02)) > 10.0 * limit).all()
    steps = steps_of(np.concatenate([smooth, smooth], axis=1), 0.02)
    apart = np.delete(np.arange(1999), 999)
    follows = steps.follows[apart].copy()
    follows[999] = False
    parted = Steps(steps.points[:, apart], steps.lengths[apart], steps.increments[:, apart], follows)
    assert (noise_shares(parted) < 1e-3 * limit).all(), "differences are not taken over the end of a trajectory"
