"""From the chosen system to what is reported: constants with errors, contenders, verdicts, simulations."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from common.dataset import FloatArray, Problem
from common.expression.program import Program
from coordinator.model.derivative import values_of
from coordinator.model.errors import errors_on
from coordinator.model.refinement import Constant, Contender, Pool, Refined, Refinement, Simulated, Simulation
from coordinator.model.rewrite import structure
from coordinator.model.trajectory.assess import (
    Errors,
    bands,
    constants_of,
    correlations_of,
    errors_of,
    held,
    not_simulated,
    r2_of,
    simulated,
)
from coordinator.model.trajectory.contest import Contest, Standing
from coordinator.model.trajectory.model import Chosen, Field
from coordinator.model.trajectory.pieces import on_all_rows, remarks
from coordinator.model.trajectory.rounding import rounded
from coordinator.model.verdict import Evidence, judge

CONTENDERS: Final = 8
"""Contenders of a variable that are reported, at most."""

SAME: Final = 1e-3
"""Equations whose values differ by less than this share of their deviation, root mean square, are the same function."""

_STEPS: Final = 20


@dataclass(frozen=True, eq=False)
class _Final:
    """The model on all rows: `shown` programs, their fit with all constants free, and as they are shown."""

    field: Field
    choice: Chosen
    contest: Contest
    shown: tuple[Program, ...]
    free: Standing
    held: Standing


@dataclass(frozen=True, eq=False)
class _HeldOut:
    """The simulations of trajectories that took no part, and their R2 by variable."""

    trajectories: tuple[Simulated, ...]
    r2: tuple[float | None, ...]


def concluded(choice: Chosen, pools: Mapping[str, Pool]) -> Refinement | None:
    """Return the refinement that the chosen system gives; None when it cannot be simulated on all rows."""
    final = _finalized(choice)
    if final is None:
        return None
    field = final.field
    errors = errors_of(final.contest, final.free)
    constants = constants_of(final.contest, final.shown, errors)
    out = _held_out(field, final.shown)
    equations = {
        name: _refined(final, index, constants[index], None if out is None else out.r2[index], pools.get(name))
        for index, name in enumerate(field.variables)
    }
    its = final.contest.shooter.measurements
    trajectories = simulated(its, final.held.shot, bands(its, final.free, errors), held_out=False)
    return Refinement(
        equations,
        Simulation(field.variables, (*trajectories, *(out.trajectories if out is not None else ()))),
        correlations_of(final.contest, field.variables, final.shown, errors),
        tuple(remarks(field)),
    )


def _finalized(choice: Chosen) -> _Final | None:
    """Fit the chosen system to all rows, make its constants simple, and fit what is shown again."""
    whole = on_all_rows(choice)
    if whole is None:
        return None
    contest, best = whole.contest, whole.standing
    shown = rounded(contest, best)
    free = contest.beside(best, shown, _STEPS)
    shot = held(contest, shown, best.shot)
    if free is None or shot is None:
        return None
    return _Final(whole.field, choice, contest, shown, free, contest.measured(shown, shot))


def _held_out(field: Field, shown: Sequence[Program]) -> _HeldOut | None:
    """Simulate the held-out trajectories from initial states that are fitted to them; None when there are none."""
    if not any(each.held_out for each in field.recording.trajectories):
        return None
    its = field.measurements(field.variables, held_out=True)
    shot = held(field.contest(its, field.variables), shown)
    if shot is None:
        return _HeldOut(tuple(not_simulated(its, held_out=True)), tuple(-np.inf for _ in field.variables))
    return _HeldOut(tuple(simulated(its, shot, None, held_out=True)), tuple(r2_of(its, shot, slice(None))))


def _refined(
    final: _Final, index: int, constants: tuple[Constant, ...], held_out_r2: float | None, pool: Pool | None
) -> Refined:
    field = final.field
    name, program = field.variables[index], final.shown[index]
    problem = field.dataset.problem(name)
    error, mse = errors_on(problem, program, field.config.evolution.loss)
    contenders = _contenders(final, index)
    rivals = [each.nats for each in contenders if not each.is_shown]
    variance = problem.target.deviation**2
    smoothing = field.recording.smoothing[field.recording.states.index(name)]
    its = final.contest.shooter.measurements
    evidence = Evidence(
        error=error / problem.target.deviation,
        floor=problem.target.floor,
        target_r2=1.0 - mse / variance if variance else None,
        residuals=[final.held.shot.residuals[index, first:end] for first, end in its.bounds.tolist()],
        parameters=(len(final.free.shot.system.places) + final.free.shot.starts.size) / len(its.observed),
        noise=0.0 if smoothing.method == "interpolation" else smoothing.noise,
        deviation=float(its.scales[index]),
        has_outliers=smoothing.outliers > 0,
        held_out_r2=held_out_r2,
        constants=constants,
        rival=min(rivals, default=None),
    )
    grade, reason = judge(evidence)
    member = _member(program, pool, problem)
    return Refined(member, program, error, mse, constants, contenders, grade, reason)


def _member(program: Program, pool: Pool | None, problem: Problem) -> int | None:
    """Return the index of the front member of the same structure, if there is one."""
    if pool is None:
        return None
    key = structure(program)
    for index, entry in enumerate(pool.front):
        if structure(Program.from_bytes(entry.program, len(problem.names))) == key:
            return index
    return None


def _contenders(final: _Final, index: int) -> tuple[Contender, ...]:
    """Return the equation that is shown and what came closest to it, all other equations as they are."""
    r2 = r2_of(final.contest.shooter.measurements, final.held.shot, slice(None))[index]
    shown = Contender(final.shown[index], 0.0, r2, is_shown=True)
    contest, best = final.choice.contest, final.choice.standing
    if index in contest.fixed:
        return (shown,)
    tried = sorted(
        (each for (equation, _), each in contest.tried.items() if equation == index), key=lambda its: its.nats
    )
    programs = {structure(each.programs[index]): each.programs[index] for each in tried}
    near = contest.halved(best, index, list(programs.values())[: 4 * CONTENDERS], ((12, 3 * CONTENDERS),))
    inputs = final.field.dataset.inputs
    functions = [values_of(best.programs[index], inputs)]
    found = [shown]
    for each in near:
        values = values_of(each.programs[index], inputs)
        if all(_differ(values, other) for other in functions):
            functions.append(values)
            r2 = r2_of(contest.shooter.measurements, each.shot, slice(None))[index]
            found.append(Contender(each.programs[index], max(each.nats - best.nats, 0.0), r2))
    return tuple(found[: CONTENDERS + 1])


def _differ(first: FloatArray, second: FloatArray) -> bool:
    with np.errstate(all="ignore"):
        difference = float(np.sqrt(np.mean((first - second) ** 2)))
        return not difference <= SAME * float(np.std(second))


__all__ = ["Errors", "concluded"]
