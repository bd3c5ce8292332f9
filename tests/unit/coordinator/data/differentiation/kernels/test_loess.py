"""The loess kernels against their definitions, and on polynomials that they must reproduce."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from atoll_coordinator.data.differentiation.kernels.loess import (
    DEGREES,
    RANGE,
    SPREADING,
    loess_into,
    spread_into,
    thin_into,
    validate_into,
)
from tests.oracles import smoothing as oracle


def uneven(rows, seed=0):
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.5, 1.5, rows)) * 0.1
    return times, np.sin(times) + 0.3 * rng.standard_normal(rows)


def loess(times, values, span, degree, weights=None, inverse_variance=None):
    fits, gains = np.empty((3, len(times))), np.empty((4, len(times)))
    whole = np.ones(len(times))
    weights, inverse_variance = (
        whole if weights is None else weights,
        whole if inverse_variance is None else inverse_variance,
    )
    loess_into(fits, gains, times, values, weights, inverse_variance, span, degree + 1)
    return fits, gains


@pytest.mark.parametrize(("span", "degree"), [(7, 1), (9, 2), (12, 3), (15, 4), (100, 3)])
@pytest.mark.parametrize("is_weighed", [False, True])
def test_loess_is_the_weighted_least_squares_fit(span, degree, is_weighed):
    times, values = uneven(40, seed=2)
    weights = np.random.default_rng(5).uniform(0.2, 1.0, 40) if is_weighed else np.ones(40)
    fits, gains = loess(times, values, span, degree, weights)
    for row in range(40):
        expected_fits, expected_gains = oracle.loess(times, values, weights, row, span, degree)
        used = min(degree + 1, 3)
        assert fits[:used, row] == pytest.approx(expected_fits[:used], rel=1e-7, abs=1e-7)
        assert gains[:used, row] == pytest.approx(expected_gains[:used], rel=1e-7)
        assert gains[3, row] == pytest.approx(expected_gains[-1], rel=1e-7)


def test_rows_that_are_known_less_well_make_what_is_fitted_more_uncertain():
    times, values = uneven(40, seed=3)
    rng = np.random.default_rng(6)
    inverse_variance = rng.uniform(0.1, 4.0, 40)
    _, gains = loess(times, values, 12, 3, inverse_variance, inverse_variance)
    for row in range(40):
        _, expected = oracle.loess(times, values, inverse_variance, row, 12, 3, inverse_variance)
        assert gains[:, row] == pytest.approx(expected, rel=1e-7)
    drawn = [
        loess(times, rng.standard_normal(40) / np.sqrt(inverse_variance), 12, 3, inverse_variance)[0]
        for _ in range(1500)
    ]
    assert np.std(drawn, axis=0) == pytest.approx(gains[:3], rel=0.1)


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


@pytest.mark.parametrize("every", [1, 3])
def test_cross_validation_sums_are_those_of_the_fits(every):
    times, values = uneven(30, seed=3)
    weights = np.random.default_rng(6).uniform(0.2, 1.0, 30)
    weights[7] = 0.0
    sums = np.zeros((3, DEGREES))
    validate_into(sums, times, values, weights, 11, every)
    fits, gains = loess(times, values, 11, 3, weights)
    judged = (np.arange(30) * SPREADING) % RANGE < RANGE // every
    assert abs(judged.sum() - 30 / every) <= 1
    squares = (values - fits[0]) ** 2
    assert sums[0, 3] == pytest.approx(np.sum((weights * squares)[judged]), rel=1e-9)
    assert sums[1, 3] == pytest.approx(np.sum((weights * gains[3])[judged]), rel=1e-9)
    assert sums[2, 3] == pytest.approx(np.sum(weights[judged]), rel=1e-12)


def test_a_window_that_cannot_bear_a_degree_scores_infinity():
    sums = np.zeros((3, DEGREES))
    validate_into(sums, np.arange(5.0), np.arange(5.0) ** 2, np.ones(5), 5, 1)
    assert np.isfinite(sums[0, :4]).all()
    assert np.isinf(sums[0, 4])


def test_a_row_without_weight_does_not_count():
    times, values = uneven(40, seed=4)
    wild, weights = values.copy(), np.ones(40)
    wild[20], weights[20] = 1e6, 0.0
    others = np.arange(40) != 20
    fits, gains = loess(times, values, 11, 3, weights)
    wild_fits, _ = loess(times, wild, 11, 3, weights)
    assert wild_fits == pytest.approx(fits, abs=1e-7)
    assert gains[3, 20] == 0.0
    assert (gains[3, others] > 0.0).all()


def test_where_few_rows_are_trusted_the_window_is_wider():
    """Of five rows two have a positive weight. A cubic needs four, and cross-validation needs one more."""
    times = np.arange(40.0)
    values, weights = times**3, np.zeros(40)
    weights[::3] = 1.0
    values[weights == 0.0] = 1e9
    fits, _ = loess(times, values, 5, 3, weights)
    assert fits[0] == pytest.approx(times**3, abs=1e-4)
    assert fits[1] == pytest.approx(3 * times**2, abs=1e-4)
    sums = np.zeros((3, DEGREES))
    validate_into(sums, times, values, weights, 5, 1)
    assert sums[0, 3] == pytest.approx(0.0, abs=1e-9)
    assert sums[2, 3] == weights.sum()


def test_where_no_row_is_trusted_all_are():
    times, values = uneven(30, seed=5)
    trusting, _ = loess(times, values, 30, 2, np.ones(30))
    distrusting, _ = loess(times, values, 30, 2, np.zeros(30))
    assert distrusting.tolist() == trusting.tolist()


def bins_of(times, values, weights, bins):
    thinned = np.empty(bins), np.empty(bins), np.empty(bins)
    thin_into(*thinned, times, values, weights)
    return thinned


@pytest.mark.parametrize(("rows", "bins"), [(20, 5), (23, 5), (7, 7), (9, 2)])
def test_bins_have_the_means_of_their_rows(rows, bins):
    times, values = uneven(rows, seed=6)
    weights = np.random.default_rng(7).uniform(0.1, 1.0, rows)
    bin_times, bin_values, bin_trust = bins_of(times, values, weights, bins)
    for index in range(bins):
        part = slice(index * rows // bins, (index + 1) * rows // bins)
        assert bin_times[index] == pytest.approx(np.average(times[part], weights=weights[part]))
        assert bin_values[index] == pytest.approx(np.average(values[part], weights=weights[part]))
        assert bin_trust[index] == pytest.approx(np.mean(weights[part]))


def test_a_bin_without_a_trusted_row_has_none():
    times, values = uneven(12, seed=6)
    weights = np.ones(12)
    weights[4:8] = 0.0
    bin_times, bin_values, bin_trust = bins_of(times, values, weights, 3)
    assert bin_trust.tolist() == [1.0, 0.0, 1.0]
    assert (bin_times[1], bin_values[1]) == (pytest.approx(times[4:8].mean()), pytest.approx(values[4:8].mean()))


def test_bins_spread_over_the_rows_give_back_a_parabola():
    times, _ = uneven(60, seed=8)
    bin_times = np.linspace(times[2], times[-3], 12)
    curve = np.polynomial.Polynomial([0.3, -1.0, 2.0])
    bin_fits = np.array([curve(bin_times), curve.deriv()(bin_times), np.full(12, 4.0)])
    bin_gains = np.tile(np.array([[1.0], [2.0], [3.0], [0.5]]), 12)
    fits, gains = np.empty((3, 60)), np.empty((4, 60))
    spread_into(fits, gains, times, bin_times, bin_fits, bin_gains)
    assert fits == pytest.approx(np.array([curve(times), curve.deriv()(times), np.full(60, 4.0)]))
    assert gains[:3] == pytest.approx(bin_gains[:3, :1] / np.sqrt(5.0) * np.ones(60))
    assert gains[3] == pytest.approx(np.full(60, 0.1))
