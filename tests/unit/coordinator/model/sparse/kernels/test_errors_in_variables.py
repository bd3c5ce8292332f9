"""Least squares where the columns have errors, too."""

import numpy as np
import pytest
from scipy.optimize import minimize as minimum

from atoll_coordinator.model.least_squares import minimize, solver
from atoll_coordinator.model.sparse.kernels.errors_in_variables import (
    error_products,
    measure,
)
from atoll_coordinator.model.sparse.kernels.robust import CAUCHY


def measured(noise=0.5, count=400):
    """Return columns (2, W) with errors, a side (W,) that is 2 and -1 times the true ones, and their covariances."""
    generator = np.random.default_rng(3)
    true = generator.normal(size=(2, count))
    columns = true + noise * generator.normal(size=(2, count))
    side = 2.0 * true[0] - true[1] + 0.1 * generator.normal(size=count)
    products = np.broadcast_to(noise**2 * np.eye(2), (count, 2, 2)).copy()
    return columns, side, products, np.zeros((count, 2)), np.full(count, 0.01)


def loss_of(coefficients, columns, side, products, cross, least, typical):
    """Return the mean loss by its definition."""
    left = side - coefficients @ columns
    extra = np.einsum("wij,i,j->w", products, coefficients, coefficients) + 2.0 * cross @ coefficients
    scaled = left / np.sqrt(least + extra)
    return float(np.mean(0.5 * CAUCHY**2 * np.log1p((scaled / CAUCHY) ** 2) + 0.5 * np.log1p(extra / typical)))


def fitted(begun, *misfit):
    """Return the coefficients of least mean loss near `begun`, by the slopes that `measure` writes; and that loss."""
    kept, windows = np.arange(len(begun)), misfit[1].size

    def measured_at(at):
        normal, pull = np.zeros((2, 2)), np.zeros(2)
        loss = measure(kept, *misfit, at, np.zeros(windows), normal, pull)
        return windows * loss, normal, -pull

    def move(at, step):
        return at + step, measured_at(at)[0] - measured_at(at + step)[0]

    end = minimize(begun, lambda at: solver(*measured_at(at)[1:]), move, lambda _: 1e-9)
    return end, measured_at(end)[0] / windows


def test_errors_of_columns_do_not_make_coefficients_small():
    rows = measured()
    assert fitted(np.zeros(2), *rows, 1e6)[0] == pytest.approx([2.0, -1.0], rel=0.1)
    by_least_squares = np.linalg.lstsq(rows[0].T, rows[1], rcond=None)[0]
    assert abs(by_least_squares[0]) < 1.75


def test_the_fit_is_the_least_loss():
    columns, side, products, cross, least = measured()
    cross = cross + np.array([0.02, -0.01])
    coefficients, loss = fitted(np.ones(2), columns, side, products, cross, least, 3.0)
    oracle = minimum(loss_of, np.ones(2), (columns, side, products, cross, least, 3.0), "Nelder-Mead", tol=1e-10)
    assert loss == pytest.approx(oracle.fun, rel=1e-4)
    assert coefficients == pytest.approx(oracle.x, rel=2e-2)
    assert loss == pytest.approx(loss_of(coefficients, columns, side, products, cross, least, 3.0))


@pytest.mark.slow
def test_measure_takes_the_columns_that_are_kept():
    columns, side, products, cross, least = measured()
    scaled = np.zeros(side.size)
    loss = measure(
        np.array([1]), columns, side, products, cross, least, 2.0, np.array([0.5]), scaled, np.zeros((1, 1)),
        np.zeros(1),
    )  # fmt: skip
    assert loss == pytest.approx(loss_of(np.array([0.0, 0.5]), columns, side, products, cross, least, 2.0))
    assert scaled == pytest.approx((side - 0.5 * columns[1]) / np.sqrt(least + 0.25 * products[:, 1, 1]))


def test_covariances_are_those_of_simulated_errors():
    generator = np.random.default_rng(5)
    bump, slope = generator.normal(size=(1, 4)), generator.normal(size=(1, 4))
    gradients, noise = generator.normal(size=(2, 2, 4)), np.array([0.3, 0.7])
    products, cross = np.zeros((1, 2, 2)), np.zeros((1, 2))
    error_products(np.zeros(1, np.int64), bump, slope, gradients, noise, 1, products, cross)
    errors = noise[:, None] * generator.normal(size=(100_000, 2, 4))
    terms = np.einsum("j,kvj,svj->sk", bump[0], gradients, errors)
    side = -errors[:, 1] @ slope[0]
    assert products[0] == pytest.approx(np.cov(terms.T), abs=0.03)
    assert cross[0] == pytest.approx([-np.cov(side, terms[:, k])[0, 1] for k in range(2)], abs=0.03)
