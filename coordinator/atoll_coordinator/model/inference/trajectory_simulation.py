"""Simulations of a fitted model along measured trajectories: values, bands, and how much they explain. Pure.

Letters: P fitted constants, D states, N rows, G pieces that were simulated at a stretch.
"""

from collections.abc import Sequence

import numpy as np

from atoll_coordinator.model.inference.standard_errors import Errors
from atoll_coordinator.model.refinement import Simulated
from atoll_coordinator.model.selection.comparison import ModelComparison
from atoll_coordinator.model.shooting.measurements import Measurements
from atoll_coordinator.model.shooting.trajectory_fit import TrajectoryFit, bounded_covariance
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray, IntArray
from atoll_core.expression.program import Program, constant_places


def fit_starts(
    comparison: ModelComparison, programs: Sequence[Program], near: TrajectoryFit | None = None
) -> TrajectoryFit | None:
    """Return `programs`, all constants as they are, fitted to the trajectories by their initial states alone."""
    system = comparison.system(programs, [constant_places(program) for program in programs])
    starts, errors = (None, None) if near is None else (near.starts, near.errors)
    return comparison.estimator.fit(system, None, SETTINGS.effort.steps, starts, errors)


def simulated(
    measurements: Measurements, fit: TrajectoryFit, errors: FloatArray | None, states: Sequence[str], *, held_out: bool
) -> list[Simulated]:
    """Return the simulations of all trajectories of `states`; `errors` are (O, N)."""
    offsets, measured = _offsets(measurements, fit), _measured(measurements)
    with_offset = [states[int(state)] for state in measurements.offset.tolist()]
    values = fit.simulated[measurements.observed]
    for state, offset in zip(measurements.offset.tolist(), offsets, strict=True):
        values[state] += offset
    return [
        Simulated(
            name,
            held_out,
            measurements.times[rows],
            measured[:, rows],
            values[:, rows],
            None if errors is None else errors[:, rows],
            tuple(r2_of(measurements, fit, rows)),
            fit.simulated[:, rows[0]],
            {state: float(offset[rows].mean()) for state, offset in zip(with_offset, offsets, strict=True)},
        )
        for name, rows in _rows_of(measurements)
    ]


def _offsets(measurements: Measurements, fit: TrajectoryFit) -> list[FloatArray]:
    """Return for each state that has one the offset at every row (N,)."""
    lengths = fit.segments[:, 1] - fit.segments[:, 0]
    columns = fit.starts[:, fit.starts.shape[1] - len(measurements.offset) :].T
    return [np.repeat(column, lengths) for column in columns]


def not_simulated(measurements: Measurements, *, held_out: bool) -> list[Simulated]:
    """Return as many simulations that came to nothing as there are trajectories."""
    unknown, measured = tuple(None for _ in measurements.observed), _measured(measurements)
    return [
        Simulated(name, held_out, measurements.times[rows], measured[:, rows], None, None, unknown)
        for name, rows in _rows_of(measurements)
    ]


def _measured(measurements: Measurements) -> FloatArray:
    """Return the measured states (O, N), NaN where a value is not used."""
    return np.where(measurements.weights > 0.0, measurements.measured, np.nan)


def _rows_of(measurements: Measurements) -> list[tuple[str, IntArray]]:
    ranges = [np.arange(*bound) for bound in measurements.bounds.tolist()]
    named_rows = []
    for index, name in enumerate(measurements.names):
        own = [rows for rows, owner in zip(ranges, measurements.owners.tolist(), strict=True) if owner == index]
        if own:
            named_rows.append((name, np.concatenate(own)))
    return named_rows


def r2_of(measurements: Measurements, fit: TrajectoryFit, rows: IntArray | slice) -> list[float | None]:
    """Return for each measured state the share of its variance along these rows that the simulation explains."""
    shares: list[float | None] = []
    for state in range(len(measurements.observed)):
        weights = measurements.weights[state, rows]
        left = weights * fit.residuals[state, rows] ** 2
        values = measurements.measured[state, rows][weights > 0.0]
        inverse_variances = (
            np.ones(len(values))
            if measurements.inverse_variances is None
            else measurements.inverse_variances[state, rows][weights > 0.0]
        )
        mean = float((inverse_variances * values).sum() / inverse_variances.sum()) if len(values) else 0.0
        spread = float((inverse_variances * (values - mean) ** 2).sum())
        shares.append(1.0 - float(left.sum()) / spread if spread > 0.0 else None)
    return shares


def scaled_covariance(fit: TrajectoryFit, errors: Errors) -> tuple[FloatArray, float]:
    """Return the covariance (P, P) of the constants, large where it is infinite, and what variances of initial states
    are to be scaled by."""
    return errors.scale * bounded_covariance(fit), errors.scale


def bands(measurements: Measurements, fit: TrajectoryFit, spread: FloatArray, scale: float) -> FloatArray:
    """Return the standard errors (O, N) of the simulated states: those of constants and initial states together.

    To first order: with sensitivities J of the constants and Y of a piece's initial state, whose normal equations have
    blocks B (coupling) and C (own), the variance of a state is K S K' + Y C^-1 Y' with K = J - Y C^-1 B'. The
    constants may have been fitted to these trajectories or to others.

    Args:
        measurements: the trajectories.
        fit: the fit of their initial states, in which the constants are free.
        spread: S, the covariance (P, P) of the constants.
        scale: what variances that follow from normal equations are multiplied by.
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
