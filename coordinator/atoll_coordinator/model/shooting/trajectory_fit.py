"""A system fitted to measured trajectories, the covariance of its constants and the growth of its errors. Pure.

Letters as in `atoll_coordinator.model.shooting.multiple_shooting`.
"""

import math
from dataclasses import dataclass, field
from itertools import groupby
from typing import TYPE_CHECKING, Final

import numpy as np

from atoll_coordinator.model.constants.standard_errors import Flags, estimate_covariance
from atoll_coordinator.model.shooting.error_model import ErrorModel
from atoll_coordinator.model.shooting.system import System
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.kernels.tape import Ints

if TYPE_CHECKING:
    from atoll_coordinator.model.shooting.multiple_shooting import MultipleShooting

_LEAST_CURVATURE: Final = 1e-13
"""Least curvature of an initial state, its D coordinates scaled to a curvature of one: smaller ones are rounding.

Entries are sums over N rows, rounded by about eps*sqrt(N) each, and the largest eigenvalue is at most D, so that
eigenvalues are known to about eps*D*sqrt(N): 1e-13 at D = 7 and N = 4000. It is one number for all: with fewer rows
some curvature that is known is raised, with more some rounding is kept.
"""


@dataclass(frozen=True, eq=False)
class TrajectoryFit:
    """A system fitted to segments.

    `starts` (G, D) are the fitted initial states of `segments` (G, 2), and behind them, where trajectories are fitted
    in whole, their K offsets (G, D + K); `simulated` (D, N); `residuals` (O, N) measured minus simulated and offset;
    `errors` the errors of measurement by which they were weighed; `squares` (O,) their mean squares; `normal`,
    `coupling` and `own` the blocks of the normal equations at the end, weighted; `estimator` fitted it; `is_stiff`
    tells whether the system was integrated as a stiff one; `gradient` (P,) is the derivative of the log-likelihood
    by the constants, zero except for constants on their bounds.
    """

    system: System
    segments: Ints
    starts: FloatArray
    simulated: FloatArray
    residuals: FloatArray
    errors: ErrorModel
    squares: FloatArray
    normal: FloatArray
    coupling: FloatArray
    own: FloatArray
    estimator: "MultipleShooting" = field(repr=False)
    is_stiff: bool = False
    gradient: FloatArray | None = field(default=None, repr=False)

    def integrated_sensitivities(self) -> FloatArray:
        """Return the sensitivities (N, D, P + D + K) to the constants and to the own numbers of each segment.

        They are integrated again at each call, since they would make a fit many times as large.
        """
        return self.estimator.sensitivities(self)

    @property
    def reduced(self) -> FloatArray:
        """The normal matrix (P, P) of the constants, initial states eliminated.

        States that trajectories forget at once have hardly any curvature. With the roots W (G, D, D), WW' being the
        inverses of their blocks, it is subtracted up to rounding errors only; with an inverse the matrix would become
        indefinite.
        """
        scale = np.sqrt(np.maximum(np.einsum("gdd->gd", self.own), 1e-200))
        values, vectors = np.linalg.eigh(self.own / (scale[:, :, None] * scale[:, None, :]))
        roots = vectors / scale[:, :, None] / np.sqrt(np.maximum(values, _LEAST_CURVATURE))[:, None, :]
        carried = self.coupling @ roots
        return np.asarray(self.normal - np.tensordot(carried, carried, axes=([0, 2], [0, 2])))


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


def _spread(fit: TrajectoryFit) -> tuple[FloatArray, Flags]:
    return estimate_covariance(fit.reduced, fit.system.values, fit.system.on_bounds, np.diag(fit.normal))


def growth_rate(fit: TrajectoryFit) -> float:
    """Return the rate at which errors of a state grow, in e-folds per unit of time: the largest Lyapunov exponent.

    The mean over all trajectories; negative where errors shrink, NaN without a segment of two rows. The sensitivities
    to a segment's initial state give the size of a small error at its end. An error is carried from segment to
    segment of a trajectory and made small again at each, so that it turns into the direction of fastest growth
    (Benettin et al. 1980). A trajectory with one segment has only the growth of its own fastest direction, which is
    an upper limit.
    """
    measurements = fit.estimator.measurements
    fitted, states = fit.system.count, len(fit.system.outputs)
    unit = measurements.scales[None, :] / measurements.scales[:, None]
    sensitivities = fit.integrated_sensitivities()[:, :, fitted : fitted + states] * unit
    long = [(first, end) for first, end in fit.segments.tolist() if end - first > 1]
    logarithms = duration = 0.0
    for _, group in groupby(long, key=lambda rows: int(measurements.owners_of_rows[rows[0]])):
        segments = list(group)
        growths = _growths(np.array([sensitivities[end - 1] for _, end in segments]))
        times = [float(measurements.times[end - 1] - measurements.times[first]) for first, end in segments]
        logarithms += sum(growths)
        duration += sum(times[-len(growths) :])
    return logarithms / duration if duration > 0.0 else math.nan


def _growths(matrices: FloatArray) -> list[float]:
    """Return the logarithms by which an error grows over each of these (S, D, D) but the first; of one, its largest."""
    if len(matrices) == 1:
        return [math.log(max(float(np.linalg.norm(matrices[0], 2)), 1e-300))]
    error = np.linalg.svd(matrices[0])[0][:, 0]
    growths = []
    for matrix in matrices[1:]:
        error = matrix @ error
        size = max(float(np.linalg.norm(error)), 1e-300)
        error = error / size
        growths.append(math.log(size))
    return growths


def speed_growth(fit: TrajectoryFit) -> float:
    """Return the mean rate at which the trajectories of `fit` get faster, in e-folds per unit of time.

    An error of time grows like the speed, and so do all errors of a process that grows as a whole: compared with the
    state they stay as small as they were. Speeds are means over the first and the second half of a trajectory, so that
    a process that keeps coming back has a rate of about zero.
    """
    measurements = fit.estimator.measurements
    owners, times = measurements.owners_of_rows, measurements.times
    steps = np.diff(fit.simulated / measurements.scales[:, None], axis=1)
    logarithms = duration = 0.0
    for owner in np.unique(owners).tolist():
        rows = np.flatnonzero((owners[1:] == owner) & (owners[:-1] == owner))
        if len(rows) < 2:
            continue
        speeds = np.linalg.norm(steps[:, rows], axis=0) / (times[rows + 1] - times[rows])
        middle = len(rows) // 2
        slow, fast = (max(float(half.mean()), 1e-300) for half in (speeds[:middle], speeds[middle:]))
        logarithms += math.log(fast / slow)
        duration += 0.5 * float(times[rows[-1] + 1] - times[rows[0]])
    return logarithms / duration if duration > 0.0 else 0.0
