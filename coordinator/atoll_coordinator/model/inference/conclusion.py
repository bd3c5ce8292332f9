"""From the chosen system to what is reported: constants with errors, contenders, verdicts, simulations."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from atoll.data.dataset import FloatArray
from atoll.expression.program import Program, constant_places, structure
from atoll_coordinator.model.inference.uncertainty import (
    Errors,
    Known,
    bands,
    constants_of,
    correlations_of,
    errors_of,
    held,
    not_simulated,
    r2_of,
    simulated,
    spread_of,
)
from atoll_coordinator.model.inference.verdict import Evidence, judge
from atoll_coordinator.model.refinement import Contender, Origin, Refined, Refinement, Simulated, Simulation
from atoll_coordinator.model.regression.errors import errors_on
from atoll_coordinator.model.selection.alternatives import Race, decided
from atoll_coordinator.model.selection.comparison import Contest, Standing
from atoll_coordinator.model.selection.joint_search import Chosen, Field
from atoll_coordinator.model.selection.piece_lengths import on_all_rows, remarks
from atoll_coordinator.model.selection.rounding import rounded
from atoll_coordinator.model.settings import SETTINGS
from atoll_coordinator.model.shooting.measurements import Measurements
from atoll_coordinator.model.shooting.multiple_shooting import Shot
from atoll_coordinator.model.structure.algebra import tidied
from atoll_coordinator.model.structure.like_terms import gathered
from atoll_coordinator.model.structure.unit_coefficients import Opened, as_it_is, opened


@dataclass(frozen=True, eq=False)
class _Final:
    """The model on all rows: `shown` programs, their fit with all constants free, and as they are shown.

    `unseen` is a contest over the held-out trajectories, None when there are none.
    """

    field: Field
    race: Race
    origins: Sequence[Mapping[bytes, Origin]]
    unseen: Contest | None
    contest: Contest
    shown: tuple[Program, ...]
    openings: tuple[Opened, ...]
    free: Standing
    held: Standing

    def origin(self, equation: int, program: Program) -> Origin:
        """Return where a program came from, before its constants were made simple."""
        if self.field.variables[equation] in self.field.known:
            return "known"
        return self.origins[equation].get(structure(tidied(program)), "descent")


@dataclass(frozen=True, eq=False)
class _HeldOut:
    """The simulations of trajectories that took no part, and their R2 by variable."""

    trajectories: tuple[Simulated, ...]
    r2: tuple[float | None, ...]


def concluded(choice: Chosen) -> Refinement | None:
    """Return the refinement that the chosen system gives; None when it cannot be simulated on all rows."""
    candidates = choice.field.candidates.values()
    origins = tuple(each.origins(compared) for each, compared in zip(candidates, choice.lists, strict=True))
    final = _finalized(decided(choice, choice.field.dataset.inputs), origins)
    if final is None:
        return None
    field = final.field
    errors = errors_of(final.contest, final.free)
    constants = constants_of(final.contest, final.openings, final.shown, errors)
    out = None if final.unseen is None else _held_out(final, final.unseen, final.shown, errors)
    equations = {
        name: _refined(final, index, constants[index], _foretold(final, out, index))
        for index, name in enumerate(field.variables)
    }
    its = final.contest.shooter.measurements
    spread = bands(its, final.free.shot, *spread_of(final.contest, final.free.shot, errors))
    trajectories = simulated(its, final.held.shot, spread, field.variables, held_out=False)
    return Refinement(
        equations,
        Simulation(field.variables, (*trajectories, *(out.trajectories if out is not None else ()))),
        correlations_of(final.contest, field.variables, final.openings, errors),
        tuple(remarks(field)),
    )


def _finalized(race: Race, origins: Sequence[Mapping[bytes, Origin]]) -> _Final | None:
    """Fit the chosen system to all rows, make its constants simple, and fit what is shown again."""
    whole = on_all_rows(race.choice)
    if whole is None:
        return None
    contest, best = whole.contest, whole.standing
    for programs in (rounded(contest, best), best.programs):  # as fitted, where simple constants cannot be simulated
        shown = tuple(_tidy(whole.field, contest, equation, program) for equation, program in enumerate(programs))
        openings, free = _freed(contest, best, shown)
        shot = held(contest, shown, best.shot)
        if free is not None and shot is not None:
            final = contest.measured(shown, shot)
            return _Final(whole.field, race, origins, _unseen(whole.field), contest, shown, openings, free, final)
    return None


def _tidy(field: Field, contest: Contest, equation: int, program: Program) -> Program:
    """Return a program with like terms gathered, unless it is given or would be larger than is allowed."""
    made = program if equation in contest.fixed else gathered(program)
    return made if field.may_be_shown(made) else program


def _freed(contest: Contest, best: Standing, shown: Sequence[Program]) -> tuple[tuple[Opened, ...], Standing | None]:
    """Fit what is shown with all its constants free, factors of one that are not written among them if that can be."""
    openings = tuple(
        as_it_is(program) if equation in contest.fixed else opened(program) for equation, program in enumerate(shown)
    )
    free = contest.beside(best, [each.program for each in openings], SETTINGS.inference.shown_steps)
    if free is not None:
        return openings, free
    return tuple(map(as_it_is, shown)), contest.beside(best, shown, SETTINGS.inference.shown_steps)


def _unseen(field: Field) -> Contest | None:
    """Return a contest over the held-out trajectories; None when there are none."""
    if not any(each.held_out for each in field.recording.trajectories):
        return None
    return field.contest(field.measurements(field.variables, held_out=True), field.variables)


def _held_out(final: _Final, unseen: Contest, programs: Sequence[Program], errors: Errors | None = None) -> _HeldOut:
    """Simulate the held-out trajectories from initial states that are fitted to them.

    With the `errors` of the constants there are bands; these programs are the ones shown, then.
    """
    its = unseen.shooter.measurements
    shot = held(unseen, programs)
    if shot is None:
        return _HeldOut(tuple(not_simulated(its, held_out=True)), tuple(-np.inf for _ in its.observed))
    spread = None if errors is None else _carried_bands(final, unseen, shot, errors)
    return _HeldOut(
        tuple(simulated(its, shot, spread, final.field.variables, held_out=True)), tuple(r2_of(its, shot, slice(None)))
    )


def _carried_bands(final: _Final, unseen: Contest, shot: Shot, errors: Errors) -> FloatArray | None:
    """Return the standard errors (O, N) of held-out trajectories as simulated; None when they cannot be told."""
    system = unseen.system([each.program for each in final.openings])
    free = final.free.shot
    near = unseen.shooter.fit(system, None, 0, shot.starts, free.sigmas, is_stiff=shot.is_stiff)
    return None if near is None else bands(unseen.shooter.measurements, near, *spread_of(final.contest, free, errors))


def _refined(final: _Final, index: int, known: Known, held_out_r2: float | None) -> Refined:
    field = final.field
    name, program = field.variables[index], final.shown[index]
    problem = field.dataset.problem(name)
    error, mse = errors_on(problem, program, field.config.evolution.loss)
    contenders = _contenders(final, index, held_out_r2)
    rivals = _no_elaborations(final.race.choice.standing.programs[index], contenders)
    variance = problem.target.standard_deviation**2
    smoothing = field.recording.smoothing[field.recording.states.index(name)]
    its = final.contest.shooter.measurements
    evidence = Evidence(
        error=error / problem.target.standard_deviation,
        target_uncertainty=problem.target.uncertainty,
        convergence_threshold=problem.target.convergence_threshold(),
        target_r2=1.0 - mse / variance if variance else None,
        residuals=_residuals(its, final.held.shot, index),
        parameters=(len(final.free.shot.system.places) + final.free.shot.starts.size) / len(its.observed),
        noise=0.0 if smoothing.method == "interpolation" else smoothing.noise,
        deviation=_deviation(its, index),
        has_outliers=smoothing.outliers > 0,
        held_out_r2=held_out_r2,
        is_cross_validated=final.unseen is None,
        constants=known.written,
        rival=min((each.nats for each in rivals), default=None),
    )
    grade, reason = judge(evidence)
    member = field.candidates[name].member_of(program)
    origin = final.origin(index, final.race.choice.standing.programs[index])
    return Refined(member, program, error, mse, known.written, known.implied, contenders, grade, reason, origin)


def _no_elaborations(program: Program, contenders: Sequence[Contender]) -> list[Contender]:
    """Return the others that have no more constants than `program`, as it was before its constants were made simple.

    More constants always describe about as well; that is no reason to doubt the equation with fewer.
    """
    most = len(constant_places(program))
    return [each for each in contenders if not each.is_shown and len(constant_places(each.program)) <= most]


def _residuals(its: Measurements, shot: Shot, index: int) -> list[FloatArray]:
    """Return what is left of a state along each piece, where it was measured and counts, as in a row of weight 1."""
    pieces = [slice(first, end) for first, end in its.bounds.tolist()]
    residuals = shot.residuals[index] if its.precision is None else shot.residuals[index] * np.sqrt(its.precision)
    parts = [residuals[rows][its.weights[index, rows] > 0.0] for rows in pieces]
    return [part for part in parts if len(part)]


def _deviation(its: Measurements, index: int) -> float:
    """Return the standard deviation of what was measured of a state, where it counts."""
    values = its.measured[index][its.weights[index] > 0.0]
    return max(float(values.std()), 1e-300) if len(values) else 1e-300


def _foretold(final: _Final, out: _HeldOut | None, index: int) -> float | None:
    """Return R2 of a state along trajectories that were held out, or else left out one at a time, if any were."""
    its = out if out is not None else final.race.validated
    return None if its is None else its.r2[index]


def _contenders(final: _Final, index: int, held_out_r2: float | None) -> tuple[Contender, ...]:
    """Return the equation that is shown and what came closest to it, all other equations as they are."""
    race = final.race
    contest, best = race.choice.contest, race.choice.standing
    r2 = r2_of(final.contest.shooter.measurements, final.held.shot, slice(None))[index]
    origin = final.origin(index, best.programs[index])
    is_crossed = final.unseen is None and race.validated is not None
    found = [Contender(final.shown[index], 0.0, r2, held_out_r2, True, is_crossed, origin)]
    for rival in race.rivals[index]:
        program, nats = rival.standing.programs[index], rival.standing.nats - best.nats
        r2 = r2_of(contest.shooter.measurements, rival.standing.shot, slice(None))[index]
        held_out_r2 = None if rival.validated is None else rival.validated.r2[index]
        if nats <= SETTINGS.selection.validated_nats and final.unseen is not None:
            held_out_r2 = _held_out(final, final.unseen, rival.standing.programs).r2[index]
        is_crossed = rival.validated is not None
        found.append(Contender(program, nats, r2, held_out_r2, False, is_crossed, final.origin(index, program)))
    return tuple(found)
