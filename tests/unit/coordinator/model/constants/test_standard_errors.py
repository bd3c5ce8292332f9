"""The covariance of constants in any units."""

import numpy as np
import pytest

from atoll_coordinator.model.constants.standard_errors import estimate_covariance

FREE = np.zeros(2, np.bool_)
NORMAL = np.array([[4.0, 1.0], [1.0, 9.0]])


@pytest.mark.parametrize("unit", [1e-70, 1e-60, 1.0, 1e60, 1e70])
def test_a_unit_of_a_constant_scales_its_errors_alone(unit):
    scale = np.array([unit, 1.0])
    covariance, is_undetermined = estimate_covariance(NORMAL / np.outer(scale, scale), np.array([unit, 1.0]), FREE)
    np.testing.assert_allclose(covariance / np.outer(scale, scale), np.linalg.inv(NORMAL), rtol=1e-9)
    assert not is_undetermined.any()


def test_a_constant_without_effect_is_not_determined_and_its_variance_is_finite():
    covariance, is_undetermined = estimate_covariance(np.diag([0.0, 9.0]), np.ones(2), FREE)
    assert is_undetermined.tolist() == [True, False]
    assert np.isfinite(covariance).all()
    assert covariance[1, 1] == pytest.approx(1.0 / 9.0)
