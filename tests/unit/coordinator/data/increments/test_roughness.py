import numpy as np
import pytest

from atoll_coordinator.data.increments import is_driven, noise_rate, noise_shares
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from tests.unit.coordinator.data.increments.paths import steps_of, uneven_steps_of

LIMIT = SETTINGS.process.least_noise


def times_of(kind: str) -> FloatArray:
    """Return times that are even, or whose steps differ sixfold."""
    random = np.random.default_rng(6)
    return 0.02 * (np.arange(1000.0) if kind == "even" else np.cumsum(random.uniform(0.3, 1.7, 1000)))


def smooth(times: FloatArray) -> FloatArray:
    return np.array([np.sin(2.0 * times), np.exp(-0.1 * times) * np.cos(times)])


@pytest.mark.parametrize("kind", ["even", "uneven"])
def test_smooth_motion_is_told_from_small_noise(kind: str) -> None:
    times = times_of(kind)
    walk = np.cumsum(1e-4 * np.random.default_rng(5).standard_normal((2, len(times))), axis=1)
    assert (noise_shares(uneven_steps_of(smooth(times), times)) < 1e-3 * LIMIT).all()
    assert (noise_shares(uneven_steps_of(smooth(times) + walk, times)) > 10.0 * LIMIT).all()


def test_differences_are_not_taken_over_the_end_of_a_trajectory() -> None:
    times = times_of("even")
    twice = np.concatenate([smooth(times), smooth(times)], axis=1)
    parted = uneven_steps_of(twice, 0.02 * np.arange(2000), breaks=[1000])
    assert (noise_shares(parted) < 1e-3 * LIMIT).all()


@pytest.mark.parametrize("kind", ["even", "uneven"])
def test_a_state_that_follows_a_noisy_one_is_told_from_one_with_noise_of_its_own(kind: str) -> None:
    random, times = np.random.default_rng(7), times_of(kind)
    fine = np.linspace(times[0], times[-1], 40_000)
    spread = np.sqrt(fine[1] - fine[0])
    noisy = np.cumsum(0.5 * spread * random.standard_normal(len(fine)))
    once = np.cumsum(noisy) * (fine[1] - fine[0])
    twice = np.cumsum(once) * (fine[1] - fine[0])
    states = np.array([np.interp(times, fine, path) for path in (noisy, once, twice, np.sin(fine))])
    steps = uneven_steps_of(states, times)
    assert [is_driven(steps, state) for state in range(4)] == [False, True, True, False]
    assert abs(noise_rate(steps, 0) / (0.455 * 0.25) - 1.0) < 0.3


def test_of_paths_shorter_than_a_window_nothing_is_known() -> None:
    steps = steps_of(np.random.default_rng(8).standard_normal((1, 5)), 0.1)
    assert noise_rate(steps, 0) == np.inf
    assert not is_driven(steps, 0)
