"""Errors that go together, estimated from what a fit leaves."""

import numpy as np
import pytest

from atoll_coordinator.model.shooting.error_model import ErrorModel, Innovations

ROWS, DECAY, CURVES, DRAWS = 200, 0.9, 4, 60


def innovations():
    return Innovations(np.array([[0, ROWS]]), np.ones(ROWS), np.ones((1, ROWS)))


def residuals(rng):
    """Return what is left of AR(1) errors where polynomials were fitted to them."""
    errors = rng.standard_normal(ROWS)
    for row in range(1, ROWS):
        errors[row] = DECAY * errors[row - 1] + np.sqrt(1.0 - DECAY**2) * errors[row]
    curves = np.linalg.qr(np.linspace(-1.0, 1.0, ROWS)[:, None] ** np.arange(CURVES))[0]
    return (errors - curves @ (curves.T @ errors))[None, :]


def test_a_correlation_is_that_of_the_errors_not_of_what_a_fit_leaves_of_them():
    rng = np.random.default_rng(3)
    rows, begun = innovations(), ErrorModel.independent(np.ones(1))
    lengths = []
    for _ in range(DRAWS):
        shares, decays = rows.estimate(residuals(rng), begun, CURVES)
        lengths.append(ErrorModel(np.ones(1), shares, decays).lengths[0])
    assert np.median(lengths) == pytest.approx((1.0 + DECAY) / (1.0 - DECAY), rel=0.15)


def test_a_variance_of_correlated_errors_has_few_degrees_of_freedom():
    model = ErrorModel(np.ones(2), np.array([0.0, 1.0]), np.array([0.0, DECAY]))
    assert model.degrees_of_freedom.tolist() == [1.0, pytest.approx(1.0 / (1.0 + 2.0 / (1.0 - DECAY**2)))]
