"""Robust least squares."""

import numpy as np
import pytest

from atoll_coordinator.model.sparse.kernels.robust import robust_fit


def test_without_outliers_it_is_least_squares():
    generator = np.random.default_rng(1)
    columns = generator.normal(size=(3, 200)) * np.array([1.0, 1e3, 1e-3])[:, None]
    errors = generator.uniform(0.1, 10.0, 200)
    side = columns.T @ [2.0, -1e-3, 5e2] + errors * generator.normal(size=200)
    coefficients = np.zeros(3)
    robust_fit(columns, side, errors, 1, coefficients, np.ones(200))
    assert coefficients == pytest.approx(np.linalg.lstsq((columns / errors).T, side / errors, rcond=None)[0], rel=1e-9)
    scale = robust_fit(columns, side, errors, 40, coefficients, np.ones(200))
    assert 0.8 < scale < 1.2


def test_rows_that_err_far_more_than_they_should_count_little():
    generator = np.random.default_rng(2)
    columns, errors = generator.normal(size=(2, 300)), np.full(300, 1e-3)
    side = columns.T @ [1.0, -2.0] + errors * generator.normal(size=300)
    side[:60] += generator.uniform(0.1, 1.0, 60)
    coefficients, weights = np.zeros(2), np.ones(300)
    scale = robust_fit(columns, side, errors, 40, coefficients, weights)
    assert coefficients == pytest.approx([1.0, -2.0], abs=5e-4)
    assert scale < 2.0
    assert weights[:60].max() < 0.1 < weights[60:].mean()
