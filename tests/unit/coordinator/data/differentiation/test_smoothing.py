"""Loess: its span and degree follow the noise."""

import numpy as np
import pytest

from atoll_coordinator.data.differentiation.smoothing import Signal, Smoother, estimate_noise, select_smoother, smooth


def noisy(deviation, rows=200, signals=2, seed=0):
    rng = np.random.default_rng(seed)
    times = np.linspace(0.0, 12.0, rows)
    return [Signal(times, np.sin(times + signal) + deviation * rng.standard_normal(rows)) for signal in range(signals)]


def test_more_noise_is_smoothed_over_more_rows():
    spans = [select_smoother(noisy(deviation), (3, 4)).span for deviation in (0.0, 0.001, 0.05, 0.4)]
    assert spans == sorted(spans)
    assert spans[0] < 10
    assert spans[-1] > 40


def test_only_the_degrees_allowed_are_chosen():
    for degrees in ((2,), (3, 4), (1,)):
        assert select_smoother(noisy(0.1), degrees).degree in degrees


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


def test_runs_of_different_lengths_share_a_span():
    signals = [*noisy(0.1), Signal(np.arange(8.0), np.sin(np.arange(8.0)))]
    assert np.isfinite(smooth(signals[2], Smoother(50, 4, 0.0)).fits).all()


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


def test_many_short_runs_are_not_thinned():
    rng = np.random.default_rng(0)
    times = np.arange(0.0, 50.0, 0.5)
    signals = [Signal(times, np.sin(times + phase) + 0.05 * rng.standard_normal(100)) for phase in range(60)]
    smoother = select_smoother(signals, (3, 4))
    assert smoother.thinning == 1
    assert estimate_noise(signals, smoother) == pytest.approx(0.05, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("rows", [5, 12, 19, 150])
def test_a_short_run_among_long_ones_is_thinned_less(rows):
    """Its slopes are still those of its curve, over the same span of time."""
    times = np.linspace(0.0, 12.0, 12_000)
    long = Signal(times, np.sin(times) + 0.1 * np.random.default_rng(0).standard_normal(12_000))
    short = Signal(times[:rows], 3.0 * times[:rows])
    smoother = select_smoother([long, short], (3, 4))
    assert smoother.thinning == 6
    assert smooth(short, smoother).fits[1] == pytest.approx(np.full(rows, 3.0), rel=1e-6)


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
