"""How far a fitted model can be trusted: errors of constants, bands of simulations, held-out trajectories. Pure.

Letters: P fitted constants, D states, N rows, G pieces that were simulated at a stretch.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from common.dataset import FloatArray
from common.expression.program import Program
from coordinator.model.refinement import LOOSE, Constant, Correlation, Simulated
from coordinator.model.rewrite import constant_places
from coordinator.model.trajectory.contest import Contest, Standing, bounded_covariance, covariance
from coordinator.model.trajectory.measurements import Measurements
from coordinator.model.trajectory.shooting import Shot

HIGH: Final = 0.95
"""Correlations of at least this size between two constants are reported."""

_STEPS: Final = 30


@dataclass(frozen=True, eq=False)
class Errors:
    """What the fit of all constants says of them: their joint covariance (P, P), and the rows left to judge it by."""

    values: FloatArray
    covariance: FloatArray
    freedom: float


def errors_of(contest: Contest, standing: Standing) -> Errors:
    """Return the errors of the constants of a fit, variances corrected for the numbers fitted."""
    shot = standing.shot
    counts = float(contest.counts.sum()) / contest.coherence
    fitted = len(shot.system.places) + shot.starts.size
    freedom = max(counts - fitted, 1.0)
    return Errors(shot.system.values, covariance(shot) * (contest.coherence * counts / freedom), freedom)


def constants_of(contest: Contest, shown: Sequence[Program], errors: Errors) -> list[tuple[Constant, ...]]:
    """Return the constants of each program with standard errors and 95 % intervals (Student's t)."""
    from scipy import special

    reach = float(special.stdtrit(errors.freedom, 0.975))
    spreads = np.sqrt(np.maximum(np.diag(errors.covariance), 0.0)).tolist()
    found: list[tuple[Constant, ...]] = []
    index = 0
    for equation, program in enumerate(shown):
        its: list[Constant] = []
        for value in program.constants[constant_places(program)].tolist():
            if equation in contest.fixed:
                its.append(Constant(value))
                continue
            fitted, error = float(errors.values[index]), spreads[index]
            bounds = (fitted - reach * error, fitted + reach * error) if math.isfinite(error) else None
            its.append(Constant(value, fitted, error, bounds, error <= LOOSE * abs(fitted)))
            index += 1
        found.append(tuple(its))
    return found


def correlations_of(
    contest: Contest, variables: Sequence[str], shown: Sequence[Program], errors: Errors
) -> tuple[Correlation, ...]:
    """Return the pairs of constants that are highly correlated, the highest first."""
    names = [
        (variable, place)
        for equation, (variable, program) in enumerate(zip(variables, shown, strict=True))
        if equation not in contest.fixed
        for place in range(len(constant_places(program)))
    ]
    spreads = np.sqrt(np.maximum(np.diag(errors.covariance), 1e-300))
    with np.errstate(invalid="ignore"):  # infinite variances
        unit = errors.covariance / np.outer(spreads, spreads)
    pairs = [
        Correlation(names[first], names[second], float(unit[first, second]))
        for second in range(len(names))
        for first in range(second)
        if HIGH <= abs(unit[first, second]) <= 1.0 + 1e-6
    ]
    return tuple(sorted(pairs, key=lambda pair: -abs(pair.value)))


def held(contest: Contest, programs: Sequence[Program], near: Shot | None = None) -> Shot | None:
    """Return `programs`, all constants as they are, fitted to the trajectories by their initial states alone."""
    system = contest.system(programs, [constant_places(program) for program in programs])
    starts, sigmas = (None, None) if near is None else (near.starts, near.sigmas)
    return contest.shooter.fit(system, None, _STEPS, starts, sigmas)


def simulated(
    its: Measurements, shot: Shot, errors: FloatArray | None, states: Sequence[str], *, held_out: bool
) -> list[Simulated]:
    """Return the simulations of all trajectories of `states`; `errors` are (O, N)."""
    offsets = _offsets(its, shot)
    values = shot.simulated[its.observed]
    for state, offset in zip(its.offset.tolist(), offsets, strict=True):
        values[state] += offset
    return [
        Simulated(
            name,
            held_out,
            its.times[rows],
            values[:, rows],
            None if errors is None else errors[:, rows],
            tuple(r2_of(its, shot, rows)),
            {states[state]: float(offset[rows].mean()) for state, offset in zip(its.offset, offsets, strict=True)},
        )
        for name, rows in _rows_of(its)
    ]


def _offsets(its: Measurements, shot: Shot) -> list[FloatArray]:
    """Return for each state that has one the offset at every row (N,)."""
    lengths = shot.segments[:, 1] - shot.segments[:, 0]
    columns = shot.starts[:, shot.starts.shape[1] - len(its.offset) :].T
    return [np.repeat(column, lengths) for column in columns]


def not_simulated(its: Measurements, *, held_out: bool) -> list[Simulated]:
    """Return as many simulations that came to nothing as there are trajectories."""
    unknown = tuple(None for _ in its.observed)
    return [Simulated(name, held_out, its.times[rows], None, None, unknown) for name, rows in _rows_of(its)]


def _rows_of(its: Measurements) -> list[tuple[str, FloatArray]]:
    ranges = [np.arange(*bound) for bound in its.bounds.tolist()]
    found = []
    for index, name in enumerate(its.names):
        own = [rows for rows, owner in zip(ranges, its.owners.tolist(), strict=True) if owner == index]
        if own:
            found.append((name, np.concatenate(own)))
    return found


def r2_of(its: Measurements, shot: Shot, rows: FloatArray | slice) -> list[float | None]:
    """Return for each measured state the share of its variance along these rows that the simulation explains."""
    found: list[float | None] = []
    for state in range(len(its.observed)):
        weights = its.weights[state, rows]
        left = weights * shot.residuals[state, rows] ** 2
        values = its.measured[state, rows][weights > 0.0]
        spread = float(((values - values.mean()) ** 2).sum()) if len(values) else 0.0
        found.append(1.0 - float(left.sum()) / spread if spread > 0.0 else None)
    return found


def bands(its: Measurements, standing: Standing, errors: Errors) -> FloatArray:
    """Return the standard errors (O, N) of the simulated states: those of constants and initial states together.

    To first order: with sensitivities J of the constants and Y of a piece's initial state, whose normal equations have
    blocks B (coupling) and C (own), the variance of a state is K S K' + Y C^-1 Y' with K = J - Y C^-1 B'.
    """
    shot = standing.shot
    fitted = len(shot.system.places)
    scale = float(its.weights.sum()) / errors.freedom
    spread = scale * bounded_covariance(shot)
    found = np.zeros((len(its.observed), its.rows))
    for group, (first, end) in enumerate(shot.segments.tolist()):
        own = np.linalg.pinv(shot.own[group], hermitian=True)
        carried = own @ shot.coupling[group].T
        for state, index in enumerate(its.observed.tolist()):
            gradients = shot.gradients[first:end, index]
            starts = gradients[:, fitted:]
            constants = gradients[:, :fitted] - starts @ carried
            variance = np.einsum("np,pq,nq->n", constants, spread, constants)
            variance += scale * np.einsum("nd,de,ne->n", starts, own, starts)
            found[state, first:end] = np.sqrt(np.maximum(variance, 0.0))
    return found
