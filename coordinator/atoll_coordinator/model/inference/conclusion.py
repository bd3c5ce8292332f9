"""From the chosen system to the reported model: constants with errors, alternatives, verdicts, simulations.

`final_model` decides how the equations are shown; here they are simulated, compared with their alternatives, and judged
(`trajectory_checks`, `verdict`). Constants of groups of trajectories are another set of numbers of the same model.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from atoll_coordinator.data.recording import Preparation
from atoll_coordinator.model.constants.standard_errors import (
    ConstantErrors,
    Known,
    describe_constants,
    find_correlations,
    fitted_places,
    joint_covariance,
    student_95,
)
from atoll_coordinator.model.description_length import structure_length
from atoll_coordinator.model.inference.final_model import FinalModel, estimate_errors, finalize
from atoll_coordinator.model.inference.long_run import long_run_of
from atoll_coordinator.model.inference.prediction import AlternativeSystem, draws, predict
from atoll_coordinator.model.inference.remarks import stochastic_remarks
from atoll_coordinator.model.inference.trajectory_checks import TrajectoryChecks
from atoll_coordinator.model.inference.trajectory_simulation import (
    bands,
    fit_starts,
    listed_trajectories,
    r2_of,
    rows_by_trajectory,
    simulated_states,
)
from atoll_coordinator.model.inference.verdict import judge
from atoll_coordinator.model.refinement import Alternative, Refined, Refinement
from atoll_coordinator.model.regression.errors import grouped_errors_on
from atoll_coordinator.model.regression.fit import contains
from atoll_coordinator.model.selection.comparison import ModelComparison
from atoll_coordinator.model.selection.piece_lengths import piece_remarks
from atoll_coordinator.model.selection.score import FittedModel
from atoll_coordinator.model.selection.task import SelectedModel
from atoll_coordinator.model.shooting.smoothing_noise import estimate_variances
from atoll_coordinator.model.shooting.trajectory_fit import TrajectoryFit
from atoll_coordinator.model.structure.poles import find_poles
from atoll_coordinator.result.equations import Constant, Prediction
from atoll_coordinator.result.findings import Errors
from atoll_coordinator.result.listed_trajectories import Simulation
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.program import constant_places
from atoll_core.expression.text.infix import to_infix
from atoll_core.expression.writing.expansion import expand_program


def conclude(selection: SelectedModel, preparation: Preparation) -> Refinement | None:
    """Return the refinement that the chosen system gives; None when it cannot be simulated on all rows."""
    final = finalize(selection)
    if final is None:
        return None
    task, system = final.task, final.free.fit.system
    errors = estimate_errors(final.comparison, final.free)
    of_groups = [errors.of_multiples(columns, system.multiples) for columns in system.columns]
    constants, by_group = _constants(final, of_groups)
    out = None if final.unseen is None else _held_out(final, final.unseen, errors)
    long_run = long_run_of(final)
    chaos = long_run.chaos
    predictions = _predictions(final, errors, is_near=chaos is not None and bool(chaos.is_kept))
    held_out_r2: Sequence[float | None] = final.ranking.validated or (None,) * len(task.variables)
    if out is not None and final.unseen is not None:
        unseen = final.unseen.estimator.measurements
        held_out_r2 = [-math.inf for _ in held_out_r2] if out[0] is None else r2_of(unseen, out[0], slice(None))
    compared: list[TrajectoryChecks] = []
    for index, prediction in enumerate(predictions):
        equation = _equation(final, index, constants[index], by_group[index], held_out_r2[index], prediction)
        compared.append(TrajectoryChecks(final, long_run, index, equation, held_out_r2[index], compared))
    equations = {one.name: replace(one.shown, prediction=one.prediction, **vars(judge(one))) for one in compared}
    measurements = final.seen.estimator.measurements
    if measurements.rows > final.comparison.estimator.measurements.rows:
        spread = _carried_bands(final, final.seen, final.seen_fit, errors)
    else:
        spread = bands(measurements, final.free.fit, errors.bounded, errors.scale)
    recording, quantile = preparation.recording, student_95(errors.degrees_of_freedom)
    assert recording is not None
    trajectories = listed_trajectories(measurements, final.seen_fit, spread, task.variables, preparation, quantile)
    if out is not None and final.unseen is not None:
        trajectories += listed_trajectories(
            final.unseen.estimator.measurements, *out, task.variables, preparation, quantile
        )
    values, _ = simulated_states(measurements, final.seen_fit, task.variables)
    simulated = [values[:, rows] for _, rows in rows_by_trajectory(measurements)]
    places = fitted_places(final.comparison.fixed, task.variables, final.explicit)
    covariances = [joint_covariance(places, one.covariance, one.degrees_of_freedom) for one in of_groups]
    return Refinement(
        equations,
        Simulation(trajectories=tuple(trajectories)),
        () if final.by_group else find_correlations(places, of_groups[0]),
        _state_errors(final),
        (
            *piece_remarks(task, is_tested_in_whole=long_run.fits is True),
            *_pole_remarks(final),
            *stochastic_remarks(recording, task.variables, simulated),
        ),
        chaos,
        fluxes=final.fluxes,
        covariance=covariances[0] if (system.columns == system.columns[0]).all() else None,
        by_group=dict(zip(task.recording.groups, covariances, strict=False)),
    )


def _constants(
    final: FinalModel, of_groups: Sequence[ConstantErrors]
) -> tuple[Sequence[Known], Sequence[Sequence[tuple[Constant, ...]]]]:
    """Return the estimates of the constants of each equation, and of each group if groups have their own.

    All groups together have the constants that they share with their errors, and the means of the others without.
    """
    fixed, columns = final.comparison.fixed, final.free.fit.system.columns
    described = [
        describe_constants(fixed, final.explicit, programs, errors)
        for programs, errors in zip(final.by_group or [final.programs], of_groups, strict=True)
    ]
    if not final.by_group:
        pairs = zip(described[0], final.rounded.simple, strict=True)
        return [known.with_simple(simple) for known, simple in pairs], [[] for _ in final.programs]
    are_shared = iter((columns == columns[0]).all(axis=0).tolist())
    together, by_group = list[Known](), list[list[tuple[Constant, ...]]]()
    for equation, program in enumerate(final.programs):
        groups = [known[equation].written for known in described]
        if equation in fixed:
            together.append(Known(groups[0]))
            by_group.append([])
            continue
        flags = [next(are_shared) for _ in groups[0]]
        groups = [tuple(one.replaced(shared=flag) for one, flag in zip(group, flags, strict=True)) for group in groups]
        values = program.constants[constant_places(program)].tolist()
        written = [_together(value, constants) for value, *constants in zip(values, *groups, strict=True)]
        together.append(Known(tuple(written)))
        by_group.append(groups)
    return together, by_group


def _together(value: float, constants: Sequence[Constant]) -> Constant:
    """Return a constant of all groups together: the shared one, or the mean of those of the groups without errors."""
    if constants[0].shared:
        return constants[0]
    fitted = float(np.mean([constant.fitted or 0.0 for constant in constants]))
    is_known = all(constant.identifiable for constant in constants)
    return Constant(value=value, fitted=fitted, identifiable=is_known, shared=False)


def _equation(
    final: FinalModel, index: int, known: Known, by_group: Sequence[tuple[Constant, ...]],
    held_out_r2: float | None, prediction: Prediction,
) -> Refined:  # fmt: skip
    """Return one equation as it is shown, compared with its alternatives."""
    task, ranking = final.task, final.ranking
    name, program = task.variables[index], final.programs[index]
    programs = [group_programs[index] for group_programs in final.by_group]
    problem = task.dataset.problem(name)
    error, mse = grouped_errors_on(problem, programs or [program], task.config.evolution.loss)
    together = final.rounded.together
    return Refined(
        task.candidates[name].member_of(program),
        program,
        error,
        mse,
        known.written,
        known.unit_coefficients,
        _alternatives(final, index, held_out_r2),
        origin=final.origin(index, ranking.selection.model.programs[index]),
        prediction=prediction,
        by_group=dict(zip(task.recording.groups, zip(programs, by_group, strict=True), strict=True))
        if by_group
        else {},
        simple_together=together[index] if together else None,
    )


def _alternatives(final: FinalModel, index: int, held_out_r2: float | None) -> tuple[Alternative, ...]:
    """Return the equation that is shown and its closest alternatives, all other equations as they are."""
    ranking = final.ranking
    comparison, best = ranking.selection.comparison, ranking.selection.model
    r2 = r2_of(final.seen.estimator.measurements, final.seen_fit, slice(None))[index]
    origin = final.origin(index, best.programs[index])
    is_crossed = final.unseen is None and ranking.validated is not None
    alternatives = [Alternative(final.programs[index], 0.0, r2, held_out_r2, True, is_crossed, origin)]
    for alternative in ranking.alternatives[index]:
        programs, nats = alternative.model.programs, alternative.model.nats - best.nats
        r2 = r2_of(comparison.estimator.measurements, alternative.model.fit, slice(None))[index]
        held_out_r2 = None if alternative.validated is None else alternative.validated[index]
        if nats <= SETTINGS.inference.distinct_nats and final.unseen is not None and not final.by_group:
            fit = fit_starts(final.unseen, programs)
            measurements = final.unseen.estimator.measurements
            held_out_r2 = -math.inf if fit is None else r2_of(measurements, fit, slice(None))[index]
        is_crossed = alternative.validated is not None
        origin = final.origin(index, programs[index])
        alternatives.append(Alternative(programs[index], nats, r2, held_out_r2, False, is_crossed, origin))
    return tuple(alternatives)


def _held_out(
    final: FinalModel, unseen: ModelComparison, errors: ConstantErrors
) -> tuple[TrajectoryFit | None, FloatArray | None]:
    """Return the simulation of the held-out trajectories from initial states that are fitted to them, and its bands.

    None if it failed; without bands if there are groups.
    """
    fit = final.simulated_by(unseen)
    return fit, None if fit is None or final.by_group else _carried_bands(final, unseen, fit, errors)


def _carried_bands(
    final: FinalModel, comparison: ModelComparison, fit: TrajectoryFit, errors: ConstantErrors
) -> FloatArray | None:
    """Return the standard errors (O, N) of trajectories that constants were not fitted to; None when they fail.

    One trajectory after another: with dozens of states, all sensitivities together would not fit into memory.
    """
    free, trajectory_bands = final.free.fit, []
    for owner in sorted(set(comparison.estimator.measurements.owners.tolist())):
        estimator, starts = comparison.estimator.estimator_of_trajectory(owner, fit)
        near = estimator.fit(free.system, None, 0, starts, free.errors, is_stiff=fit.is_stiff)
        if near is None:
            return None
        trajectory_bands.append(bands(estimator.measurements, near, errors.bounded, errors.scale))
    return np.concatenate(trajectory_bands, axis=1)


def _predictions(final: FinalModel, errors: ConstantErrors, *, is_near: bool) -> list[Prediction]:
    """Return how far each state can be predicted from other initial states, see `predict`.

    The odds that the data alone give an alternative are shared by all alternatives of its equation: these were chosen
    from many because they describe the data well (Bonferroni).
    """
    ranking = final.ranking
    own = ranking.selection.model
    others = [
        AlternativeSystem(
            alternative.model.fit.system,
            equation,
            _odds(alternative.model.nats - own.nats),
            _odds_of_data(alternative.model, own, equation, final.visited) / len(alternatives),
        )
        for equation, alternatives in enumerate(ranking.alternatives)
        for alternative in alternatives
    ]
    drawn = draws(final.free.fit.system, errors.bounded)
    seen = final.seen.estimator
    return predict(seen.measurements, final.seen_fit.system, others, seen.tolerance, drawn, is_near=is_near)


def _odds(nats: float) -> float:
    """Return the odds of a description that is longer by this many nats, at most one."""
    return math.exp(-max(nats, 0.0))


def _odds_of_data(other: FittedModel, own: FittedModel, equation: int, points: FloatArray) -> float:
    """Return the odds of another model by misfit and constants (Schwarz 1978), without the prices of structures.

    An elaboration, whose equation as a sum is the model's own with some values of its constants, has no other odds than
    with it: there are many of them, each of which describes about as much.
    """
    program, contained = other.programs[equation], own.programs[equation]
    expansion = expand_program(program)
    whole = program if expansion is None else expansion.program
    if len(constant_places(whole)) > len(constant_places(contained)) and contains(whole, contained, points):
        return _odds(other.nats - own.nats)
    lengths = [model.nats - math.fsum(map(structure_length, model.programs)) for model in (other, own)]
    return _odds(lengths[0] - lengths[1])


def _state_errors(final: FinalModel) -> dict[str, Errors]:
    """Return the errors of each state as estimated from residuals, by name; empty without noise."""
    comparison, fit = final.comparison, final.free.fit
    if comparison.score.is_exact(final.free):
        return {}
    bounds = comparison.estimator.measurements.bounds
    rows = np.minimum(
        comparison.score.misfit.effective_rows(comparison.score.squares(fit)),
        comparison.score.counts / fit.errors.lengths,
    )
    errors_by_state, variances = {}, estimate_variances(final.task.recording)
    for index, name in enumerate(final.task.variables):
        share, decay = float(fit.errors.shares[index]), float(fit.errors.decays[index])
        errors_by_state[name] = Errors(
            sd=float(np.sqrt(fit.squares[index])),
            proportional=variances[final.task.recording.states.index(name)].proportional,
            correlated=share,
            correlation_rows=1.0 / (1.0 - decay) if share else None,
            independent_rows=float(rows[index]),
            add_up=final.are_errors_summed,
            piece=int((bounds[:, 1] - bounds[:, 0]).max()) if final.are_errors_summed else None,
        )
    return errors_by_state


def _pole_remarks(final: FinalModel) -> Iterator[str]:
    """Yield a sentence for each pole of an equation in the region that the data visit."""
    dataset = final.task.dataset
    for name, program in zip(final.task.variables, final.programs, strict=True):
        for part in find_poles(program, dataset.inputs):
            where = to_infix(part, dataset.names)
            yield f"The equation of {name} has a pole within the region that was measured, where {where} is 0."
