"""Robust loess: outliers lose their weight, noise does not."""

import numpy as np
import pytest

from atoll_coordinator.data.differentiation.derivatives import Differentiation, estimate_derivatives
from atoll_coordinator.data.differentiation.smoothing import (
    Signal,
    fit_robustly,
    has_heavy_tails,
    select_smoother,
    smooth,
    weigh_by,
)

DEGREES = (3, 4)


def waves(noise=0.05, share=0.0, size=10.0, rows=200, seed=0):
    """Return two signals of sin(t), some rows of which are `size` times the noise off, and where those are."""
    rng = np.random.default_rng(seed)
    signals, wrong = [], []
    for phase in (0.0, 1.0):
        times = 0.05 * np.arange(rows)
        is_off = rng.uniform(size=rows) < share
        values = np.sin(times + phase) + noise * rng.standard_normal(rows)
        values[is_off] += size * noise * rng.choice([-1.0, 1.0], int(is_off.sum()))
        signals.append(Signal(times, values))
        wrong.append(is_off)
    return signals, wrong


def slope_error(estimate, rows=200):
    truth = np.concatenate([np.cos(0.05 * np.arange(rows) + phase) for phase in (0.0, 1.0)])
    return float(np.sqrt(np.mean((estimate.derivative - truth) ** 2)))


@pytest.mark.parametrize("share", [0.05, 0.15])
def test_outliers_are_found_and_good_rows_keep_their_weight(share):
    signals, wrong = waves(share=share)
    fit = fit_robustly(signals, DEGREES)
    for signal, is_off in zip(fit.signals, wrong, strict=True):
        assert (signal.weights[is_off] == 0.0).all()
        assert (signal.weights[~is_off] > 0.0).mean() > 0.98
        assert np.median(signal.weights[~is_off]) > 0.8


def test_outliers_hardly_matter_when_smoothing_is_robust():
    clean = estimate_derivatives(waves()[0], Differentiation())
    plain = estimate_derivatives(waves(share=0.08)[0], Differentiation())
    robust = estimate_derivatives(waves(share=0.08)[0], Differentiation(robust=True))
    assert slope_error(robust) < 1.3 * slope_error(clean) < 0.7 * slope_error(plain)
    assert robust.noise == pytest.approx(0.05, rel=0.15)
    assert plain.noise > 0.1
    assert robust.standard_deviation == pytest.approx(clean.standard_deviation, rel=0.05)
    assert robust.outliers == int(sum(is_off.sum() for is_off in waves(share=0.08)[1]))


def test_without_outliers_robust_smoothing_is_the_ordinary_one():
    for noise in (0.0, 0.05):
        signals, _ = waves(noise)
        plain, robust = (
            estimate_derivatives(signals, Differentiation()),
            estimate_derivatives(signals, Differentiation(robust=True)),
        )
        assert robust.outliers is None
        assert robust.is_interpolated == plain.is_interpolated
        assert robust.derivative.tolist() == plain.derivative.tolist()


def test_data_without_noise_keep_their_outliers_away():
    signals, _ = waves(noise=0.0)
    values = signals[0].values.copy()
    values[[20, 50, 90, 120]] += 0.5
    estimate = estimate_derivatives([Signal(signals[0].times, values), signals[1]], Differentiation(robust=True))
    assert estimate.outliers is not None
    assert estimate.outliers >= 4
    assert estimate.robustness_weights is not None
    assert estimate.robustness_weights[[20, 50, 90, 120]].tolist() == [0.0] * 4
    assert slope_error(estimate) < 0.01


def test_another_signal_is_weighed_by_the_same_measure():
    signals, _ = waves(share=0.05)
    others, wrong = waves(share=0.05, seed=1)
    fit = fit_robustly(signals, DEGREES)
    again = weigh_by(fit, others[0])
    assert (again.weights[wrong[0]] == 0.0).all()
    assert (again.weights[~wrong[0]] > 0.0).mean() > 0.98


def test_a_line_has_no_outliers():
    times = np.arange(50.0)
    assert fit_robustly([Signal(times, 0.0 * times), Signal(times, 2.0 * times)], DEGREES).outliers <= 2


@pytest.mark.parametrize(("share", "expected"), [(0.0, False), (0.03, True), (0.1, True)])
def test_heavy_tails_are_seen(share, expected):
    for seed in range(3):
        signals, _ = waves(share=share, seed=seed)
        smoother = select_smoother(signals, DEGREES)
        assert has_heavy_tails(signals, [smooth(signal, smoother) for signal in signals]) == expected


def test_a_jump_is_no_heavy_tail():
    """A jump that the sampling does not resolve leaves large residuals side by side."""
    times = 0.1 * np.arange(200)
    noise = 0.02 * np.random.default_rng(0).standard_normal(200)
    signals = [Signal(times, np.tanh(8 * np.sin(times)) + noise)]
    smoother = select_smoother(signals, DEGREES)
    assert not has_heavy_tails(signals, [smooth(signal, smoother) for signal in signals])
