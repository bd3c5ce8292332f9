"""How fast errors of a state grow along a fitted system: its largest Lyapunov exponent, from fitted segments.

The sensitivities to a segment's initial state say what becomes of a small error by its end. An error is carried from
segment to segment of a trajectory and made small again at each, so that it turns into the direction of fastest growth
(Benettin et al. 1980). Of a trajectory of one segment there is only the growth of its own fastest direction, which is
an upper limit.
"""

import math
from itertools import groupby

import numpy as np

from atoll_coordinator.model.shooting.trajectory_fit import TrajectoryFit
from atoll_core.data.dataset import FloatArray


def growth_rate(fit: TrajectoryFit) -> float:
    """Return the rate at which errors grow, in e-folds per unit of time, on average over all trajectories of `fit`.

    Negative where they shrink; NaN without a segment of two rows.
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


def speed_growth(fit: TrajectoryFit) -> float:
    """Return the rate at which trajectories get faster, in e-folds per unit of time, on average over those of `fit`.

    An error of time grows like the speed, and so do all errors of a process that grows as a whole: beside the state
    they stay as small as they were. Speeds are means over the first and the second half of a trajectory, by which that
    of a process that keeps coming back is about zero.
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
