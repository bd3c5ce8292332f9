"""The covariance of the constants of a multiple-shooting fit, from its normal equations. Pure."""

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from atoll_coordinator.model.shooting.trajectory_fit import TrajectoryFit
from atoll_core.data.dataset import FloatArray

_LEAST_EIGENVALUE: Final = 1e-11
"""Smaller eigenvalues of the normal matrix with a unit diagonal are those of rounding."""
_OPEN_LOADING: Final = 1e-6
"""Squared component of a constant along a direction that is not determined, from which it is not determined itself."""
_CANCELLED: Final = 1e-13
"""Share of its diagonal that rounding leaves of the normal matrix where initial states stand in for a constant."""

_HELD: Final = 1e-9
"""Standard error of a constant on its bound, over its size."""


def covariance(fit: TrajectoryFit) -> FloatArray:
    """Return the covariance (P, P) of the fitted constants, initial states eliminated.

    The variance is infinite of a constant that the others, or the initial states, can stand in for.
    """
    covariances, is_open = _spread(fit)
    covariances[np.diag_indices_from(covariances)] = np.where(is_open, math.inf, np.diag(covariances))
    return covariances


def bounded_covariance(fit: TrajectoryFit) -> FloatArray:
    """Return the same with large variances in the place of infinite ones: a positive definite matrix."""
    return _spread(fit)[0]


def _spread(fit: TrajectoryFit) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
    """Return the bounded covariance, and which constants load on directions that the data do not determine.

    Constants on their bounds are as good as given: the others are judged with these where they are.
    """
    held = fit.system.on_bounds
    if not held.any():
        return _inverse(np.diag(fit.normal), fit.reduced)
    free, count = np.flatnonzero(~held), len(held)
    covariances, is_open = np.zeros((count, count)), np.zeros(count, np.bool_)
    if len(free):
        normal, reduced = np.diag(fit.normal)[free], fit.reduced[np.ix_(free, free)]
        covariances[np.ix_(free, free)], is_open[free] = _inverse(normal, reduced)
    values = np.abs(fit.system.values[held])
    covariances[held, held] = (_HELD * np.maximum(values, _HELD)) ** 2
    return covariances, is_open


def _inverse(normal: FloatArray, reduced: FloatArray) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
    """Return the inverse of the reduced normal matrix, and which constants are open."""
    least = np.maximum(_CANCELLED * np.nan_to_num(normal), 1e-100)
    scale = np.sqrt(np.clip(np.nan_to_num(np.diag(reduced)), least, 1e100))
    with np.errstate(all="ignore"):
        unit = np.nan_to_num(reduced / np.outer(scale, scale), posinf=0.0, neginf=0.0)
    try:
        values, vectors = np.linalg.eigh(unit)
    except np.linalg.LinAlgError:
        values, vectors = np.zeros(len(scale)), np.eye(len(scale))
    is_open = (vectors[:, values < _LEAST_EIGENVALUE] ** 2 > _OPEN_LOADING).any(axis=1)
    with np.errstate(all="ignore"):
        inverse = (vectors / np.maximum(values, _LEAST_EIGENVALUE)) @ vectors.T / np.outer(scale, scale)
    return np.asarray(inverse), np.asarray(is_open)
