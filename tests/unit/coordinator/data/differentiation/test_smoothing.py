"""Loess: its span and degree follow the noise; robust loess takes weight from outliers, not from noise."""

import numpy as np
import pytest

from atoll_coordinator.data.differentiation.derivatives import Differentiation, estimate_derivatives
from atoll_coordinator.data.differentiation.smoothing import (
    Signal,
    Smoother,
    estimate_noise,
    fit_robustly,
    has_heavy_tails,
    select_smoother,
    smooth,
    weigh_by,
)


def noisy(deviation, rows=200, signals=2, seed=0):
    rng = np.random.default_rng(seed)
    times = np.linspace(0.0, 12.0, rows)
    return [Signal(times, np.sin(times + signal) + deviation * rng.standard_normal(rows)) for signal in range(signals)]


def test_more_noise_is_smoothed_over_more_rows():
    spans = [select_smoother(noisy(deviation), (3, 4)).span for deviation in (0.0, 0.001, 0.05, 0.4)]
    assert spans == sorted(spans)
    assert spans[0] < 10
    assert spans[-1] > 40


def test_smoothing_is_closer_to_the_truth_than_the_data():
    signals = noisy(0.1)
    smoothed = smooth(signals[0], select_smoother(signals, (3, 4)))
    truth = np.sin(signals[0].times)
    assert np.std(smoothed.fits[0] - truth) < 0.5 * 0.1
    assert np.std(smoothed.fits[1] - np.cos(signals[0].times)) < 0.2


def test_standard_errors_cover_the_truth():
    """Of 400 slopes, at least 80 % lie within two standard errors (bias takes its share)."""
    signals = noisy(0.1, rows=400, signals=1)
    smoother = select_smoother(signals, (3, 4))
    smoothed = smooth(signals[0], smoother)
    errors = smoothed.fits[1] - np.cos(signals[0].times)
    covered = np.abs(errors) < 2 * estimate_noise(signals, smoother) * smoothed.gains[1]
    assert covered.mean() > 0.8


@pytest.mark.parametrize("rows", [5, 6, 7, 9])
def test_short_runs_are_smoothed(rows):
    signals = [Signal(np.arange(float(rows)), np.arange(float(rows)) ** 2)]
    smoother = select_smoother(signals, (3, 4))
    fits = smooth(signals[0], smoother).fits
    assert fits[0] == pytest.approx(signals[0].values, abs=1e-9)
    assert fits[1] == pytest.approx(2 * signals[0].times, abs=1e-7)


def test_many_rows_are_smoothed_over_spans_of_many_rows():
    """Of 20,000 rows in one slow wave, a span of 1,001 would use only a small part."""
    signals = noisy(0.1, rows=10_000)
    smoother = select_smoother(signals, (3, 4))
    assert smoother.thinning == 10
    assert smoother.rows > 1500
    for signal, phase in zip(signals, (0.0, 1.0), strict=True):
        smoothed = smooth(signal, smoother)
        assert np.abs(smoothed.fits[0] - np.sin(signal.times + phase)).max() < 0.02
        assert np.std(smoothed.fits[1] - np.cos(signal.times + phase)) < 0.02
    assert estimate_noise(signals, smoother) == pytest.approx(0.1, rel=0.02)


def test_standard_errors_of_thinned_rows_are_those_of_the_rows():
    """The error of the slope over 40 draws has the deviation that its gain tells."""
    smoother = Smoother(60, 3, 0.0, thinning=10)
    errors, gains = [], []
    for seed in range(40):
        (signal,) = noisy(0.1, rows=4000, signals=1, seed=seed)
        smoothed = smooth(signal, smoother)
        errors.append(smoothed.fits[1, 400:-400:400] - np.cos(signal.times[400:-400:400]))
        gains.append(smoothed.gains[1, 400:-400:400])
    assert np.std(errors) == pytest.approx(0.1 * np.mean(gains), rel=0.15)


def test_rows_are_thinned_only_as_far_as_the_signal_bears():
    """Two hundred waves in 10,000 rows need narrow spans."""
    times = np.linspace(0.0, 400.0 * np.pi, 10_000)
    signals = [Signal(times, np.sin(times) + 0.01 * np.random.default_rng(0).standard_normal(10_000))]
    smoother = select_smoother(signals, (3, 4))
    assert smoother.thinning == 1
    assert smoother.span < 50
    assert np.std(smooth(signals[0], smoother).fits[1] - np.cos(times)) < 0.05


@pytest.mark.slow
def test_a_wave_that_vanishes_in_means_is_not_thinned_away():
    """At first a bin would be exactly one wave."""
    times = 0.1 * np.arange(20_000)
    signals = [Signal(times, np.sin(2 * np.pi * times) + 0.1 * np.random.default_rng(0).standard_normal(20_000))]
    smoother = select_smoother(signals, (3, 4))
    assert smoother.thinning == 1
    assert np.std(smooth(signals[0], smoother).fits[0] - np.sin(2 * np.pi * times)) < 0.1


def test_rows_without_weight_do_not_count():
    signals = noisy(0.05, rows=300)
    weights = np.ones(300)
    weights[::20] = 0.0
    wild = signals[0].values.copy()
    wild[::20] += 50.0
    weighted = [Signal(signals[0].times, wild, weights), signals[1]]
    smoother = select_smoother(weighted, (3, 4))
    assert smoother.span == pytest.approx(select_smoother(signals, (3, 4)).span, rel=0.6)
    assert estimate_noise(weighted, smoother) == pytest.approx(0.05, rel=0.1)


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
