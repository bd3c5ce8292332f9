"""Standard errors of fitted constants from the normal equations, and what a fitted equation costs by them. Pure."""

import math
from typing import Final

import numpy as np

from atoll.data.dataset import FloatArray
from atoll.expression.program import constant_places
from atoll_coordinator.model.criteria import RegressionCriterion
from atoll_coordinator.model.regression.fit import Fitted
from atoll_coordinator.model.regression.simple_numbers import fitted_length

_RIDGE: Final = 1e-14
_FLAT: Final = 1e-100


def covariance_of(fitted: Fitted, criterion: RegressionCriterion) -> FloatArray:
    """Return the covariance (K, K) of the constants that were fitted, in node order."""
    scale = np.sqrt(np.diag(fitted.normal))
    scale[scale < _FLAT] = _FLAT
    unit = fitted.normal / np.outer(scale, scale) + _RIDGE * np.eye(len(scale))
    inverse = np.linalg.pinv(unit, hermitian=True)
    return np.asarray(criterion.variance(fitted.mse) * inverse / np.outer(scale, scale))


def standard_errors(fitted: Fitted, criterion: RegressionCriterion) -> list[float]:
    """Return the standard errors of the constants that were fitted, in node order."""
    variances: list[float] = np.diag(covariance_of(fitted, criterion)).tolist()
    return [math.sqrt(max(variance, 0.0)) for variance in variances]


def description_length(fitted: Fitted, criterion: RegressionCriterion) -> float:
    """Return the description length of a model all of whose constants were fitted, infinite without a finite error."""
    if not math.isfinite(criterion.misfit(fitted.mse)):
        return math.inf
    values = fitted.program.constants[constant_places(fitted.program)].tolist()
    numbers = sum(map(fitted_length, values, standard_errors(fitted, criterion)))
    return criterion.length(fitted.mse, fitted.program, numbers)
