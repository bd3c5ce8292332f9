"""Simulations of a fitted model along measured trajectories: values, bands, and how much they explain. Pure.

Letters: P fitted constants, D states, O measured states, N rows, R rows of one trajectory, G pieces, each simulated
without a break.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from atoll_coordinator.data.recording import Preparation, Recording
from atoll_coordinator.model.selection.comparison import ModelComparison
from atoll_coordinator.model.shooting.measurements import Measurements
from atoll_coordinator.model.shooting.trajectory_fit import TrajectoryFit
from atoll_coordinator.model.thinning import curve, spread_places
from atoll_coordinator.result.listed_trajectories import Simulated, Simulation
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray, IntArray
from atoll_core.expression.program import Program, constant_places

_MOST_POINTS: Final = 200
"""Points of one simulated trajectory in a result; a longer one is thinned evenly."""
_MOST_NUMBERS: Final = 100_000
"""Numbers of all curves together, about 1 MB as text."""


@dataclass(frozen=True, eq=False)
class SimulatedTrajectory:
    """One trajectory by the model, from fitted initial conditions, at all of its rows.

    `times` (R,) are centred as in the recording; `measured` (O, R) are the measured states, NaN where a value is not
    used; `values` and `errors` (O, R) are the simulated states with offsets and their standard errors (None where the
    simulation ends early); `start` is the initial condition, states and then velocities, without offsets (None like
    `values`); `r2` has one number for each state, None where it could not be simulated to the end. `offsets` are the
    measured value minus the state, by the names of the states with an offset.
    """

    name: str
    held_out: bool
    times: FloatArray
    measured: FloatArray
    values: FloatArray | None
    errors: FloatArray | None
    r2: tuple[float | None, ...]
    start: FloatArray | None = None
    offsets: Mapping[str, float] = field(default_factory=dict)


def fit_starts(
    comparison: ModelComparison, programs: Sequence[Program], near: TrajectoryFit | None = None
) -> TrajectoryFit | None:
    """Return `programs`, all constants as they are, fitted to the trajectories by their initial states alone."""
    system = comparison.system(programs, [constant_places(program) for program in programs])
    starts, errors = (None, None) if near is None else (near.starts, near.errors)
    return comparison.estimator.fit(system, None, SETTINGS.effort.steps, starts, errors)


def simulate_trajectories(
    measurements: Measurements, fit: TrajectoryFit | None, errors: FloatArray | None, states: Sequence[str], *,
    held_out: bool,
) -> list[SimulatedTrajectory]:  # fmt: skip
    """Return the simulations of all trajectories of `states`, without curves where there is no fit; `errors` (O, N)."""
    measured = np.where(measurements.weights > 0.0, measurements.measured, np.nan)
    values, offsets = None, dict[str, FloatArray]()
    if fit is not None:
        values = fit.simulated[measurements.observed]
        lengths = fit.segments[:, 1] - fit.segments[:, 0]
        columns = fit.starts[:, fit.starts.shape[1] - len(measurements.offset) :].T
        for state, column in zip(measurements.offset.tolist(), columns, strict=True):
            offsets[states[state]] = np.repeat(column, lengths)
            values[state] += offsets[states[state]]
    return [
        SimulatedTrajectory(
            name,
            held_out,
            measurements.times[rows],
            measured[:, rows],
            None if values is None else values[:, rows],
            None if errors is None else errors[:, rows],
            tuple(None for _ in measurements.observed) if fit is None else tuple(r2_of(measurements, fit, rows)),
            None if fit is None else fit.simulated[:, rows[0]],
            {state: float(offset[rows].mean()) for state, offset in offsets.items()},
        )
        for name, rows in _rows_by_trajectory(measurements)
    ]


def _rows_by_trajectory(measurements: Measurements) -> list[tuple[str, IntArray]]:
    ranges = [np.arange(*bound) for bound in measurements.bounds.tolist()]
    named_rows = []
    for index, name in enumerate(measurements.names):
        own = [rows for rows, owner in zip(ranges, measurements.owners.tolist(), strict=True) if owner == index]
        if own:
            named_rows.append((name, np.concatenate(own)))
    return named_rows


def listed_simulation(
    trajectories: Sequence[SimulatedTrajectory], states: Sequence[str], quantile: float, preparation: Preparation
) -> Simulation:
    """Return simulations as a result lists them: thinned, at the times of the user's file, next to the measurements.

    The 95 % bands lie `quantile` standard errors on either side (Student's t, as of the constants). Where the errors of
    a solver were subtracted from the measurements, the result has the measurements themselves.
    """
    recording, source = preparation.recording, preparation.source
    assert recording is not None
    velocities = [] if source is None or not source.velocities else source.velocities
    names = [*states, *(velocities[source.states.index(name)] for name in states if source is not None and velocities)]
    numbers = len(trajectories) * (1 + 4 * len(states))
    most = max(2, min(_MOST_POINTS, _MOST_NUMBERS // max(numbers, 1)))

    def curves(values: FloatArray | None, rows: list[int]) -> dict[str, tuple[float | None, ...]] | None:
        return None if values is None else {name: curve(row[rows]) for name, row in zip(states, values, strict=True)}

    def listed(part: SimulatedTrajectory) -> Simulated:
        rows = spread_places(len(part.times), most)
        lower = upper = None
        if part.values is not None and part.errors is not None:
            with np.errstate(all="ignore"):
                lower, upper = part.values - quantile * part.errors, part.values + quantile * part.errors
        return Simulated(
            name=part.name,
            held_out=part.held_out,
            r2=dict(zip(states, part.r2, strict=True)),
            offsets=dict(part.offsets),
            start=None if part.start is None else dict(zip(names, part.start.tolist(), strict=False)),
            times=curve(part.times[rows] + recording.offset, digits=12),
            measured=curves(_as_measured(part, states, recording), rows) or {},
            values=curves(part.values, rows),
            lower=curves(lower, rows),
            upper=curves(upper, rows),
        )

    return Simulation(trajectories=tuple(map(listed, trajectories)))


def _as_measured(part: SimulatedTrajectory, states: Sequence[str], recording: Recording) -> FloatArray:
    """Return the measured states (O, R) of a trajectory, also where the errors of a solver were subtracted from it."""
    places = [recording.states.index(name) for name in states]
    measured = next(other.measured[places] for other in recording.trajectories if other.name == part.name)
    return (
        np.where(np.isnan(part.measured), np.nan, measured) if measured.shape == part.measured.shape else part.measured
    )


def r2_of(measurements: Measurements, fit: TrajectoryFit, rows: IntArray | slice) -> list[float | None]:
    """Return for each measured state the share of its variance along these rows that the simulation explains."""
    shares: list[float | None] = []
    for state in range(len(measurements.observed)):
        weights = measurements.weights[state, rows]
        squares = weights * fit.residuals[state, rows] ** 2
        values = measurements.measured[state, rows][weights > 0.0]
        inverse_variances = (
            np.ones(len(values))
            if measurements.inverse_variances is None
            else measurements.inverse_variances[state, rows][weights > 0.0]
        )
        mean = float((inverse_variances * values).sum() / inverse_variances.sum()) if len(values) else 0.0
        spread = float((inverse_variances * (values - mean) ** 2).sum())
        shares.append(1.0 - float(squares.sum()) / spread if spread > 0.0 else None)
    return shares


def bands(measurements: Measurements, fit: TrajectoryFit, spread: FloatArray, scale: float) -> FloatArray:
    """Return the standard errors (O, N) of the simulated states, from constants and initial states together.

    To first order: with sensitivities J of the constants and Y of a piece's initial state, whose normal equations have
    blocks B (coupling) and C (own), the variance of a state is K S K' + Y C^-1 Y' with K = J - Y C^-1 B'. The
    constants may have been fitted to these trajectories or to others.

    Args:
        measurements: the trajectories.
        fit: the fit of their initial states, in which the constants are free.
        spread: S, the covariance (P, P) of the constants.
        scale: factor of the variances from the normal equations.
    """
    fitted = fit.system.count
    standard_errors = np.zeros((len(measurements.observed), measurements.rows))
    sensitivities = fit.integrated_sensitivities()
    for group, (first, end) in enumerate(fit.segments.tolist()):
        own = np.linalg.pinv(fit.own[group], hermitian=True)
        carried = own @ fit.coupling[group].T
        for state, index in enumerate(measurements.observed.tolist()):
            gradients = sensitivities[first:end, index]
            starts = gradients[:, fitted:]
            constants = gradients[:, :fitted] - starts @ carried
            variance = ((constants @ spread) * constants).sum(axis=1)
            variance += scale * ((starts @ own) * starts).sum(axis=1)
            standard_errors[state, first:end] = np.sqrt(np.maximum(variance, 0.0))
    return standard_errors
