"""Loess: its span and degree follow the noise, and the noise is estimated."""

import numpy as np
import pytest

from coordinator.data.smoothing import Choice, Run, choose, noise_of, smooth


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
