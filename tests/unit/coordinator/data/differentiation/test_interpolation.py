"""Noise by predicted rows, and missing values from a state's own rows."""

import math

import numpy as np
import pytest

from atoll_coordinator.data.differentiation.derivatives import Differentiation, estimate_derivatives
from atoll_coordinator.data.differentiation.interpolation import (
    estimate_value_noise,
    fill,
    make_signal,
    predict_left_out,
)
from atoll_coordinator.data.differentiation.smoothing import Signal, smooth
from tests.oracles import missing_values as oracle

NOISE = 0.01


def estimated(rows, seed, uneven, amplitude=0.0):
    """Return the estimated over the true standard deviation of the errors of a wave."""
    rng = np.random.default_rng(seed)
    times = 0.05 * np.cumsum(rng.uniform(0.5, 1.5, rows) if uneven else np.ones(rows))
    values = amplitude * np.sin(times) + NOISE * rng.standard_normal(rows)
    return estimate_value_noise(*predict_left_out([Signal(times, values)])) / NOISE


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


ROWS = 120
TIMES = 0.05 * np.arange(ROWS)


def signal_without(rows, noise=0.0, seed=0):
    values = np.sin(TIMES) + noise * np.random.default_rng(seed).standard_normal(ROWS)
    values[rows] = math.nan
    return make_signal(TIMES, values)


@pytest.mark.parametrize("seed", range(3))
def test_a_polynomial_is_filled_exactly_between_known_rows(seed):
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.5, 1.5, 12))
    coefficients = rng.normal(size=4)
    values = np.polyval(coefficients, times)
    is_known = np.ones(12, np.bool_)
    is_known[rng.choice(np.arange(3, 9), 2, replace=False)] = False
    filled, steps, gains = fill(times, np.where(is_known, values, math.nan), is_known, 3)
    assert filled == pytest.approx(values, rel=1e-9, abs=1e-9)
    assert steps[is_known].tolist() == gains[is_known].tolist() == [0.0] * 10
    assert (gains[~is_known] > 0.0).all()


def test_the_nearest_value_is_held_beyond_the_known_rows_and_not_known():
    is_known = np.array([False, True, True, False])
    filled, steps, _ = fill(np.arange(4.0), np.array([math.nan, 2.0, 5.0, math.nan]), is_known, 2)
    assert filled.tolist() == [2.0, 2.0, 5.0, 5.0]
    assert np.isinf(steps).tolist() == [True, False, False, True]


@pytest.mark.parametrize("pairs", [1, 3, 7])
@pytest.mark.parametrize("share", [0.0, 0.2, 0.8, 1.0])
def test_many_rows_are_filled_as_one_after_another_to_the_bit(pairs, share):
    rng = np.random.default_rng(3)
    for rows in (1, 2, 9, 60):
        times, values = np.cumsum(rng.uniform(0.1, 1.0, rows)), np.round(rng.normal(size=rows), 1)
        is_known = rng.random(rows) < share
        values[~is_known] = math.nan
        for filled, expected in zip(
            fill(times, values, is_known, pairs), oracle.fill(times, values, is_known, pairs), strict=True
        ):
            assert filled.tobytes() == expected.tobytes()


def test_a_million_rows_take_no_longer_than_each_of_them():
    """Were the known rows looked through for each missing one, this would take an hour."""
    rows = 1_000_000
    filled, steps, _ = fill(np.arange(float(rows)), np.arange(float(rows)), np.arange(rows) % 2 == 0, 1)
    assert filled[:-1].tolist() == np.arange(rows - 1.0).tolist()
    assert np.flatnonzero(np.isinf(steps)).tolist() == [rows - 1]


def test_without_noise_a_missing_value_has_a_derivative_from_its_neighbours():
    estimate = estimate_derivatives([signal_without([20, 61, 62])], Differentiation())
    assert estimate.is_interpolated
    assert estimate.is_known.all()
    assert estimate.values[[20, 61, 62]] == pytest.approx(np.sin(TIMES[[20, 61, 62]]), abs=1e-9)
    errors = np.abs(estimate.derivative - np.cos(TIMES))[5:-5]
    assert errors.max() < 1e-8
    assert (errors <= estimate.uncertainty[5:-5] + 1e-12).mean() > 0.9


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_beyond_its_own_rows_a_state_is_not_known(noise):
    estimate = estimate_derivatives([signal_without([*range(10), *range(100, ROWS)], noise)], Differentiation())
    assert estimate.is_interpolated is (noise == 0.0)
    assert not estimate.is_known[:8].any()
    assert estimate.is_known[10:100].all()
    assert not estimate.is_known[104:].any()
    assert np.isfinite(estimate.values).all()
    assert estimate.values[0] == estimate.values[np.flatnonzero(estimate.is_known)[0]]
    assert estimate.derivative[0] == estimate.velocity[0] == 0.0


def test_with_noise_holes_are_smoothed_over_and_long_ones_are_not_known():
    missing = [15, 33, 34, *range(50, 85)]
    estimate = estimate_derivatives([signal_without(missing, 0.02), signal_without([], 0.02, 1)], Differentiation())
    truth = np.tile(np.cos(TIMES), 2)
    assert estimate.is_known[[15, 33, 34]].all()
    assert not estimate.is_known[62:72].any()
    known = estimate.is_known & np.tile((TIMES > 0.5) & (TIMES < 5.5), 2)
    errors = np.abs(estimate.derivative - truth)[known]
    assert errors.mean() < 2.0 * estimate.total_uncertainty[known].mean()
    assert estimate.noise == pytest.approx(0.02, rel=0.25)


def test_missing_values_change_no_other_number_by_what_stands_in_for_them():
    signal = signal_without([15, 33, 34], 0.02)
    estimate = estimate_derivatives([signal], Differentiation())
    moved = type(signal)(TIMES, np.where(signal.is_measured > 0.0, signal.values, 7.0), None, None, signal.is_measured)
    other = estimate_derivatives([moved], Differentiation())
    assert other.derivative == pytest.approx(estimate.derivative, abs=1e-9)
    assert other.noise == pytest.approx(estimate.noise)
    assert other.has_heavy_tails == estimate.has_heavy_tails
    assert smooth(moved, estimate.smoother).gains[0] == pytest.approx(smooth(signal, estimate.smoother).gains[0])


def test_a_trajectory_with_too_few_values_is_not_known_and_decides_nothing():
    few = signal_without([*range(3, ROWS)], 0.02)
    alone = estimate_derivatives([signal_without([], 0.02, 1)], Differentiation())
    estimate = estimate_derivatives([few, signal_without([], 0.02, 1)], Differentiation())
    assert not estimate.is_known[:ROWS].any()
    assert np.isfinite(estimate.values).all()
    assert estimate.smoother == alone.smoother
    assert estimate.noise == alone.noise
    assert estimate.derivative[ROWS:].tolist() == alone.derivative.tolist()
