"""Robust loess: outliers lose their weight, noise does not."""

import numpy as np
import pytest

from atoll_coordinator.data.differentiation.derivatives import Way, estimate
from atoll_coordinator.data.differentiation.robust import has_heavy_tails, outliers, retrusted, trusted
from atoll_coordinator.data.differentiation.smoothing import Run, choose, smooth

DEGREES = (3, 4)


def waves(noise=0.05, share=0.0, size=10.0, rows=200, seed=0):
    """Return two runs of sin(t), some rows of which are `size` times the noise off, and where those are."""
    rng = np.random.default_rng(seed)
    runs, wrong = [], []
    for phase in (0.0, 1.0):
        times = 0.05 * np.arange(rows)
        is_off = rng.uniform(size=rows) < share
        values = np.sin(times + phase) + noise * rng.standard_normal(rows)
        values[is_off] += size * noise * rng.choice([-1.0, 1.0], int(is_off.sum()))
        runs.append(Run(times, values))
        wrong.append(is_off)
    return runs, wrong


def slope_error(its, rows=200):
    truth = np.concatenate([np.cos(0.05 * np.arange(rows) + phase) for phase in (0.0, 1.0)])
    return float(np.sqrt(np.mean((its.derivative - truth) ** 2)))


@pytest.mark.parametrize("share", [0.05, 0.15])
def test_outliers_are_found_and_good_rows_trusted(share):
    runs, wrong = waves(share=share)
    its = trusted(runs, DEGREES)
    for run, is_off in zip(its.runs, wrong, strict=True):
        assert (run.weights[is_off] == 0.0).all()
        assert (run.weights[~is_off] > 0.0).mean() > 0.98
        assert np.median(run.weights[~is_off]) > 0.8


def test_outliers_hardly_matter_when_smoothing_is_robust():
    clean = estimate(waves()[0], Way())
    plain = estimate(waves(share=0.08)[0], Way())
    robust = estimate(waves(share=0.08)[0], Way(robust=True))
    assert slope_error(robust) < 1.3 * slope_error(clean) < 0.7 * slope_error(plain)
    assert robust.error == pytest.approx(0.05, rel=0.15)
    assert plain.error > 0.1
    assert robust.deviation == pytest.approx(clean.deviation, rel=0.05)
    assert robust.outliers == int(sum(each.sum() for each in waves(share=0.08)[1]))


def test_without_outliers_robust_smoothing_is_the_ordinary_one():
    for noise in (0.0, 0.05):
        runs, _ = waves(noise)
        plain, robust = estimate(runs, Way()), estimate(runs, Way(robust=True))
        assert robust.outliers is None
        assert robust.interpolated == plain.interpolated
        assert robust.derivative.tolist() == plain.derivative.tolist()


def test_data_without_noise_keep_their_outliers_away():
    runs, _ = waves(noise=0.0)
    values = runs[0].values.copy()
    values[[20, 50, 90, 120]] += 0.5
    its = estimate([Run(runs[0].times, values), runs[1]], Way(robust=True))
    assert its.outliers is not None
    assert its.outliers >= 4
    assert its.trust is not None
    assert its.trust[[20, 50, 90, 120]].tolist() == [0.0] * 4
    assert slope_error(its) < 0.01


def test_another_run_is_weighed_by_the_same_measure():
    runs, _ = waves(share=0.05)
    others, wrong = waves(share=0.05, seed=1)
    its = trusted(runs, DEGREES)
    again = retrusted(others[0], its)
    assert (again.weights[wrong[0]] == 0.0).all()
    assert (again.weights[~wrong[0]] > 0.0).mean() > 0.98


def test_a_line_has_no_outliers():
    times = np.arange(50.0)
    assert outliers(trusted([Run(times, 0.0 * times), Run(times, 2.0 * times)], DEGREES).runs) <= 2


@pytest.mark.parametrize(("share", "expected"), [(0.0, False), (0.03, True), (0.1, True)])
def test_heavy_tails_are_seen(share, expected):
    for seed in range(3):
        runs, _ = waves(share=share, seed=seed)
        choice = choose(runs, DEGREES)
        assert has_heavy_tails(runs, [smooth(run, choice) for run in runs]) == expected


def test_a_jump_is_no_heavy_tail():
    """A jump that the sampling does not resolve leaves large residuals side by side."""
    times = 0.1 * np.arange(200)
    noise = 0.02 * np.random.default_rng(0).standard_normal(200)
    runs = [Run(times, np.tanh(8 * np.sin(times)) + noise)]
    choice = choose(runs, DEGREES)
    assert not has_heavy_tails(runs, [smooth(run, choice) for run in runs])
