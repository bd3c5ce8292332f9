"""The smoothing kernels against their definitions, and against polynomials that they must reproduce."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coordinator.data.kernels_smoothing import (
    DEGREES,
    HALF_WIDTHS,
    best_stencil_into,
    differences_into,
    left_out_into,
    loess_into,
    moments,
    validate_into,
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


def loess(times, values, span, degree):
    fits, gains = np.empty((3, len(times))), np.empty((4, len(times)))
    loess_into(fits, gains, times, values, span, degree + 1)
    return fits, gains


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


@pytest.mark.parametrize(("span", "degree"), [(7, 1), (9, 2), (12, 3), (15, 4), (100, 3)])
def test_loess_is_the_weighted_least_squares_fit(span, degree):
    times, values = uneven(40, seed=2)
    fits, gains = loess(times, values, span, degree)
    for row in range(40):
        expected_fits, expected_gains = oracle.loess(times, values, row, span, degree)
        used = min(degree + 1, 3)
        assert fits[:used, row] == pytest.approx(expected_fits[:used], rel=1e-7, abs=1e-7)
        assert gains[:used, row] == pytest.approx(expected_gains[:used], rel=1e-7)
        assert gains[3, row] == pytest.approx(expected_gains[-1], rel=1e-7)


@settings(max_examples=40, deadline=None)
@given(
    steps=st.lists(st.floats(0.05, 2.0), min_size=12, max_size=30),
    coefficients=st.lists(st.floats(-3.0, 3.0), min_size=5, max_size=5),
    degree=st.integers(1, 4),
)
def test_loess_reproduces_polynomials_of_its_degree(steps, coefficients, degree):
    times = np.cumsum(steps) - 0.5 * sum(steps)
    polynomial = np.polynomial.Polynomial(coefficients[: degree + 1])
    fits, _ = loess(times, polynomial(times), 11, degree)
    scale = 1.0 + np.abs(polynomial(times)).max()
    assert fits[0] == pytest.approx(polynomial(times), abs=1e-7 * scale)
    assert fits[1] == pytest.approx(polynomial.deriv()(times), abs=1e-4 * scale)


def test_cross_validation_sums_are_those_of_fits_without_the_row():
    times, values = uneven(30, seed=3)
    sums = np.zeros((3, DEGREES))
    validate_into(sums, times, values, 11, 1)
    fits, gains = loess(times, values, 11, 3)
    residuals = values - fits[0]
    assert sums[0, 3] == pytest.approx(np.sum(residuals**2), rel=1e-9)
    assert sums[1, 3] == pytest.approx(np.sum(gains[3]), rel=1e-9)
    assert sums[2, 3] == pytest.approx(np.sum((residuals / (1 - gains[3])) ** 2), rel=1e-9)


def test_a_window_that_cannot_bear_a_degree_scores_infinity():
    sums = np.zeros((3, DEGREES))
    validate_into(sums, np.arange(5.0), np.arange(5.0) ** 2, 5, 1)
    assert np.isfinite(sums[0, :4]).all()
    assert np.isinf(sums[0, 4])


def test_moments_are_mean_and_population_deviation():
    values = np.random.default_rng(4).normal(3.0, 2.0, 1000)
    assert moments(values) == pytest.approx((values.mean(), values.std()))
