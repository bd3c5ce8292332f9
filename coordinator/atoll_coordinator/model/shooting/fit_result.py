"""A system fitted to measured trajectories, the covariance of its constants, and the growth rate of errors. Pure.

Letters as in `atoll_coordinator.model.shooting.multiple_shooting`.
"""

import math
from dataclasses import dataclass, field
from functools import cached_property
from itertools import groupby
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from atoll_coordinator.model.constants.standard_errors import Flags, estimate_covariance
from atoll_coordinator.model.shooting.error_model import ErrorModel
from atoll_coordinator.model.shooting.system import OdeSystem
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.kernels.tape import Ints

if TYPE_CHECKING:
    from atoll_coordinator.model.shooting.multiple_shooting import MultipleShooting

_LEAST_CURVATURE: Final = 1e-13
"""Least eigenvalue of the normal matrix of an initial state, which is scaled to a unit diagonal: smaller eigenvalues
are rounding errors.

The matrix has D columns. Its elements are sums over N rows, with rounding errors of about eps*sqrt(N), and its largest
eigenvalue is at most D. So eigenvalues are known to about eps*D*sqrt(N): 1e-13 at D = 7 and N = 4000. The same value is
used for all fits. With fewer rows, some eigenvalues are raised although they are known; with more rows, some rounding
errors remain.
"""


class NormalBlocks(NamedTuple):
    """Blocks of the weighted normal equations: `normal` (P, P) for the constants, `own` (G, L, L) for each segment's
    own numbers, and `coupling` (G, P, L) for both. The right-hand sides are `gradient` (P,) for the constants and
    `own_gradient` (G, L) for the segments."""

    normal: FloatArray
    coupling: FloatArray
    own: FloatArray
    gradient: FloatArray
    own_gradient: FloatArray


@dataclass(frozen=True, eq=False)
class TrajectoryFit:
    """A system fitted to segments.

    Attributes:
        system: the system with fitted constants.
        segments: the segments (G, 2) of rows.
        starts: the fitted initial states (G, D) of the segments. If whole trajectories are fitted, the shape is (G, D +
            K): the last columns are K offsets.
        simulated: the simulated states (D, N).
        residuals: measured values minus simulated values minus offsets (O, N).
        errors: the error model by which residuals are weighted.
        squares: the mean squares (O,) of the residuals.
        estimator: the estimator that fitted the system.
        is_stiff: whether the implicit method was used.
        known_blocks: the normal equations at the end of the fit; None if they were not needed for a step.
    """

    system: OdeSystem
    segments: Ints
    starts: FloatArray
    simulated: FloatArray
    residuals: FloatArray
    errors: ErrorModel
    squares: FloatArray
    estimator: "MultipleShooting" = field(repr=False)
    is_stiff: bool = False
    known_blocks: NormalBlocks | None = field(default=None, repr=False)

    @cached_property
    def blocks(self) -> NormalBlocks:
        """The normal equations at the end of the fit, without a prior. The `gradient` is the derivative of the
        log-likelihood by the constants; without a prior, it is zero for a constant that is not on a bound."""
        return self.known_blocks or self.estimator.blocks_of(self)

    @cached_property
    def simulated_columns(self) -> FloatArray:
        """The simulated values (O, N) of the measured columns, without offsets."""
        return self.estimator.integrator.columns(self.system, self.simulated)

    def integrated_sensitivities(self) -> FloatArray:
        """Return the sensitivities (N, D + M, P + D + K) to constants, initial states and offsets. The last M rows are
        the columns that are computed from states.

        They are integrated again at each call, because a stored copy would make a fit many times as large.
        """
        return self.estimator.sensitivities(self)

    @property
    def reduced(self) -> FloatArray:
        """The normal matrix (P, P) of the constants after elimination of the initial states.

        Initial states that hardly affect a trajectory have nearly singular blocks. So the elimination uses roots W (G,
        D, D) of the inverse blocks, with W W' equal to the inverse. Then the result is positive semidefinite up to
        rounding errors; with plain inverses it could become indefinite.
        """
        scale = np.sqrt(np.maximum(np.einsum("gdd->gd", self.blocks.own), 1e-200))
        values, vectors = np.linalg.eigh(self.blocks.own / (scale[:, :, None] * scale[:, None, :]))
        roots = vectors / scale[:, :, None] / np.sqrt(np.maximum(values, _LEAST_CURVATURE))[:, None, :]
        carried = self.blocks.coupling @ roots
        return np.asarray(self.blocks.normal - np.tensordot(carried, carried, axes=([0, 2], [0, 2])))


def covariance(fit: TrajectoryFit) -> FloatArray:
    """Return the covariance (P, P) of the fitted constants after elimination of the initial states.

    The variance of a constant is infinite if other constants or initial states can replace its effect.
    """
    covariances, is_undetermined = _covariance_and_undetermined(fit)
    covariances[np.diag_indices_from(covariances)] = np.where(is_undetermined, math.inf, np.diag(covariances))
    return covariances


def bounded_covariance(fit: TrajectoryFit) -> FloatArray:
    """Return the covariance (P, P), but with large finite variances instead of infinite variances. The matrix is
    positive definite."""
    return _covariance_and_undetermined(fit)[0]


def _covariance_and_undetermined(fit: TrajectoryFit) -> tuple[FloatArray, Flags]:
    return estimate_covariance(fit.reduced, fit.system.values, fit.system.on_bounds, np.diag(fit.blocks.normal))


def growth_rate(fit: TrajectoryFit) -> float:
    """Return the rate at which errors of a state grow, in e-folds per unit of time: the largest Lyapunov exponent.

    The result is the mean over all trajectories. It is negative if errors shrink, and NaN if no segment has two rows.
    The sensitivities to the initial state of a segment give the size of a small error at the end of the segment. An
    error vector is propagated from segment to segment of a trajectory, and normalised in each segment. So it turns into
    the direction of fastest growth (Benettin et al. 1980). For a trajectory with one segment, the growth in the
    direction of fastest growth is used, which is an upper limit.
    """
    measurements = fit.estimator.measurements
    fitted, states = fit.system.count, len(fit.system.outputs)
    unit = measurements.scales[None, :] / measurements.scales[:, None]
    sensitivities = fit.integrated_sensitivities()[:, :states, fitted : fitted + states] * unit
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
    """Return the logarithm of the growth of an error over each of these `matrices` (S, D, D) except the first.

    For a single matrix, return the logarithm of its largest singular value."""
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
    """Return the mean growth rate of the speed along the trajectories of `fit`, in e-folds per unit of time.

    An error in time causes an error of the state that is proportional to the speed. So in a process that grows as a
    whole, errors grow like the speed, and are constant relative to the state. The rate follows from the mean speeds in
    the first and the second half of a trajectory. So the rate of a recurrent process is about zero.
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
