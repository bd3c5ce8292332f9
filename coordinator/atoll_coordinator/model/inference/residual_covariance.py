"""For few rows: the covariance of residuals, and the effect of possible correlations on standard errors. Pure.

*Covariance.* Fitting correlates residuals. The covariance of residuals is I - H, with the projection H on the
derivatives by all fitted numbers. `residual_covariances` returns this covariance, so that the test for a pattern is
exact for few rows.

*Inflation.* Few rows cannot show whether neighbouring errors are correlated, and a correlation increases the variance
of constants. `expected_variance_inflation` averages the variances over correlations from 0 to 0.9, weighted by the
probability of the residuals and a prior that favours small correlations.

Doubtful: the prior was chosen by simulations, so that nearly the right share of the intervals contains the truth, both
for a correlation of 0 and for a correlation of 0.6. One correlation for all states is assumed.

Letters: N rows, O measured states, P fitted constants, L numbers of an initial state, G pieces, n rows of one state,
M measured numbers, K fitted numbers.
"""

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from atoll_coordinator.model.shooting.fit_result import TrajectoryFit
from atoll_coordinator.model.shooting.measurements import TrajectoryMeasurements
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.kernels.tape import Ints

_MOST_NUMBERS: Final = 750
"""Most measured numbers for which the matrix is computed: the work for its eigenvalues grows with the third power of
this number. With more rows the distribution of correlations is about normal."""
_INDEPENDENT: Final = 1e-9
"""Columns of unit length are linearly dependent if a singular value is below this share of the largest singular
value."""


def residual_covariances(measurements: TrajectoryMeasurements, fit: TrajectoryFit) -> list[FloatArray] | None:
    """Return, for each state, the covariance (n, n) of its residuals in units of the variance of its errors.

    The matrices are blocks of I - H, with the projection H on the derivatives by constants and initial states. None if
    there are too many rows.
    """
    columns = scaled_derivatives(measurements, fit)
    if columns is None:
        return None
    ends = np.cumsum((measurements.weights > 0.0).sum(axis=1))
    return [np.eye(len(rows)) - rows @ rows.T for rows in np.split(orthonormal_basis(columns), ends[:-1])]


def scaled_derivatives(measurements: TrajectoryMeasurements, fit: TrajectoryFit) -> FloatArray | None:
    """Return the derivatives (M, P + L G) of the measured numbers by the fitted numbers. Each measured number is in
    units of its error.

    Rows are ordered state by state; the columns of constants come first. None if there are too many numbers.
    """
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


def orthonormal_basis(columns: FloatArray) -> FloatArray:
    """Return orthonormal columns (M, k) that span the same space as `columns` (M, K); k is the number of linearly
    independent columns."""
    sizes = np.sqrt((columns**2).sum(axis=0))
    basis, singular, _ = np.linalg.svd(columns[:, sizes > 0.0] / sizes[sizes > 0.0], full_matrices=False)
    return np.asarray(basis[:, singular > _INDEPENDENT * singular.max(initial=0.0)])


_CORRELATIONS: Final = tuple(step / 10 for step in range(10))
"""Correlations r of neighbouring rows over which variances are averaged. The prior density is proportional to 1 - r.
With this prior, 95 % intervals from 8 to 20 rows contain the truth in 99 % of the tables with independent errors, and
in 91 to 94 % of the tables with a correlation of 0.6 (`benchmarks.noise.intervals`). No prior reaches 95 % for both
kinds of tables. Without the correction, intervals contained the truth in 74 % of the tables."""


def estimate_variance_inflation(
    measurements: TrajectoryMeasurements, fit: TrajectoryFit, is_noisy: npt.NDArray[np.bool_]
) -> float:
    """Return a ratio of variances of the constants: the variances averaged over possible correlations, divided by the
    variances for independent errors.

    The result is 1 if there are so many rows that a correlation would have been found. Only states with `is_noisy` (O,)
    are used: the residuals of other states do not consist of measurement errors.
    """
    columns = scaled_derivatives(measurements, fit)
    if columns is None or not fit.system.count:
        return 1.0
    counts = measurements.weights > 0.0
    noisy = np.repeat(is_noisy, counts.sum(axis=1))
    sigmas = np.maximum(fit.errors.sigmas, 1e-300)[:, None]
    residuals = (np.sqrt(measurements.weights) * fit.residuals / sigmas)[counts]
    states, rows = np.nonzero(counts)
    owners = measurements.owners_of_rows[rows] + states * len(measurements.names)
    return expected_variance_inflation(
        columns[noisy], residuals[noisy], owners[noisy], measurements.times[rows][noisy], fit.system.count
    )


def expected_variance_inflation(
    columns: FloatArray, residuals: FloatArray, owners: Ints, times: FloatArray, constants: int
) -> float:
    """Return the factor by which correlations increase the variances of the first `constants` fitted numbers, averaged
    over the correlations.

    Errors have the correlation r**(gap) within one owner, with the gap in median time steps. The weight of r is the
    marginal likelihood of the residuals, with fitted numbers and variance integrated out (Harville 1974), times the
    prior. The variances are second moments about the least-squares estimate. If there are several constants, the result
    is the geometric mean of their factors, computed from the generalised variance.

    Args:
        columns: (M, K), derivatives of the measured numbers by the fitted numbers, in units of the errors.
        residuals: (M,), in the same units.
        owners: (M,), the series to which each measured number belongs.
        times: (M,), the time of each measured number.
        constants: the number of constants, which come first among the fitted numbers.
    """
    scales = np.sqrt((columns**2).sum(axis=0))
    if not (scales[:constants] > 0.0).all():
        return 1.0
    columns = columns[:, scales > 0.0] / scales[scales > 0.0]
    basis, singular, _ = np.linalg.svd(columns[:, constants:], full_matrices=False)
    free_of_copies = basis[:, singular > _INDEPENDENT * singular.max(initial=0.0)]
    columns = np.concatenate([columns[:, :constants], free_of_copies], axis=1)
    free = len(residuals) - columns.shape[1]
    if free < 1:
        return 1.0
    follows = np.diff(owners, prepend=-1) == 0
    gaps = np.diff(times, prepend=0.0)
    gaps /= float(np.median(gaps[follows])) if follows.any() else 1.0
    lengths, moments = [], []
    for correlation in _CORRELATIONS:
        carried = np.where(follows, correlation ** np.maximum(gaps, 0.0), 0.0)
        spreads = np.sqrt(1.0 - carried**2)
        numbers = np.column_stack([columns, residuals])
        numbers[1:] -= carried[1:, None] * numbers[:-1]
        numbers /= spreads[:, None]
        basis, singular, turns = np.linalg.svd(numbers[:, :-1], full_matrices=False)
        if singular.min() <= _INDEPENDENT * singular.max():
            return 1.0
        along = basis.T @ numbers[:, -1]
        square = max(float(numbers[:, -1] @ numbers[:, -1] - along @ along), 1e-300)
        lengths.append(float(np.log(spreads).sum() + np.log(singular).sum()) + 0.5 * free * math.log(square))
        inverse = (turns.T / singular**2) @ turns
        shift = (turns.T @ (along / singular))[:constants]
        moments.append(square / free * inverse[:constants, :constants] + np.outer(shift, shift))
    odds = (1.0 - np.asarray(_CORRELATIONS)) * np.exp(min(lengths) - np.asarray(lengths))
    mean = np.tensordot(odds / odds.sum(), np.asarray(moments), axes=1)
    grown = np.linalg.slogdet(mean)[1] - np.linalg.slogdet(moments[0])[1]
    return max(math.exp(grown / constants), 1.0)
