"""Simulations of a fitted model along measured trajectories: values, standard errors, R2. Pure.

`simulated_standard_errors` computes the errors of a simulation to first order, from the covariance of the constants and
initial states and from the sensitivities. `compute_r2` compares simulations with measurements, row by row with weights.

Doubtful: the bands are first-order, so they are wrong if a small change of a constant changes a trajectory
qualitatively. The bands do not include measurement errors or the uncertainty of the structure.

Letters: P fitted constants, D states, O measured states, N rows, R rows of one trajectory, G pieces; each piece is
simulated without a break.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from atoll_coordinator.data.recording import Preparation
from atoll_coordinator.model.selection.comparison import ModelComparison
from atoll_coordinator.model.shooting.fit_result import TrajectoryFit
from atoll_coordinator.model.shooting.measurements import TrajectoryMeasurements
from atoll_coordinator.model.thinning import curve, curves, spread_places
from atoll_coordinator.result.listed_trajectories import Simulated
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray, IntArray
from atoll_core.expression.program import Program, constant_places

_MOST_POINTS: Final = 200
"""Most points of one simulated trajectory in a result; a longer trajectory is thinned evenly."""
_MOST_NUMBERS: Final = 100_000
"""Most numbers of all curves together, about 1 MB as text."""


def fit_initial_states(
    comparison: ModelComparison, programs: Sequence[Program], near: TrajectoryFit | None = None,
    parameters: FloatArray | None = None,
) -> TrajectoryFit | None:  # fmt: skip
    """Return the simulation of `programs` with fitted initial states and unchanged constants; None if it fails.

    The parameters of a template have the values `parameters`; None: their values in `near`.
    """
    if parameters is None and near is not None:
        parameters = near.system.parameter_values
    nodes = [constant_places(program) for program in programs]
    system = comparison.system(programs, nodes, parameters=parameters)
    starts, errors = (None, None) if near is None else (near.starts, near.errors)
    return comparison.estimator.fit(system, None, SETTINGS.effort.steps, starts, errors)


def simulated_states(
    measurements: TrajectoryMeasurements, fit: TrajectoryFit, states: Sequence[str]
) -> tuple[FloatArray, dict[str, FloatArray]]:
    """Return the simulated values of measured columns (which include the offsets) and then of hidden states, and the
    offsets (N,) by state."""
    offsets = dict[str, FloatArray]()
    values = np.concatenate([fit.simulated_columns, fit.simulated[list(measurements.hidden)]])
    lengths = fit.segments[:, 1] - fit.segments[:, 0]
    columns = fit.starts[:, fit.starts.shape[1] - len(measurements.offset) :].T
    for state, column in zip(measurements.offset.tolist(), columns, strict=True):
        offsets[states[state]] = np.repeat(column, lengths)
        values[state] += offsets[states[state]]
    return values, offsets


def rows_by_trajectory(measurements: TrajectoryMeasurements) -> list[tuple[str, IntArray]]:
    """Return the name and the rows of each trajectory that has rows."""
    ranges = [np.arange(*bound) for bound in measurements.bounds.tolist()]
    named_rows = []
    for index, name in enumerate(measurements.names):
        own = [rows for rows, owner in zip(ranges, measurements.owners.tolist(), strict=True) if owner == index]
        if own:
            named_rows.append((name, np.concatenate(own)))
    return named_rows


def list_trajectories(
    measurements: TrajectoryMeasurements, fit: TrajectoryFit | None, errors: FloatArray | None, states: Sequence[str],
    preparation: Preparation, quantile: float,
) -> list[Simulated]:  # fmt: skip
    """Return the simulations for a result: with fewer rows, at times of the user's file, together with the
    measurements.

    Without a fit there are no curves. If the errors of a solver were subtracted from the measurements, the result
    contains the original measurements.

    Args:
        measurements: the trajectories.
        fit: their simulation; None if it failed.
        errors: the standard errors of the simulated columns and hidden states; None: there are no bands.
        states: names of the O measured columns, then of the hidden states.
        preparation: the prepared table.
        quantile: half the width of the 95 % bands, in standard errors. It is a quantile of Student's t distribution,
            the same as for the constants.
    """
    recording, source = preparation.recording, preparation.source
    assert recording is not None
    velocities = [] if source is None or not source.velocities else source.velocities
    columns = states[: len(measurements.observed)]
    names = [*measurements.variables[: len(measurements.smoothed)]]
    if not measurements.hidden:
        names = [
            *states, *(velocities[source.states.index(name)] for name in states if source is not None and velocities)
        ]  # fmt: skip
    parts = {part.name: part for part in recording.trajectories}
    most = max(2, min(_MOST_POINTS, _MOST_NUMBERS // (len(parts) * (1 + 4 * len(states)))))
    values, offsets = (None, dict[str, FloatArray]()) if fit is None else simulated_states(measurements, fit, states)

    def curves_of(values: FloatArray | None, rows: IntArray) -> dict[str, tuple[float | None, ...]] | None:
        return None if values is None else curves(states, values[:, rows])

    with np.errstate(all="ignore"):
        reach = None if values is None or errors is None else quantile * errors
        lower, upper = (None, None) if values is None or reach is None else (values - reach, values + reach)
    listed = []
    for name, rows in rows_by_trajectory(measurements):
        places = spread_places(len(rows), most)
        measured = np.where(measurements.weights > 0.0, measurements.measured, np.nan)[:, rows]
        recorded = parts[name].measured[[recording.states.index(column) for column in columns]]
        if recorded.shape == measured.shape:
            measured = np.where(np.isnan(measured), np.nan, recorded)
        r2 = [None for _ in columns] if fit is None else compute_r2(measurements, fit, rows)
        start = None if fit is None else dict(zip(names, fit.simulated[:, rows[0]].tolist(), strict=False))
        listed.append(Simulated(
            name=name,
            held_out=parts[name].held_out,
            r2=dict(zip(columns, r2, strict=True)),
            offsets={state: float(offset[rows].mean()) for state, offset in offsets.items()},
            start=start,
            times=curve(measurements.times[rows[places]] + recording.offset, digits=12),
            measured=curves(columns, measured[:, places]),
            values=curves_of(values, rows[places]),
            lower=curves_of(lower, rows[places]),
            upper=curves_of(upper, rows[places]),
        ))  # fmt: skip
    return listed


def compute_r2(measurements: TrajectoryMeasurements, fit: TrajectoryFit, rows: IntArray | slice) -> list[float | None]:
    """Return R2 of the simulation along these rows, for each measured state. R2 is None if the state does not vary."""
    shares: list[float | None] = []
    for state in range(len(measurements.observed)):
        squares = measurements.weights[state, rows] * fit.residuals[state, rows] ** 2
        spread, _ = squares_about_mean(measurements, state, rows)
        shares.append(1.0 - float(squares.sum()) / spread if spread > 0.0 else None)
    return shares


def squares_about_mean(measurements: TrajectoryMeasurements, state: int, rows: IntArray | slice) -> tuple[float, int]:
    """Return the sum of the squared differences of a measured state from its mean, scaled to weight 1, and the number
    of rows that count."""
    counts = measurements.weights[state, rows] > 0.0
    values = measurements.measured[state, rows][counts]
    weights = np.ones(len(values))
    if measurements.inverse_variances is not None:
        weights = measurements.inverse_variances[state, rows][counts]
    mean = float((weights * values).sum() / weights.sum()) if len(values) else 0.0
    return float((weights * (values - mean) ** 2).sum()), len(values)


def simulated_standard_errors(
    measurements: TrajectoryMeasurements, fit: TrajectoryFit, spread: FloatArray, scale: float
) -> FloatArray:
    """Return the standard errors of the simulated columns and then of the hidden states, by row, that are due to the
    errors of constants and initial states together.

    To first order, the variance of a state is K S K' + Y C^-1 Y' with K = J - Y C^-1 B'. J are the sensitivities to the
    constants, and Y the sensitivities to the initial state of the piece. B and C are blocks of the normal equations: B
    couples constants and initial state, and C belongs to the initial state alone. The constants may have been fitted to
    these or to other trajectories.

    Args:
        measurements: the trajectories.
        fit: the fit of their initial states, in which the constants are free.
        spread: S, the covariance (P, P) of the constants.
        scale: a factor by which variances from the normal equations are multiplied.
    """
    fitted = fit.system.count
    standard_errors = np.zeros((len(measurements.shown), measurements.rows))
    sensitivities = fit.integrated_sensitivities()
    for group, (first, end) in enumerate(fit.segments.tolist()):
        own = np.linalg.pinv(fit.blocks.own[group], hermitian=True)
        carried = own @ fit.blocks.coupling[group].T
        for state, index in enumerate(measurements.shown.tolist()):
            gradients = sensitivities[first:end, index]
            starts = gradients[:, fitted:]
            constants = gradients[:, :fitted] - starts @ carried
            variance = ((constants @ spread) * constants).sum(axis=1)
            variance += scale * ((starts @ own) * starts).sum(axis=1)
            standard_errors[state, first:end] = np.sqrt(np.maximum(variance, 0.0))
    return standard_errors
