"""Whether a chaotic model stays on the attractor that was measured.

Of a chaotic system no course can be foretold beyond some Lyapunov times, but averages can: a long simulation has the
means and variances of the measurements, up to sampling errors. Both are compared by Welch's t, with averages over
blocks that are long against the time in which errors grow: the later halves of trajectories, which begin where they
were made to begin and come to the attractor first, or where there are few trajectories, parts of them.
"""

import math
from dataclasses import replace
from typing import Final

import numpy as np

from atoll_coordinator.model.refinement import Chaos
from atoll_coordinator.model.shooting.integration import Unsimulated
from atoll_coordinator.model.shooting.measurements import Measurements
from atoll_coordinator.model.shooting.multiple_shooting import MultipleShooting
from atoll_coordinator.model.shooting.trajectory_fit import TrajectoryFit
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray

_BLOCKS: Final = 4
"""Blocks that there are at least: the variance of fewer averages is not known."""
_MOST_ROWS: Final = 4_000
"""Rows of the long simulation, at most: where it has to be longer, they stand for several measured ones each."""


def may_be_chaotic(measurements: Measurements) -> bool:
    """Tell whether a model of these measurements can be chaotic at all.

    A bounded trajectory of fewer than three states without inputs comes to a fixed point or a cycle, or is one
    (Poincaré and Bendixson; Strogatz 1994, section 7.3); equations of second order have two states each.
    """
    return len(measurements.inputs) > 0 or len(measurements.smoothed) > 2


def look_for_chaos(fit: TrajectoryFit, rate: float, tolerance: float) -> Chaos | None:
    """Return what is to be said of a model whose errors grow at this `rate`; None where it has inputs.

    Args:
        fit: the model as it is shown, along the measured trajectories.
        rate: e-folds per unit of time, above zero.
        tolerance: error of an integration step over a state's standard deviation.
    """
    measurements = fit.estimator.measurements
    if len(measurements.inputs):
        return None
    step = float(np.median(np.diff(measurements.times)[np.diff(measurements.owners_of_rows) == 0]))
    lengths = np.bincount(measurements.owners_of_rows)
    are_few = len(lengths) < _BLOCKS
    block = int(lengths.max()) // (_BLOCKS if are_few else 2)
    rows = max(_BLOCKS * block, min(measurements.rows, _MOST_ROWS))
    stride = -(-rows // _MOST_ROWS)
    simulated = _simulated(fit, rows, stride, step, tolerance)
    if isinstance(simulated, str):
        return Chaos(1.0 / rate, False, None, is_unfinished=simulated == "out of steps")
    measured = [measurements.smoothed[:, measurements.owners_of_rows == owner] for owner in range(len(lengths))]
    measured = measured if are_few else [trajectory[:, trajectory.shape[1] // 2 :] for trajectory in measured]
    centre = np.concatenate(measured, axis=1).mean(axis=1, keepdims=True)
    probability = 1.0
    for power in (1, 2):
        simulated_means = _block_means((simulated - centre) ** power, block // stride)
        measured_means = np.concatenate(
            [_block_means((trajectory - centre) ** power, block) for trajectory in measured], axis=1
        )
        probability = min(probability, *_welch(simulated_means, measured_means))
    is_kept = probability >= SETTINGS.inference.improbable / (2.0 * len(centre))
    return Chaos(1.0 / rate, is_kept, probability)


def _simulated(fit: TrajectoryFit, rows: int, stride: int, step: float, tolerance: float) -> FloatArray | Unsimulated:
    """Return every `stride`-th of so many rows of the states from the end of the last trajectory on, or why not."""
    times = step * np.arange(0.0, rows, stride)
    estimator = along(fit.estimator.measurements, times, tolerance, rows)
    return estimator.simulate(fit.system, fit.simulated[:, -1])


def along(
    measurements: Measurements, times: FloatArray, tolerance: float, measured_rows: int, owner: int = 0
) -> MultipleShooting:  # fmt: skip
    """Return an estimator that simulates systems without inputs along these `times`, where nothing was measured.

    So much time has about so many `measured_rows`, each of which is allowed its steps. Constants are those of the group
    of the trajectory `owner`.
    """
    rows, count = len(times), len(measurements.observed)
    low, high = measurements.smoothed.min(axis=1), measurements.smoothed.max(axis=1)
    made = replace(
        measurements,
        bounds=np.array([[0, rows]], dtype=np.int64),
        owners=np.array([owner], dtype=np.int64),
        times=times,
        measured=np.zeros((count, rows)),
        weights=np.ones((count, rows)),
        smoothed=np.ascontiguousarray(np.linspace(low, high, rows).T),
        offset=np.zeros(0, dtype=np.int64),
        inputs=np.zeros((0, rows)),
        input_slopes=np.zeros((0, rows)),
        inverse_variances=None,
        resting=None,
        consistency=None,
    )
    return MultipleShooting(made, tolerance, measured_rows=measured_rows)


def _block_means(values: FloatArray, block: int) -> FloatArray:
    """Return the means (D, B) of whole blocks of rows."""
    count = max(values.shape[1] // block, 1)
    return np.array([part.mean(axis=1) for part in np.array_split(values[:, : count * block], count, axis=1)]).T


def _welch(simulated_means: FloatArray, measured_means: FloatArray) -> list[float]:
    """Return for each state the probability of means as different as these (B. L. Welch 1947)."""
    from scipy import special

    probabilities = []
    for simulated, measured in zip(simulated_means, measured_means, strict=True):
        shares = [means.var(ddof=1) / len(means) if len(means) > 1 else 0.0 for means in (simulated, measured)]
        total = sum(shares)
        if not total > 0.0:
            probabilities.append(1.0)
            continue
        parts = zip(shares, (simulated, measured), strict=True)
        degrees_of_freedom = total**2 / sum(share**2 / max(len(means) - 1, 1) for share, means in parts)
        probabilities.append(
            2.0 * float(special.stdtr(degrees_of_freedom, -abs(simulated.mean() - measured.mean()) / math.sqrt(total)))
        )
    return probabilities
