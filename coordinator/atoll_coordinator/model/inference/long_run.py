"""Whether a model describes whole trajectories, and whether a chaotic model stays on the measured attractor.

Constants may have been fitted to short pieces of trajectories. `assess_long_run` decides which test applies. A model
that cannot be chaotic must describe whole trajectories (`_fits_in_whole`). For a chaotic model, `compare_averages`
compares a long simulation with the measurements.

A trajectory of a chaotic system cannot be predicted beyond some Lyapunov times, but its averages can be predicted: a
long simulation has the means and variances of the measurements, up to sampling errors. Means and variances are compared
by Welch's t test on averages over blocks. A block is long compared with the time in which errors grow. Blocks are the
later halves of trajectories, since the first halves may still approach the attractor; if there are few trajectories,
blocks are parts of trajectories.

Doubtful: means and variances do not identify an attractor, so a wrong model can pass. Block averages are treated as
independent. The growth rate of errors is estimated along the measured trajectories only.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from atoll_coordinator.model.inference.final_model import FinalModel
from atoll_coordinator.model.inference.trajectory_simulation import compute_r2
from atoll_coordinator.model.selection.shortcut import predictable_rows
from atoll_coordinator.model.shooting.fit_result import TrajectoryFit, growth_rate, speed_growth
from atoll_coordinator.model.shooting.integration import Unsimulated
from atoll_coordinator.model.shooting.measurements import TrajectoryMeasurements
from atoll_coordinator.model.shooting.multiple_shooting import MultipleShooting
from atoll_coordinator.result.findings import Chaos
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray

_BLOCKS: Final = 4
"""Fewest blocks: the variance of fewer block averages cannot be estimated."""
_MOST_ROWS: Final = 4_000
"""Most rows of the long simulation. If more rows were measured, each row of the simulation represents several measured
rows."""


@dataclass(frozen=True, eq=False)
class LongRun:
    """How the model describes trajectories that are longer than the pieces of the fit.

    `fits`: whether the model describes whole trajectories up to their noise. None if this is not known, for instance if
    `chaos` is set. `r2` has the R2 of each state in simulations of the shown equations along whole trajectories, with
    fitted initial states; it is None if they were not simulated, and minus infinity if the simulation failed.
    `predictable_rows` is the number of rows that can be predicted. It is only set for a model with inputs, if errors
    grow exponentially and the predictable rows are fewer than the rows of a piece.
    """

    fits: bool | None
    chaos: Chaos | None
    r2: Sequence[float | None] | None = None
    predictable_rows: int | None = None


def assess_long_run(final: FinalModel) -> LongRun:
    """Return how well a model describes whole trajectories.

    The model is treated as chaotic if errors grow so fast that initial states do not determine whole trajectories. The
    growth rate of the trajectories is subtracted from the growth rate of errors, since a growing trajectory has no
    attractor. A model that may be chaotic cannot be refuted by a bad fit to whole trajectories. A model that cannot be
    chaotic is always tested along whole trajectories.
    """
    if final.task.piece >= final.task.longest:
        return LongRun(True, None)
    fit = final.free.fit
    rate = growth_rate(fit)
    growths = (rate, rate - speed_growth(fit))
    may_be = may_be_chaotic(final.shown_comparison.estimator.measurements)
    fits = None if may_be and all(_grows_exponentially(final, growth) for growth in growths) else _fits_in_whole(final)
    if fits:
        return LongRun(fits, None)
    may_be = may_be and not final.by_group
    predictable = max(predictable_rows(fit, final.comparison, growth) for growth in growths)
    if may_be and predictable < final.task.longest:
        if len(final.shown_comparison.estimator.measurements.inputs) and predictable < final.task.piece:
            return LongRun(fits, None, None, round(predictable))
        chaos = compare_averages(final.shown_fit, rate, final.shown_comparison.estimator.tolerance)
        return LongRun(None, chaos, None if chaos is not None else _whole_trajectory_r2(final))
    fits = None if final.task.is_nearly_clean else fits  # errors of a solver add up: a bad fit is no evidence
    return LongRun(fits, None, _whole_trajectory_r2(final) if fits is None else None)


def _whole_trajectory_r2(final: FinalModel) -> list[float | None] | None:
    """Return R2 (O,) of the shown equations along whole trajectories; None after the time limit.

    Without inputs, very many rows are thinned evenly.
    """
    task = replace(final.task, piece=final.task.longest)
    if task.is_over:
        return None
    measurements = task.measurements(task.variables)
    if not len(measurements.inputs):
        measurements = measurements.strided(-(-measurements.rows // SETTINGS.rows.most))
    comparison = task.make_comparison(measurements, task.variables, is_precise=True, measured_rows=measurements.rows)
    fit = final.simulate_along(comparison)
    if fit is None:
        return None if task.is_over else [-math.inf for _ in measurements.observed]
    return compute_r2(measurements, fit, slice(None))


def _grows_exponentially(final: FinalModel, rate: float) -> bool:
    """Tell whether errors that grow at this rate grow exponentially, along the longest trajectory.

    Without exponential growth, errors of D linear equations grow at most like t^(D - 1), so over N rows they grow by a
    factor below N^D. A larger factor counts as exponential growth.
    """
    measurements = final.comparison.estimator.measurements
    rows = final.task.longest
    return rate * measurements.step * rows > len(measurements.scales) * math.log(rows)


def _fits_in_whole(final: FinalModel) -> bool | None:
    """Tell whether the shown equations describe whole trajectories up to their noise; None if this was not tested.

    Phase errors grow in proportion to time. So they grow fast at first, relative to their size; errors in slow chaos do
    not. So constants are fitted once more, in pieces that grow to whole trajectories; very many rows are thinned. There
    is no test after the time limit, or for a model that does not describe the pieces.
    """
    task, programs = final.task, final.searched
    limit, deadline = SETTINGS.inference.excess, final.comparison.estimator.deadline
    if task.piece >= task.longest or not final.comparison.score.excess(final.free) <= limit:
        return None
    rows, allowed = task.measurements(task.variables).rows, SETTINGS.effort.fitted_sensitivities
    stride = -(-rows // max(allowed // len(task.variables) ** 2, SETTINGS.shooting.piece))
    if stride > 1 and len(final.comparison.estimator.measurements.inputs):
        return None
    while task.piece < task.longest:
        start_length = max(task.piece // stride, SETTINGS.shooting.lengths[1])
        task = replace(task, piece=min(task.piece * SETTINGS.shooting.segment_growth, task.longest))
        measurements = task.measurements(task.variables).strided(stride)
        comparison = task.make_comparison(measurements, task.variables, is_precise=True, measured_rows=rows)
        model = comparison.fit_model(programs, lengths=(start_length, None))
        if deadline.is_over:
            return None
        if model is None or not comparison.score.excess(model) <= limit:
            return False
        programs = model.programs
    return True


def may_be_chaotic(measurements: TrajectoryMeasurements) -> bool:
    """Tell whether a model of these measurements can be chaotic at all.

    With fewer than three states and no inputs, a bounded trajectory approaches a fixed point or a cycle, so it is not
    chaotic (Poincaré and Bendixson; Strogatz 1994, section 7.3). An equation of second order has two states.
    """
    return len(measurements.inputs) > 0 or len(measurements.smoothed) > 2


def compare_averages(fit: TrajectoryFit, rate: float, tolerance: float) -> Chaos | None:
    """Compare a long simulation with the measured means and variances. The result is None if the model has inputs.

    Args:
        fit: the model as it is shown, along the measured trajectories.
        rate: growth rate of errors, in e-folds per unit of time; it is above zero.
        tolerance: the allowed error of an integration step, divided by the standard deviation of the state.
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
    simulated = _simulate_long_run(fit, rows, stride, step, tolerance)
    if isinstance(simulated, str):
        return Chaos(lyapunov_time=1.0 / rate, is_kept=False, is_unfinished=simulated == "out of steps")
    measured = [measurements.smoothed[:, measurements.owners_of_rows == owner] for owner in range(len(lengths))]
    measured = measured if are_few else [trajectory[:, trajectory.shape[1] // 2 :] for trajectory in measured]
    centre = np.concatenate(measured, axis=1).mean(axis=1, keepdims=True)
    probability = 1.0
    for power in (1, 2):
        simulated_means = _block_means((simulated - centre) ** power, block // stride)
        measured_means = np.concatenate(
            [_block_means((trajectory - centre) ** power, block) for trajectory in measured], axis=1
        )
        probability = min(probability, *_welch_probabilities(simulated_means, measured_means))
    is_kept = probability >= SETTINGS.inference.improbable / (2.0 * len(centre))
    return Chaos(lyapunov_time=1.0 / rate, is_kept=is_kept, is_unfinished=False, probability=probability)


def _simulate_long_run(
    fit: TrajectoryFit, rows: int, stride: int, step: float, tolerance: float
) -> FloatArray | Unsimulated:
    """Simulate `rows` rows from the end of the last trajectory, and return every `stride`-th row; or the reason why the
    simulation failed."""
    times = step * np.arange(0.0, rows, stride)
    estimator = make_simulator(fit.estimator.measurements, times, tolerance, rows)
    return estimator.simulate(fit.system, fit.simulated[:, -1])


def make_simulator(
    measurements: TrajectoryMeasurements, times: FloatArray, tolerance: float, measured_rows: int, owner: int = 0
) -> MultipleShooting:  # fmt: skip
    """Return an estimator that simulates systems without inputs at these `times` (N,), without measurements.

    The allowed number of integration steps is proportional to `measured_rows`. Constants are taken from the group of
    trajectory `owner`.
    """
    rows, count = len(times), len(measurements.observed)
    low, high = measurements.smoothed.min(axis=1), measurements.smoothed.max(axis=1)
    without_measurements = replace(
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
    return MultipleShooting(without_measurements, tolerance, measured_rows=measured_rows)


def _block_means(values: FloatArray, block: int) -> FloatArray:
    """Return the means (D, B) of `values` (D, N) over B blocks, each of `block` rows. An incomplete block is
    dropped."""
    count = max(values.shape[1] // block, 1)
    return np.array([part.mean(axis=1) for part in np.array_split(values[:, : count * block], count, axis=1)]).T


def _welch_probabilities(simulated_means: FloatArray, measured_means: FloatArray) -> list[float]:
    """Return, for each state, the probability that the means differ at least this much by chance (B. L. Welch 1947)."""
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
