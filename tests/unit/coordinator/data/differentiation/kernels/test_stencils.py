"""The interpolation kernels against their definitions."""

import numpy as np
import pytest

from atoll_coordinator.data.differentiation.kernels.stencils import (
    HALF_WIDTHS,
    best_stencil_into,
    differences_into,
    left_out_into,
    moments,
)
from tests.oracles import smoothing as oracle


def uneven(rows, seed=0):
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.5, 1.5, rows)) * 0.1
    return times, np.sin(times) + 0.3 * rng.standard_normal(rows)


def differences(times, values, order):
    slopes, gains = np.empty((len(times), HALF_WIDTHS)), np.empty((len(times), HALF_WIDTHS))
    differences_into(slopes, gains, times, values, order)
    return slopes, gains


@pytest.mark.parametrize("order", [1, 2])
def test_differences_are_those_of_the_interpolating_polynomial(order):
    times, values = uneven(24)
    slopes, gains = differences(times, values, order)
    for row in range(len(times)):
        for width in range(4):
            expected = oracle.stencil_derivative(times, values, row, 2 * width + 3, order)
            assert slopes[row, width] == pytest.approx(expected[0], rel=1e-6, abs=1e-6 * expected[1])
            assert gains[row, width] == pytest.approx(expected[1], rel=1e-6)


def test_differences_of_even_steps_are_the_textbook_ones():
    """At unit steps the five-row stencil is (1, -8, 0, 8, -1) / 12."""
    values = np.zeros(9)
    values[4] = 1.0
    slopes, _ = differences(np.arange(9.0), values, 1)
    assert slopes[2:7, 1] * 12 == pytest.approx([-1, 8, 0, -8, 1])


def test_a_short_trajectory_has_no_wide_stencil():
    slopes, gains = differences(np.arange(6.0), np.arange(6.0), 1)
    assert np.isfinite(slopes[:, :2]).all()
    assert np.isnan(slopes[:, 2:]).all()
    assert np.isnan(gains[:, 2:]).all()


def test_left_out_errors_are_those_of_the_definition():
    times, values = uneven(20, seed=1)
    errors, gains = np.empty((20, HALF_WIDTHS)), np.empty((20, HALF_WIDTHS))
    left_out_into(errors, gains, times, values)
    for row in range(20):
        for width in range(4):
            error, gain = oracle.left_out_error(times, values, row, 2 * width + 3)
            assert errors[row, width] == pytest.approx(error, rel=1e-6, abs=1e-9 * gain)
            assert gains[row, width] == pytest.approx(gain, rel=1e-6)


def test_the_best_stencil_has_the_smallest_step_from_the_next_narrower_one():
    slopes = np.tile(np.array([1.0, 1.1, 1.101, 1.1010001, 1.2, 3.0, 9.0]), (8, 1))
    slope, uncertainty = np.empty(8), np.empty(8)
    best_stencil_into(slope, uncertainty, slopes, np.ones_like(slopes), np.zeros(8))
    assert slope == pytest.approx(np.full(8, 1.1010001))
    assert uncertainty == pytest.approx(np.full(8, 1e-7))


def test_noise_of_the_values_is_part_of_the_uncertainty():
    slopes = np.ones((8, HALF_WIDTHS))
    gains = np.tile(np.arange(1.0, HALF_WIDTHS + 1.0), (8, 1))
    slope, uncertainty = np.empty(8), np.empty(8)
    best_stencil_into(slope, uncertainty, slopes, gains, np.full(8, 0.5))
    assert uncertainty == pytest.approx(np.full(8, 1.0))


def test_moments_are_mean_and_population_deviation():
    values = np.random.default_rng(4).normal(3.0, 2.0, 1000)
    assert moments(values) == pytest.approx((values.mean(), values.std()))
