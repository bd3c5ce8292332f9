"""The covariance of the residuals of a fit, where errors of measurement are independent: for few rows. Pure.

Letters: N rows, O measured states, P fitted constants, L numbers of an initial state, G pieces, n rows of one state.
"""

from typing import Final

import numpy as np

from atoll_coordinator.model.shooting.measurements import Measurements
from atoll_coordinator.model.shooting.trajectory_fit import TrajectoryFit
from atoll_core.data.dataset import FloatArray

_MOST_NUMBERS: Final = 750
"""Measured numbers up to which the matrix is made, for its eigenvalues: it takes the cube of them. Of more rows the
distribution of correlations is about normal."""
_INDEPENDENT: Final = 1e-9
"""Singular values of unit columns, over the largest, below which they are linearly dependent."""


def residual_covariance(measurements: Measurements, fit: TrajectoryFit, index: int) -> FloatArray | None:
    """Return the covariance (n, n) of the residuals of one state in units of the variance of its errors.

    That is its block of I - H with the projection H on what constants and initial states together can do. None where
    there are too many rows.
    """
    columns = whitened_columns(measurements, fit)
    if columns is None:
        return None
    counts = measurements.weights > 0.0
    first = int(counts[:index].sum())
    return projected_away(columns, slice(first, first + int(counts[index].sum())))


def whitened_columns(measurements: Measurements, fit: TrajectoryFit) -> FloatArray | None:
    """Return by how much each measured number, one state after another, in units of its error, grows with each fitted
    number: (n, P + L G), constants first. None where there are too many numbers."""
    states, rows = measurements.weights.shape
    if states * rows > _MOST_NUMBERS:
        return None
    sensitivities, fitted = fit.integrated_sensitivities(), fit.system.count
    local = sensitivities.shape[2] - fitted
    columns = np.zeros((states, rows, fitted + local * len(fit.segments)))
    for piece, (first, end) in enumerate(fit.segments.tolist()):
        own = slice(fitted + piece * local, fitted + (piece + 1) * local)
        for state, place in enumerate(measurements.observed.tolist()):
            columns[state, first:end, :fitted] = sensitivities[first:end, place, :fitted]
            columns[state, first:end, own] = sensitivities[first:end, place, fitted:]
    columns *= (np.sqrt(measurements.weights) / np.maximum(fit.errors.sigmas, 1e-300)[:, None])[:, :, None]
    return np.asarray(columns[measurements.weights > 0.0])


def projected_away(columns: FloatArray, rows: slice) -> FloatArray:
    """Return the block of I - H of these rows, H the projection on the columns (M, K)."""
    sizes = np.sqrt((columns**2).sum(axis=0))
    basis, singular, _ = np.linalg.svd(columns[:, sizes > 0.0] / sizes[sizes > 0.0], full_matrices=False)
    basis = basis[rows, singular > _INDEPENDENT * singular.max(initial=0.0)]
    return np.asarray(np.eye(len(basis)) - basis @ basis.T)
