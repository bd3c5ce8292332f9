"""Errors of the solver that computed a table: the table is computed again, and the errors are subtracted.

How it works. The errors of a solver depend only on the equations, on the first row and on the solver (Zadunaisky 1976,
Numerische Mathematik 27:21). So the same solver makes the same errors again. Each common solver is tried. For each
solver, constants are fitted so that its solutions reproduce the rows. The solutions of a solver depend on constants
almost like exact solutions, so Gauss-Newton steps with exact sensitivities converge (defect correction, Stetter 1978,
Numerische Mathematik 29:425). The fit begins with few rows, because the solutions jump where the solver accepts a step
for some constants and rejects it for others. With wrong equations, or another solver, the residuals stay as large as
before, and no errors are subtracted.

Doubt. Only the solvers and tolerances in `SOLVERS` are tried. The first row of the table must be the first row of the
simulation.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from atoll_coordinator.data.recording import Recording, StateSmoothing
from atoll_coordinator.model.constants.rounding import Estimates
from atoll_coordinator.model.selection.task import ModellingTask
from atoll_coordinator.model.shooting.fit_result import TrajectoryFit
from atoll_coordinator.model.shooting.integration import STEPS_PER_ROW
from atoll_coordinator.model.shooting.measurements import TrajectoryMeasurements, measurements_of
from atoll_coordinator.model.shooting.system import OdeSystem
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.evaluation import NUMPY, function_of


@dataclass(frozen=True)
class Solver:
    """A method of scipy.integrate with its tolerances."""

    method: str
    rtol: float
    atol: float

    @property
    def name(self) -> str:
        """The name of the solver in remarks for the user."""
        return f"scipy.integrate.solve_ivp, {self.method}, rtol={self.rtol:g}, atol={self.atol:g}"


_DEFAULT_ATOL: Final = 1e-6
SOLVERS: Final = tuple(
    Solver(method, rtol, atol)
    for rtol, atol in (
        (1e-3, _DEFAULT_ATOL), (1e-6, _DEFAULT_ATOL), (1e-6, 1e-9), (1e-8, _DEFAULT_ATOL), (1e-8, 1e-8),
    )
    for method in ("RK45", "LSODA")
)  # fmt: skip
"""Solvers that are tried: the defaults, and other common settings."""


_PATIENCE: Final = 5
"""A fit ends after this number of steps that have not halved the residuals. The limit is not 1, since the residuals
change irregularly at first: with other constants, the solver accepts and rejects other steps."""


@dataclass(frozen=True, eq=False)
class _Run:
    """One trajectory: its `times` (R,) and the `measured` states (S, R)."""

    times: FloatArray
    measured: FloatArray


@dataclass(frozen=True, eq=False)
class _Reproduction:
    """A system with the constants with which a solver reproduces the rows, and the residuals of each state (S,)."""

    solver: Solver
    system: OdeSystem
    residuals: FloatArray


def subtract_solver_errors(task: ModellingTask, fit: TrajectoryFit) -> ModellingTask | None:
    """Return the task without the errors of the solver that computed the table from the equations of `fit`.

    None if no solver reproduces the table. The first row must be the initial state of the solver, and have all states.
    """
    recording = task.recording
    if (
        not task.is_nearly_clean or recording.order != 1 or recording.inputs or recording.offsets or recording.groups
        or recording.states != task.variables or fit.system.sharing is not None
        or recording.hidden or recording.observed  # a solver's first states are then not among the rows
    ):  # fmt: skip
        return None
    whole = measurements_of(recording, range(len(task.variables)), piece=max(map(len, _times(recording))))
    if not np.isfinite(whole.measured[:, whole.bounds[:, 0]]).all():
        return None
    found = next((found for solver in SOLVERS if (found := _reproduce_rows(task, whole, solver, fit.system))), None)
    return None if found is None else _correct_task(task, found)


def _times(recording: Recording) -> Iterator[FloatArray]:
    return (part.times for part in recording.trajectories if not part.held_out)


def _reproduce_rows(
    task: ModellingTask, whole: TrajectoryMeasurements, solver: Solver, system: OdeSystem
) -> _Reproduction | None:
    """Return the constants with which the solver reproduces all rows; None if there are no such constants.

    Along chaotic trajectories the last digits of the constants matter. So simple numbers are also tried as constants,
    since all digits of these numbers are known.
    """
    at = whole.times + task.recording.offset  # LSODA's first step depends on the time
    runs = [_Run(at[first:end], whole.measured[:, first:end]) for first, end in whole.bounds.tolist()]
    longest, rows, share = max(len(run.times) for run in runs), SETTINGS.shooting.lengths[1], np.inf
    while True:
        ranges = [
            (first, min(first + rows, end), owner)
            for (first, end), owner in zip(whole.bounds.tolist(), whole.owners.tolist(), strict=True)
        ]
        system_before, before, part = system, share, whole.pieces(ranges)
        system, left, share = _fit_constants(task, part, solver, system_before, runs)
        if before <= SETTINGS.common.negligible < share and system.count <= SETTINGS.effort.beam:
            system, left, share = min(
                (system, left, share),
                _fit_constants(task, part, solver, _round_to_simple_numbers(system_before), runs),
                key=lambda end: end[2],
            )
        if share**2 > SETTINGS.inference.part:  # for the right solver 0.1 was observed, for others mostly more than 1
            return None
        if rows >= longest:
            return _Reproduction(solver, system, left) if share <= SETTINGS.common.negligible else None
        rows *= 2


def _fit_constants(
    task: ModellingTask, part: TrajectoryMeasurements, solver: Solver, system: OdeSystem, runs: Sequence[_Run]
) -> tuple[OdeSystem, FloatArray, float]:
    """Return the constants for which the solutions of a solver have the smallest residuals on the first rows, and two
    ratios.

    The first ratio is, for each state (S,), the rms residual divided by the standard deviation of the state. The second
    ratio is, for all states together, the rms residual divided by the rms error of the solver.
    """
    estimator = task.make_comparison(part, task.variables, has_noise=False).estimator
    scales, starts = part.scales[:, None], np.ascontiguousarray(part.measured[:, part.bounds[:, 0]].T)
    least, share, best, found = np.inf, np.inf, system, np.full(len(part.scales), np.inf)
    patience = _PATIENCE
    for _ in range(SETTINGS.effort.steps):
        fit = estimator.fit(system, None, 0, starts)
        solved = None if fit is None else _solve_rows(task, solver, system, part, runs)
        if fit is None or solved is None:
            break
        rest, errors = (part.measured - solved) / scales, (solved - fit.simulated) / scales
        is_known = np.isfinite(rest)
        residual_size, error_size = (float(np.sqrt((numbers[is_known] ** 2).mean())) for numbers in (rest, errors))
        patience = _PATIENCE if residual_size < 0.5 * least else patience - (1 if residual_size < error_size else 2)
        if residual_size < least:
            least, share, best = (
                residual_size,
                residual_size / error_size if error_size > SETTINGS.shooting.exact else np.inf,
                system,
            )
            found = np.sqrt((np.nan_to_num(rest) ** 2).mean(axis=1))
        if least <= 0.1 * SETTINGS.shooting.exact or patience <= 0 or not system.count or task.is_over:
            break
        slopes = fit.integrated_sensitivities()[:, :, : system.count].transpose(1, 0, 2) / scales[:, :, None]
        system = _step_constants(system, slopes[is_known], rest[is_known])
    return best, found, share


def _round_to_simple_numbers(system: OdeSystem) -> OdeSystem:
    """Return the system with constants rounded to simple numbers. The errors that constants have in an exact model
    limit the rounding."""
    values = system.values.copy()
    simple = Estimates(values, np.diag((SETTINGS.inference.exact * values) ** 2)).accepted_numbers
    values[[*simple]] = [*simple.values()]
    return system.with_values(values)


def _step_constants(system: OdeSystem, slopes: FloatArray, residuals: FloatArray) -> OdeSystem:
    """Return the system after a least-squares step for `residuals` (M,) with the sensitivities `slopes` (M, P).

    Combinations of constants that the rows hardly determine are not changed.
    """
    sizes = np.abs(system.values)
    left, singular, right = np.linalg.svd(slopes * sizes, full_matrices=False)
    known = (residuals @ residuals) / len(residuals) / SETTINGS.inference.largest_uncertainty**2
    moves = (residuals @ left) * singular / (singular**2 + known)
    return system.with_values(system.values + sizes * (moves @ right))


def _solve_rows(
    task: ModellingTask, solver: Solver, system: OdeSystem, part: TrajectoryMeasurements, runs: Sequence[_Run]
) -> FloatArray | None:
    """Return the states (S, N) that the solver computes at the first rows of all runs; None if it fails."""
    from scipy import integrate

    order = [part.variables.index(name) for name in task.dataset.names]
    values = function_of(system.programs, len(order), NUMPY)

    def rates(_: float, state: FloatArray) -> FloatArray:
        return np.array(values(*state[order]), dtype=np.float64)

    method, solved = getattr(integrate, solver.method), []
    for run, (first, end) in zip(runs, part.bounds.tolist(), strict=True):
        times, done = run.times[: end - first], 1
        states = np.repeat(run.measured[:, :1], len(times), axis=1)
        with np.errstate(all="ignore"):
            if not np.isfinite([run.measured[:, 0], rates(run.times[0], run.measured[:, 0])]).all():
                return None  # a step from there would never end
            steps = method(rates, run.times[0], run.measured[:, 0], run.times[-1], rtol=solver.rtol, atol=solver.atol)
            for _ in range(STEPS_PER_ROW * len(times)):
                if done == len(times) or steps.step() is not None:
                    break
                reached = int(np.searchsorted(times, steps.t, side="right"))
                states[:, done:reached] = steps.dense_output()(times[done:reached])
                done = max(done, reached)
        if done < len(times) or not np.isfinite(states).all():
            return None
        solved.append(states)
    return np.concatenate(solved, axis=1)


def _correct_task(task: ModellingTask, found: _Reproduction) -> ModellingTask | None:
    """Return the task with a corrected table: along each piece it has the exact solution that begins at the first row
    of the piece."""
    trajectories = list(task.recording.trajectories)
    for is_held_out in sorted({part.held_out for part in trajectories}):
        measurements = task.measurements(task.variables, held_out=is_held_out)
        places = [place for place, part in enumerate(trajectories) if part.held_out == is_held_out]
        runs = [
            _Run(trajectories[place].times + task.recording.offset, trajectories[place].measured) for place in places
        ]
        ends = np.cumsum([len(run.times) for run in runs])
        bounds = np.stack([ends - [len(run.times) for run in runs], ends], axis=1)
        solved = _solve_rows(task, found.solver, found.system, replace(measurements, bounds=bounds), runs)
        if solved is None:
            return None
        estimator = task.make_comparison(measurements, task.variables, has_noise=False).estimator
        starts = np.ascontiguousarray(solved[:, measurements.bounds[:, 0]].T)
        exact = estimator.fit(found.system, None, 0, starts)
        if exact is None:
            return None
        errors = solved - exact.simulated
        for place, (first, end) in zip(places, bounds.tolist(), strict=True):
            part = trajectories[place]
            measured = part.measured - errors[:, first:end]
            smoothed = np.where(np.isfinite(measured), measured, part.smoothed - errors[:, first:end])
            trajectories[place] = replace(part, measured=measured, smoothed=smoothed)
    smoothing = tuple(
        _remove_noise(one, float(left)) for one, left in zip(task.recording.smoothing, found.residuals, strict=True)
    )
    recording = replace(task.recording, trajectories=tuple(trajectories), smoothing=smoothing)
    return replace(task, recording=recording, solver=found.solver.name)


def _remove_noise(smoothing: StateSmoothing, left: float) -> StateSmoothing:
    """Return the smoothing of a state whose errors have the size `left`, a share of the standard deviation of the
    state."""
    deviation = smoothing.noise / smoothing.relative_noise if smoothing.relative_noise > 0.0 else 0.0
    return replace(
        smoothing, method="interpolation", noise=left * deviation, relative_noise=left, span=None, degree=None
    )
