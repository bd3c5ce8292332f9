"""Loess: its span and degree follow the noise, and the noise is estimated."""

import numpy as np
import pytest

from atoll_coordinator.data.differentiation.smoothing import Choice, Run, choose, noise_of, smooth


def noisy(deviation, rows=200, runs=2, seed=0):
    rng = np.random.default_rng(seed)
    times = np.linspace(0.0, 12.0, rows)
    return [Run(times, np.sin(times + run) + deviation * rng.standard_normal(rows)) for run in range(runs)]


def test_more_noise_is_smoothed_over_more_rows():
    spans = [choose(noisy(deviation), (3, 4)).span for deviation in (0.0, 0.001, 0.05, 0.4)]
    assert spans == sorted(spans)
    assert spans[0] < 10
    assert spans[-1] > 40


def test_noise_is_estimated():
    for deviation in (0.01, 0.1):
        runs = noisy(deviation, rows=400)
        choice = choose(runs, (3, 4))
        assert noise_of(runs, [smooth(run, choice) for run in runs]) == pytest.approx(deviation, rel=0.1)


def test_only_the_degrees_allowed_are_chosen():
    for degrees in ((2,), (3, 4), (1,)):
        assert choose(noisy(0.1), degrees).degree in degrees


def test_smoothing_is_closer_to_the_truth_than_the_data():
    runs = noisy(0.1)
    smoothed = smooth(runs[0], choose(runs, (3, 4)))
    truth = np.sin(runs[0].times)
    assert np.std(smoothed.fits[0] - truth) < 0.5 * 0.1
    assert np.std(smoothed.fits[1] - np.cos(runs[0].times)) < 0.2


def test_standard_errors_cover_the_truth():
    """Of 400 slopes, at least 80 % lie within two standard errors (bias takes its share)."""
    runs = noisy(0.1, rows=400, runs=1)
    choice = choose(runs, (3, 4))
    smoothed = smooth(runs[0], choice)
    errors = smoothed.fits[1] - np.cos(runs[0].times)
    covered = np.abs(errors) < 2 * noise_of(runs, [smoothed]) * smoothed.gains[1]
    assert covered.mean() > 0.8


@pytest.mark.parametrize("rows", [5, 6, 7, 9])
def test_short_runs_are_smoothed(rows):
    runs = [Run(np.arange(float(rows)), np.arange(float(rows)) ** 2)]
    choice = choose(runs, (3, 4))
    fits = smooth(runs[0], choice).fits
    assert fits[0] == pytest.approx(runs[0].values, abs=1e-9)
    assert fits[1] == pytest.approx(2 * runs[0].times, abs=1e-7)


def test_runs_of_different_lengths_share_a_span():
    runs = [*noisy(0.1), Run(np.arange(8.0), np.sin(np.arange(8.0)))]
    assert np.isfinite(smooth(runs[2], Choice(50, 4, 0.0)).fits).all()


def test_many_rows_are_smoothed_over_spans_of_many_rows():
    """Of 20,000 rows in one slow wave, a span of 1,001 would use only a small part."""
    runs = noisy(0.1, rows=10_000)
    choice = choose(runs, (3, 4))
    assert choice.thinning == 10
    assert choice.rows > 1500
    for run, phase in zip(runs, (0.0, 1.0), strict=True):
        smoothed = smooth(run, choice)
        assert np.abs(smoothed.fits[0] - np.sin(run.times + phase)).max() < 0.02
        assert np.std(smoothed.fits[1] - np.cos(run.times + phase)) < 0.02
    smoothed = [smooth(run, choice) for run in runs]
    assert noise_of(runs, smoothed) == pytest.approx(0.1, rel=0.02)


def test_standard_errors_of_thinned_rows_are_those_of_the_rows():
    """The error of the slope over 40 draws has the deviation that its gain tells."""
    choice = Choice(60, 3, 0.0, thinning=10)
    errors, gains = [], []
    for seed in range(40):
        (run,) = noisy(0.1, rows=4000, runs=1, seed=seed)
        smoothed = smooth(run, choice)
        errors.append(smoothed.fits[1, 400:-400:400] - np.cos(run.times[400:-400:400]))
        gains.append(smoothed.gains[1, 400:-400:400])
    assert np.std(errors) == pytest.approx(0.1 * np.mean(gains), rel=0.15)


def test_rows_are_thinned_only_as_far_as_the_signal_bears():
    """Two hundred waves in 10,000 rows need narrow spans."""
    times = np.linspace(0.0, 400.0 * np.pi, 10_000)
    runs = [Run(times, np.sin(times) + 0.01 * np.random.default_rng(0).standard_normal(10_000))]
    choice = choose(runs, (3, 4))
    assert choice.thinning == 1
    assert choice.span < 50
    assert np.std(smooth(runs[0], choice).fits[1] - np.cos(times)) < 0.05


def test_a_wave_that_vanishes_in_means_is_not_thinned_away():
    """At first a bin would be exactly one wave."""
    times = 0.1 * np.arange(20_000)
    runs = [Run(times, np.sin(2 * np.pi * times) + 0.1 * np.random.default_rng(0).standard_normal(20_000))]
    choice = choose(runs, (3, 4))
    assert choice.thinning == 1
    assert np.std(smooth(runs[0], choice).fits[0] - np.sin(2 * np.pi * times)) < 0.1


def test_many_short_runs_are_not_thinned():
    rng = np.random.default_rng(0)
    times = np.arange(0.0, 50.0, 0.5)
    runs = [Run(times, np.sin(times + phase) + 0.05 * rng.standard_normal(100)) for phase in range(60)]
    choice = choose(runs, (3, 4))
    assert choice.thinning == 1
    assert noise_of(runs, [smooth(run, choice) for run in runs]) == pytest.approx(0.05, rel=0.1)


@pytest.mark.parametrize("rows", [5, 12, 19, 150])
def test_a_short_run_among_long_ones_is_thinned_less(rows):
    """Its slopes are still those of its curve, over the same span of time."""
    times = np.linspace(0.0, 12.0, 12_000)
    long = Run(times, np.sin(times) + 0.1 * np.random.default_rng(0).standard_normal(12_000))
    short = Run(times[:rows], 3.0 * times[:rows])
    choice = choose([long, short], (3, 4))
    assert choice.thinning == 6
    assert smooth(short, choice).fits[1] == pytest.approx(np.full(rows, 3.0), rel=1e-6)


def test_distrusted_rows_do_not_count():
    runs = noisy(0.05, rows=300)
    trust = np.ones(300)
    trust[::20] = 0.0
    wild = runs[0].values.copy()
    wild[::20] += 50.0
    weighed = [Run(runs[0].times, wild, trust), runs[1]]
    choice = choose(weighed, (3, 4))
    assert choice.span == pytest.approx(choose(runs, (3, 4)).span, rel=0.6)
    assert noise_of(weighed, [smooth(run, choice) for run in weighed]) == pytest.approx(0.05, rel=0.1)
