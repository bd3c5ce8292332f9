"""What fitting leaves of the residuals of few rows, and how many of the fitted numbers each state takes."""

from dataclasses import replace

import numpy as np
import pytest

from atoll_coordinator.model.inference.residual_covariance import residual_covariances
from atoll_coordinator.model.shooting.error_model import ErrorModel
from tests.unit.coordinator.model.shooting.made import SWING, compare, measurements

ROWS = measurements(SWING, ([1.0, 2.0],), 0.6 * np.arange(7.0), noise=0.02, seed=1)


@pytest.fixture(scope="module")
def fit():
    return compare(SWING, ROWS, 1e-8).fit_model([SWING.parsed("y"), SWING.parsed("-2.0*x - 0.3*y")]).fit


def taken(fit, *sigmas):
    """Return how many numbers each state takes where its errors have these sizes."""
    errors = ErrorModel.independent(np.array(sigmas))
    made = residual_covariances(ROWS, replace(fit, errors=errors))
    return [len(one) - float(np.trace(one)) for one in made]


def test_all_fitted_numbers_are_taken_by_some_state(fit):
    assert sum(taken(fit, 0.02, 0.02)) == pytest.approx(4.0)  # two constants, two initial values
    assert sum(taken(fit, 0.02, 2.0)) == pytest.approx(4.0)


def test_a_state_that_is_followed_far_more_closely_takes_them_all(fit):
    first, second = taken(fit, 1e-6, 1.0)
    assert first == pytest.approx(4.0, abs=1e-3)
    assert second == pytest.approx(0.0, abs=1e-3)


def test_of_many_rows_no_matrix_is_made():
    many = measurements(SWING, ([1.0, 2.0],), 0.01 * np.arange(400.0))
    model = compare(SWING, many, 1e-8).fit_model([SWING.parsed("y"), SWING.parsed("-2.0*x - 0.3*y")])
    assert residual_covariances(many, model.fit) is None
