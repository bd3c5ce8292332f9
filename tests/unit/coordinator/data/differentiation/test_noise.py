"""The noise is estimated from what loess leaves, and from rows that are predicted by their neighbours."""

import numpy as np
import pytest

from atoll_coordinator.data.differentiation.interpolation import estimate_value_noise, predict_left_out
from atoll_coordinator.data.differentiation.smoothing import Signal, estimate_noise, select_smoother
from tests.unit.coordinator.data.differentiation.test_smoothing import noisy

NOISE = 0.01


def estimated(rows, seed, uneven, amplitude=0.0):
    """Return the estimated over the true standard deviation of the errors of a wave."""
    rng = np.random.default_rng(seed)
    times = 0.05 * np.cumsum(rng.uniform(0.5, 1.5, rows) if uneven else np.ones(rows))
    values = amplitude * np.sin(times) + NOISE * rng.standard_normal(rows)
    return estimate_value_noise(*predict_left_out([Signal(times, values)])) / NOISE


def test_noise_is_estimated():
    for deviation in (0.01, 0.1):
        signals = noisy(deviation, rows=400)
        smoother = select_smoother(signals, (3, 4))
        assert estimate_noise(signals, smoother) == pytest.approx(deviation, rel=0.1)


@pytest.mark.parametrize("amplitude", [0.0, 1.0])
@pytest.mark.parametrize("uneven", [False, True])
@pytest.mark.parametrize("rows", [50, 200, 1000])
def test_the_noise_of_values_is_not_underestimated(rows, uneven, amplitude):
    """On average over draws; the standard error of each mean is at most 0.05."""
    ratios = [estimated(rows, seed, uneven, amplitude) for seed in range(100)]
    assert 0.95 < np.mean(ratios) < 1.2


def test_the_noise_of_a_single_long_signal_is_near_the_truth():
    assert all(0.85 < estimated(4000, seed, uneven=False) < 1.15 for seed in range(5))


def test_values_without_noise_have_that_of_their_rounding():
    times = 0.02 * np.arange(500)
    assert 1e-17 < estimate_value_noise(*predict_left_out([Signal(times, np.sin(times))])) < 3e-16


def test_rows_that_change_little_tell_the_noise_beside_fast_ones():
    rng = np.random.default_rng(6)
    times = np.linspace(0.0, 10.0, 400)
    fast = np.where(times > 3.0, rng.standard_normal(400), 0.0)
    values = np.sin(times) + fast + NOISE * rng.standard_normal(400)
    whole, quiet = (
        estimate_value_noise(*predict_left_out([Signal(times, values)]), is_quiet=is_quiet) / NOISE
        for is_quiet in (False, True)
    )
    assert whole > 10.0 * quiet
    assert 0.5 < quiet < 6.0
