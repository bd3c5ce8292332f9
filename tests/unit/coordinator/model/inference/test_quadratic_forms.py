"""Variances of a model's and a smoother's residuals compared: p is uniform for right models, small for wrong ones."""

from functools import lru_cache

import numpy as np
import pytest
from scipy import special, stats

from atoll_coordinator.data.differentiation.derivatives import Differentiation, estimate_derivatives
from atoll_coordinator.data.differentiation.smoothing import Signal, Smoother, smooth
from atoll_coordinator.model.inference.quadratic_forms import probability_of_positive_sum, variance_ratio_tail
from atoll_coordinator.model.inference.residuals import ReferenceSmoother, residual_statistics
from atoll_coordinator.model.loess_matrix import loess_matrix

DRAWS = 300


@pytest.mark.parametrize("ratio", [0.3, 1.0, 2.0, 6.0])
@pytest.mark.parametrize("counts", [(3, 10), (20, 200)])
def test_the_tail_of_a_ratio_of_independent_variances_is_that_of_f(ratio, counts):
    first, second = counts
    tails = probability_of_positive_sum(np.array([1.0 / first, -ratio / second]), np.array(counts, dtype=float))
    assert tails == pytest.approx(special.fdtrc(first, second, ratio), rel=0.06)


def test_the_tail_is_near_one_half_where_the_mean_is_zero():
    assert probability_of_positive_sum(np.array([1.0, -1.0]), np.array([7.0, 7.0])) == pytest.approx(0.5, abs=1e-12)
    draw = np.random.default_rng(0)
    sums = draw.chisquare(8, 200_000) - 2.0 * draw.chisquare(4, 200_000)
    assert probability_of_positive_sum(np.array([1.0, -2.0]), np.array([8.0, 4.0])) == pytest.approx(
        (sums > 0.0).mean(), abs=0.005
    )


def test_sums_of_one_sign_have_no_tail():
    assert probability_of_positive_sum(np.array([1.0, 0.0]), np.ones(2)) == 1.0
    assert probability_of_positive_sum(np.array([-1.0, 2.0]), np.array([1.0, 0.0])) == 0.0


@pytest.mark.parametrize(("rows", "span", "degree"), [(40, 15, 3), (41, 30, 4), (21, 40, 3)])
def test_the_matrix_of_loess_is_that_of_the_smoother(rows, span, degree):
    values = np.random.default_rng(1).normal(size=rows)
    smoothed = smooth(Signal(np.arange(float(rows)), values), Smoother(span, degree, 0.0))
    assert loess_matrix(rows, span, degree) @ values == pytest.approx(smoothed.fits[0], abs=1e-12)


def test_bins_and_stretches_represent_long_trajectories():
    """Thinned, cut short or many, the eigenvalues are those of all rows: a ratio has nearly the same probability."""
    whole = variance_ratio_tail(1.05, [480], 5.0, 39, 3)
    assert variance_ratio_tail(1.05, [480], 5.0, 41, 3) == pytest.approx(whole, rel=0.5)
    assert variance_ratio_tail(1.02, [960], 10.0, 160, 3) == pytest.approx(
        variance_ratio_tail(1.02, [960], 10.0, 159, 3), rel=0.3
    )
    many = variance_ratio_tail(1.02, [100] * 20, 20.0, 30, 3)
    assert variance_ratio_tail(1.02, [95, 105] * 10, 20.0, 30, 3) == pytest.approx(many, rel=0.1)


@lru_cache
def p_values(rows: int, trajectories: int, missed: float) -> tuple[float, ...]:
    """Return p of waves with noise of deviation 0.1, the waves fitted; `missed` is the size of one that is not."""
    tails = []
    for seed in range(DRAWS):
        draw = np.random.default_rng(seed)
        signals, residuals = [], []
        for _ in range(trajectories):
            times = np.linspace(0.0, 10.0, rows)
            waves = np.linalg.qr(np.stack([np.sin(times), np.cos(times)], axis=1))[0]
            values = 3.0 * waves[:, 0] + missed * np.sin(2.0 * times) + 0.1 * draw.normal(size=rows)
            signals.append(Signal(times, values))
            residuals.append(values - waves @ (waves.T @ values))
        estimate = estimate_derivatives(signals, Differentiation())
        assert estimate.smoother is not None
        reference = ReferenceSmoother(estimate.narrower_span, estimate.smoother.degree, estimate.narrower_noise)
        tails.append(residual_statistics(residuals, estimate.noise, 2.0 * trajectories, reference).size_probability)
    return tuple(tails)


@pytest.mark.parametrize(("rows", "trajectories"), [(40, 1), (60, 3)])
@pytest.mark.slow
def test_p_is_uniform_if_the_model_is_right(rows, trajectories):
    """Shares within three standard errors of the binomial one, after a span that the same errors have selected."""
    tails = np.array(p_values(rows, trajectories, 0.0))
    for level in (0.05, 0.2, 0.5):
        assert (tails < level).mean() == pytest.approx(level, abs=3.0 * np.sqrt(level * (1.0 - level) / DRAWS))
    assert stats.kstest(tails, "uniform").pvalue > 0.01


@pytest.mark.slow
def test_p_is_small_if_the_model_misses_something():
    assert (np.array(p_values(60, 3, 0.1)) < 0.001).mean() > 0.9


def test_residuals_of_another_size_than_the_reference_are_judged():
    draw = np.random.default_rng(3)
    errors = [draw.normal(size=50)]
    assert residual_statistics(errors, 1.0, 2.0, ReferenceSmoother(15, 3, 0.5)).size_probability < 1e-6
    assert residual_statistics(errors, 1.0, 2.0, ReferenceSmoother(15, 3, 0.0)).size_probability == 0.0
    assert residual_statistics(errors, 1.0, 2.0, ReferenceSmoother(15, 3, 2.0)).size_probability > 0.99
