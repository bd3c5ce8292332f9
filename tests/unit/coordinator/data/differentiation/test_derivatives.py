"""Derivatives: exact where there is no noise, smoothed where there is, and always with an honest uncertainty."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from atoll_coordinator.data.differentiation.derivatives import Differentiation, estimate_derivatives
from atoll_coordinator.data.differentiation.interpolation import mark_ends
from atoll_coordinator.data.differentiation.smoothing import Signal


def waves(rows=200, noise=0.0, seed=0, uneven=False, scale=1.0, offset=0.0):
    """Return two signals of sin(t), with the true first and second derivatives of all rows."""
    rng = np.random.default_rng(seed)
    signals, first, second = [], [], []
    for phase in (0.0, 1.0):
        steps = rng.uniform(0.5, 1.5, rows) if uneven else np.ones(rows)
        times = np.cumsum(steps) * 0.05
        signals.append(Signal(times, offset + scale * (np.sin(times + phase) + noise * rng.standard_normal(rows))))
        first.append(scale * np.cos(times + phase))
        second.append(-scale * np.sin(times + phase))
    return signals, np.concatenate(first), np.concatenate(second)


@pytest.mark.parametrize("uneven", [False, True])
@pytest.mark.parametrize("order", [1, 2])
def test_data_without_noise_are_interpolated(order, uneven):
    signals, *truths = waves(uneven=uneven)
    estimate = estimate_derivatives(signals, Differentiation(order))
    inner = mark_ends([200, 200]) == 0
    assert estimate.is_interpolated
    assert estimate.target_noise == 0.0
    assert estimate.values.tolist() == [value for signal in signals for value in signal.values]
    errors = np.abs(estimate.derivative - truths[order - 1])[inner]
    assert errors.max() < 1e-9
    assert errors.mean() < estimate.uncertainty[inner].mean()


@pytest.mark.parametrize("noise", [0.003, 0.03, 0.3])
def test_noisy_data_are_smoothed(noise):
    signals, truth, _ = waves(noise=noise)
    estimate = estimate_derivatives(signals, Differentiation())
    assert not estimate.is_interpolated
    assert estimate.target_noise == pytest.approx(noise / np.std(truth), rel=0.2)
    error = np.abs(estimate.derivative - truth).mean()
    assert 0.4 * estimate.uncertainty.mean() < error < 3 * estimate.uncertainty.mean()


def test_the_second_derivative_of_noisy_data_is_smoothed():
    signals, first, second = waves(noise=0.01)
    estimate = estimate_derivatives(signals, Differentiation(2))
    assert np.std(estimate.velocity - first) < 0.1
    assert np.std(estimate.derivative - second) < 0.4


def test_a_jump_that_the_sampling_does_not_resolve_is_uncertain_where_it_is():
    times = np.arange(200) * 0.1
    signals = [Signal(times, np.sin(times) + np.tanh(40 * (times - 10.03)))]
    estimate = estimate_derivatives(signals, Differentiation())
    truth = np.cos(times) + 40 / np.cosh(np.clip(40 * (times - 10.03), -300, 300)) ** 2
    wrong = np.flatnonzero(np.abs(estimate.derivative - truth) > 1e-3)
    assert estimate.is_interpolated
    assert len(wrong)
    assert (estimate.uncertainty[wrong] > 1e-4).all()
    assert estimate.uncertainty[20] < 1e-6


@settings(max_examples=25, deadline=None)
@given(
    exponent=st.integers(-12, 12),
    offset=st.sampled_from([0.0, 1.0, -30.0]),
    noise=st.sampled_from([0.0, 0.05]),
    uneven=st.booleans(),
)
def test_scale_and_offset_of_the_values_change_nothing_else(exponent, offset, noise, uneven):
    scale = 10.0**exponent
    plain, _, _ = waves(60, noise, uneven=uneven)
    moved, _, _ = waves(60, noise, uneven=uneven, scale=scale, offset=offset * scale)
    estimate, others = estimate_derivatives(plain, Differentiation()), estimate_derivatives(moved, Differentiation())
    inner = mark_ends([60, 60]) == 0
    assert estimate.is_interpolated == others.is_interpolated
    tolerance = 3e-9 if estimate.is_interpolated else 1e-6
    assert others.derivative[inner] / scale == pytest.approx(estimate.derivative[inner], abs=tolerance)


@pytest.mark.parametrize("rows", [5, 6, 8, 15, 16])
def test_short_trajectories_have_derivatives(rows):
    times = np.arange(rows) * 0.01
    estimate = estimate_derivatives([Signal(times, np.exp(times))], Differentiation())
    assert estimate.derivative == pytest.approx(np.exp(times), rel=1e-4)
    assert np.isfinite(estimate.uncertainty).all()


def test_slow_data_in_steps_are_not_known_better_than_to_the_step():
    """Runs of equal values look free of noise to all that compares neighbours."""
    times = 0.01 * np.arange(400)
    values = np.round(np.sin(0.2 * times) / 0.05) * 0.05
    assert estimate_derivatives([Signal(times, values)], Differentiation(), least_noise=0.0144).noise >= 0.0144


@pytest.mark.parametrize("seed", range(4))
def test_noise_is_not_none_because_the_last_rows_are_zeros(seed):
    """Rows of one value are predicted without an error whatever the noise of the others is."""
    times = np.arange(12.0)
    values = 10.0 * np.exp(-0.5 * times) + 0.3 * np.random.default_rng(seed).standard_normal(12)
    values[-4:] = 0.0
    estimate = estimate_derivatives([Signal(times, values)], Differentiation(1))
    assert not estimate.is_interpolated
    assert 0.05 < estimate.noise < 0.6
    clean = np.concatenate([np.zeros(5), np.arange(1.0, 20.0) ** 3])
    assert estimate_derivatives([Signal(np.arange(24.0), clean)], Differentiation(1)).noise < 0.05
