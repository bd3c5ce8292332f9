"""Integrals against test functions: an identity along smooth curves, noise that has no mean, its variance."""

import numpy as np
import pytest

from atoll_coordinator.model.sparse.weak_form import Measured, _stretches, weak_form
from atoll_coordinator.settings import SETTINGS

X, Y = 0, 1


def curves(rows=400, noise=0.0, seed=0):
    """Return x = sin t and y = cos t, so that dx/dt = y and dy/dt = -x, measured with noise."""
    times = 0.02 * np.arange(float(rows))
    smooth = np.array([np.sin(times), np.cos(times)])
    values = smooth + noise * np.random.default_rng(seed).normal(size=smooth.shape)
    return Measured(times, ((0, rows // 2), (rows // 2, rows)), values, smooth, np.array([noise, noise]))


def test_without_noise_both_sides_are_equal():
    form = weak_form(curves(), 0, 20)
    assert form.columns([(Y,)])[0] == pytest.approx(form.sides, abs=1e-5)


def test_no_window_reaches_over_the_end_of_a_trajectory():
    form = weak_form(curves(), 0, 20)
    assert all(first % 200 + 41 <= 200 for first in form.first.tolist())
    assert weak_form(curves(60), 0, 20) is None


@pytest.mark.parametrize("term", [(X, X), (X, X, X), (X, X, Y, Y)])
def test_powers_of_noisy_values_have_the_expectation_of_the_true_ones(term):
    clean = weak_form(curves(), 0, 20).columns([term])[0]
    noisy = np.array([weak_form(curves(noise=0.3, seed=seed), 0, 20).columns([term])[0] for seed in range(400)])
    errors = noisy.std(axis=0) / 20.0
    assert np.abs((noisy.mean(axis=0) - clean) / errors).max() < 4.5


def test_the_variance_is_that_of_what_the_law_leaves():
    left = []
    for seed in range(300):
        form = weak_form(curves(noise=0.05, seed=seed), 0, 20)
        left.append(form.sides - form.columns([(Y,)])[0])
    expected = form.variances([(Y,)], [1.0])
    assert np.array(left).var(axis=0) == pytest.approx(expected, rel=0.35)
    assert np.array(left).var() == pytest.approx(expected.mean(), rel=0.1)


@pytest.mark.parametrize("lengths", [[100_000], [30_000, 10], [100] * 500])
def test_stretches_spread_over_all_trajectories_stand_for_very_many_rows(lengths):
    stretches = _stretches(lengths)
    rows, ends = sum(end - first for first, end in stretches), np.cumsum(lengths)
    assert SETTINGS.sparse.most_rows / 2 < rows <= SETTINGS.sparse.most_rows
    assert all(
        np.searchsorted(ends, first, "right") == np.searchsorted(ends, end - 1, "right") for first, end in stretches
    )
    assert stretches[-1][1] > 0.9 * sum(lengths)


def test_of_few_rows_trajectories_are_whole():
    assert _stretches([5_000, 15_000]) == [(0, 5_000), (5_000, 20_000)]
