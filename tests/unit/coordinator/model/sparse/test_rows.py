"""Rows: integrals against test functions with their errors, and derivatives with errors of their own."""

import math

import numpy as np
import pytest
from scipy.integrate import quad

from atoll_coordinator.data.recording import StateSmoothing
from atoll_coordinator.model.sparse.atoms import product_atoms
from atoll_coordinator.model.sparse.many_variables import _short_windows, _weights, window_rows
from atoll_coordinator.model.sparse.rows import (
    MeasuredRows,
    RegressionRows,
    _select_blocks,
    half_width,
    rate_rows,
    weak_rows,
)
from atoll_coordinator.settings import SETTINGS
from tests.unit.coordinator.model.sparse.enzyme import NAMES, prepared

X, Y = 0, 1


def curves(rows=400, noise=0.0, seed=0):
    """Return x = sin t and y = cos t, so that dx/dt = y and dy/dt = -x, measured with noise."""
    times = 0.02 * np.arange(float(rows))
    smooth = np.array([np.sin(times), np.cos(times)])
    values = smooth + noise * np.random.default_rng(seed).normal(size=smooth.shape)
    return MeasuredRows(times, ((0, rows // 2), (rows // 2, rows)), values, smooth, np.array([noise, noise]))


def atoms(form, terms):
    return product_atoms(form.inputs, terms)


@pytest.mark.parametrize(("residual", "square"), [(1.0, 4.0), (0.5, 1.0), (0.01, 0.04), (0.0, 0.04)])
def test_the_misfit_of_residuals_is_that_of_their_sum_of_squares_or_the_least(residual, square):
    rows = RegressionRows(np.zeros((1, 4)), np.zeros(4), least=0.04)
    assert rows.assess((), (), np.full(4, residual)).misfit == pytest.approx(2.0 * math.log(square))


def test_without_noise_both_sides_are_equal():
    form = weak_rows(curves(), 0, 20)
    assert form.columns(atoms(form, [(Y,)]))[0] == pytest.approx(form.sides, abs=1e-5)


def test_no_window_reaches_over_the_end_of_a_trajectory():
    form = weak_rows(curves(), 0, 20)
    assert all(first % 200 + 41 <= 200 for first in form.first.tolist())
    assert weak_rows(curves(60), 0, 20) is None


@pytest.mark.parametrize(("rows", "variables"), [(2000, 1), (4000, 2), (20_000, 3)])
def test_windows_are_short_enough_to_determine_the_largest_library(rows, variables):
    half = half_width(curves(rows), StateSmoothing("x", "loess", 0.1, 0.1, span=rows), variables)
    terms = math.comb(variables + SETTINGS.sparse.degree, variables)
    assert 5 < half < rows / (SETTINGS.sparse.rows_per_term * terms)


@pytest.mark.parametrize("term", [(X, X), (X, X, X), (X, X, Y, Y)])
def test_powers_of_noisy_values_have_the_expectation_of_the_true_ones(term):
    def column(**noise):
        form = weak_rows(curves(**noise), 0, 20)
        return form.columns(atoms(form, [term]))[0]

    clean, noisy = column(), np.array([column(noise=0.3, seed=seed) for seed in range(400)])
    errors = noisy.std(axis=0) / 20.0
    assert np.abs((noisy.mean(axis=0) - clean) / errors).max() < 4.5


def test_the_variance_is_that_of_what_the_law_leaves():
    left = []
    for seed in range(300):
        form = weak_rows(curves(noise=0.05, seed=seed), 0, 20)
        left.append(form.sides - form.columns(atoms(form, [(Y,)]))[0])
    expected = form.variances(atoms(form, [(Y,)]), [1.0])
    assert np.array(left).var(axis=0) == pytest.approx(expected, rel=0.35)
    assert np.array(left).var() == pytest.approx(expected.mean(), rel=0.1)


@pytest.mark.parametrize("lengths", [[100_000], [30_000, 10], [100] * 500])
def test_stretches_spread_over_all_trajectories_stand_for_very_many_rows(lengths):
    block_ranges = _select_blocks(lengths)
    rows, ends = sum(end - first for first, end in block_ranges), np.cumsum(lengths)
    assert SETTINGS.rows.in_sums / 2 < rows <= SETTINGS.rows.in_sums
    assert all(
        np.searchsorted(ends, first, "right") == np.searchsorted(ends, end - 1, "right") for first, end in block_ranges
    )
    assert block_ranges[-1][1] > 0.9 * sum(lengths)


def test_of_few_rows_trajectories_are_whole():
    assert _select_blocks([5_000, 15_000]) == [(0, 5_000), (5_000, 20_000)]


def test_weights_integrate_cubics_times_the_test_function():
    times = np.array([[0.0, 0.1, 0.25, 0.3, 0.5]])
    bump, slope = _weights(times, 3)

    def function(t):
        return 1.0 + t - 4.0 * t**2 + 7.0 * t**3

    def test(t):
        return (1.0 - ((t - 0.25) / 0.25) ** 2) ** 2

    assert (bump @ function(times[0]))[0] == pytest.approx(quad(lambda t: test(t) * function(t), 0.0, 0.5)[0])
    by_parts = quad(lambda t: test(t) * (1.0 - 8.0 * t + 21.0 * t**2), 0.0, 0.5)[0]
    assert -(slope @ function(times[0]))[0] == pytest.approx(by_parts)


def test_noise_is_that_of_the_measurements():
    recording = prepared().recording
    rows = window_rows(recording, NAMES, ["b"])["b"]
    deviations = np.concatenate([part.measured for part in recording.trajectories], axis=1).std(axis=1)
    assert rows.measured.noise / deviations == pytest.approx([0.01, 0.01], rel=0.4)
    assert rows.target == 1


def test_windows_are_as_wide_as_the_sampling_resolves():
    coarse = window_rows(prepared().recording, NAMES, ["a"])["a"]
    fine = window_rows(prepared(runs=4, rows=121, step=0.025).recording, NAMES, ["a"])["a"]
    assert fine.bump.shape[1] > coarse.bump.shape[1]


def test_errors_reach_the_neighbours_of_the_same_trajectory():
    rows = window_rows(prepared().recording, NAMES, ["a"])["a"]
    last = int(np.flatnonzero(np.diff(rows.first) >= rows.bump.shape[1])[0])
    errors = np.zeros(len(rows.first))
    errors[last] = -2.0
    assert np.flatnonzero(rows.widen(errors)).tolist() == [last - 1, last]


def test_so_many_windows_stand_for_all_and_begin_early_and_late():
    runs, rows = 5000, 20
    numbers = np.arange(float(runs * rows))[None]
    ranges = tuple((rows * run, rows * (run + 1)) for run in range(runs))
    windows = _short_windows(MeasuredRows(numbers[0], ranges, numbers, numbers, np.zeros(1)), 0, 2)
    assert SETTINGS.rows.most <= len(windows.first) < 2 * SETTINGS.rows.most
    assert windows.share == 1.0
    assert set((windows.first % rows).tolist()) == set(range(0, 16, 2))


@pytest.mark.slow
def test_as_many_rows_as_a_search_is_given_stand_for_all():
    few, many = (prepared(0.0, runs, 101).recording for runs in (10, 60))
    known = sum(int(np.isfinite(part.rate_errors[0]).sum()) for part in few.trajectories)
    assert len(rate_rows(few, NAMES, "a").sides) == known
    rows = rate_rows(many, NAMES, "a")
    assert SETTINGS.rows.most <= len(rows.sides) < 2 * SETTINGS.rows.most
    assert rows.inputs.shape == (2, len(rows.sides))
    assert rows.side_errors.shape == rows.sides.shape
    whole = np.concatenate([part.smoothed for part in many.trajectories], axis=1)
    assert np.isin(rows.inputs[0], whole[0]).all()
    assert np.median(np.abs(rows.sides - (1.0 - 3.0 * rows.inputs[0] / (0.4 + rows.inputs[0])))) < 1e-4
