"""From the chosen system to the reported model: constants with errors, alternatives, verdicts, simulations.

`conclude` works in this order. `final_model.finalize` fixes the equations as they are shown. `estimate_errors` returns
the errors of the constants. `long_run` tests whole trajectories, or the averages of a chaotic model. `prediction`
compares the model with its alternatives from other initial states. `verdict.judge` grades each equation by its
`TrajectoryChecks`. At the end, simulations with bands are added to the result. If groups of trajectories have their own
constants, each step uses one set of constants per group.

Doubtful: all errors and bands are conditional on the structure that was chosen. The selection of the structure from the
same data adds uncertainty, which appears only in the comparison with the alternatives.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from atoll_coordinator.data.recording import Preparation
from atoll_coordinator.model.constants.standard_errors import (
    ConstantErrors,
    EquationConstants,
    describe_constants,
    find_correlations,
    joint_covariance,
    list_fitted_places,
    student_quantile_95,
)
from atoll_coordinator.model.description_length import structure_length
from atoll_coordinator.model.inference.final_model import FinalModel, estimate_errors, finalize
from atoll_coordinator.model.inference.long_run import assess_long_run
from atoll_coordinator.model.inference.prediction import AlternativeSystem, compare_predictions, draw_systems
from atoll_coordinator.model.inference.remarks import warn_of_random_walk
from atoll_coordinator.model.inference.run_values import values_by_run
from atoll_coordinator.model.inference.template_checks import TemplateChecks
from atoll_coordinator.model.inference.trajectory_checks import TrajectoryChecks
from atoll_coordinator.model.inference.trajectory_simulation import (
    compute_r2,
    fit_initial_states,
    list_trajectories,
    rows_by_trajectory,
    simulated_standard_errors,
    simulated_states,
)
from atoll_coordinator.model.inference.verdict import judge
from atoll_coordinator.model.refinement import Alternative, ObservedColumn, Refined, Refinement
from atoll_coordinator.model.regression.errors import measure_grouped_errors
from atoll_coordinator.model.regression.fit import contains
from atoll_coordinator.model.selection.comparison import ModelComparison
from atoll_coordinator.model.selection.piece_lengths import piece_remarks
from atoll_coordinator.model.selection.score import FittedModel
from atoll_coordinator.model.selection.task import SelectedModel
from atoll_coordinator.model.shooting.fit_result import TrajectoryFit
from atoll_coordinator.model.shooting.smoothing_noise import estimate_variances
from atoll_coordinator.model.structure.poles import find_poles
from atoll_coordinator.result.equations import Constant, Prediction
from atoll_coordinator.result.findings import Errors
from atoll_coordinator.result.listed_trajectories import Simulation
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.program import Program, constant_places
from atoll_core.expression.text.infix import to_infix
from atoll_core.expression.writing.expansion import expand_program


def conclude(selection: SelectedModel, preparation: Preparation) -> Refinement | None:
    """Return the refinement for the chosen system; None if it cannot be simulated on all rows."""
    final = finalize(selection)
    if final is None:
        return None
    task, system = final.task, final.free.fit.system
    errors = estimate_errors(final.comparison, final.free)
    of_groups = [errors.for_multiples(columns, system.multiples) for columns in system.columns]
    constants, by_group = _describe_constants(final, of_groups)
    held_out_simulation = None
    if final.held_out_comparison is not None:
        held_out_simulation = _simulate_held_out(final, final.held_out_comparison, errors)
    long_run = assess_long_run(final)
    chaos = long_run.chaos
    predictions = _predict_states(final, errors, is_near=chaos is not None and bool(chaos.is_kept))
    held_out_r2 = _held_out_r2(final, None if held_out_simulation is None else held_out_simulation[0])
    measurements = final.shown_comparison.estimator.measurements
    if measurements.rows > final.comparison.estimator.measurements.rows:
        spread = _errors_along_trajectories(final, final.shown_comparison, final.shown_fit, errors)
    else:
        spread = simulated_standard_errors(measurements, final.free.fit, errors.finite_covariance, errors.scale)
    observations = _describe_observations(final, of_groups[0])
    simulations = (final.shown_fit, spread), held_out_simulation or (None, None)
    runs = values_by_run(task.config.prior.by_run, simulations, errors.degrees_of_freedom)
    compared: list[TrajectoryChecks] = []
    for index, prediction in enumerate(predictions):
        r2 = held_out_r2[final.columns[index]]
        equation = replace(
            _describe_equation(final, index, constants[index], by_group[index], r2, prediction),
            runs=runs.get(task.variables[index], ()),
        )
        given = final, long_run, index, equation, r2, compared
        is_plain = not final.comparison.template.sides and not task.recording.hidden
        compared.append(
            TrajectoryChecks(*given) if is_plain else TemplateChecks(*given, spread, [*observations.values()])
        )
    equations = {one.name: replace(one.shown, prediction=one.prediction, **vars(judge(one))) for one in compared}
    recording, quantile = preparation.recording, student_quantile_95(errors.degrees_of_freedom)
    assert recording is not None
    trajectories = list_trajectories(measurements, final.shown_fit, spread, task.shown_names, preparation, quantile)
    if held_out_simulation is not None and final.held_out_comparison is not None:
        trajectories += list_trajectories(
            final.held_out_comparison.estimator.measurements,
            *held_out_simulation,
            task.shown_names,
            preparation,
            quantile,
        )
    values, _ = simulated_states(measurements, final.shown_fit, task.shown_names)
    simulated = [values[: len(measurements.observed), rows] for _, rows in rows_by_trajectory(measurements)]
    observed = task.recording.observed
    explicit = (*final.explicit, *final.explicit_observations)
    places = list_fitted_places(final.comparison.held, (*task.variables, *observed), explicit)
    covariances = [joint_covariance(places, one.covariance, one.degrees_of_freedom) for one in of_groups]
    return Refinement(
        equations,
        Simulation(trajectories=tuple(trajectories)),
        () if final.by_group else find_correlations(places, of_groups[0]),
        _estimate_state_errors(final),
        (
            *piece_remarks(task, is_tested_in_whole=long_run.fits is True),
            *_warn_of_poles(final),
            *_explain_coordinates(final),
            *warn_of_random_walk(recording, task.shown_names[: len(measurements.observed)], simulated),
        ),
        chaos,
        fluxes=final.fluxes,
        observations=observations,
        covariance=covariances[0] if (system.columns == system.columns[0]).all() else None,
        by_group=dict(zip(task.recording.groups, covariances, strict=False)),
    )


def _explain_coordinates(final: FinalModel) -> tuple[str, ...]:
    """Return a sentence on what hidden states without given equations mean; nothing if there are none."""
    hidden = final.task.recording.hidden
    if not hidden or final.comparison.template.sides:
        return ()
    names, one = " and ".join(hidden), len(hidden) == 1
    return (
        f"No column measures {names}. {'It is' if one else 'They are'} determined only up to a change of coordinates: "
        f"any invertible function of {names} would describe the columns as well, with other equations. Scale and "
        "origin here are those of the shortest equations.",
    )  # fmt: skip


def _held_out_r2(final: FinalModel, held_out_fit: TrajectoryFit | None) -> Sequence[float | None]:
    """Return the R2 (O,) of held-out trajectories, or of trajectories left out one at a time; None: there are none."""
    comparison = final.held_out_comparison
    columns = len(final.comparison.estimator.measurements.observed)
    if comparison is None:
        return final.ranking.validated or (None,) * columns
    if held_out_fit is None:
        return (-math.inf,) * columns
    return compute_r2(comparison.estimator.measurements, held_out_fit, slice(None))


def _describe_constants(
    final: FinalModel, of_groups: Sequence[ConstantErrors]
) -> tuple[Sequence[EquationConstants], Sequence[Sequence[tuple[Constant, ...]]]]:
    """Return the estimates of the constants of each equation, and of each group if groups have their own.

    In the estimates for all groups together, shared constants have standard errors; other constants are means over the
    groups and have no standard errors.
    """
    fixed, columns = final.comparison.held, final.free.fit.system.columns
    described = [  # constants of observations are last
        describe_constants(fixed, final.explicit, programs, errors)
        for programs, errors in zip(final.by_group or [final.programs], of_groups, strict=True)
    ]
    if not final.by_group:
        pairs = zip(described[0], final.rounded.simple, strict=True)
        return [known.with_simple_numbers(simple) for known, simple in pairs], [[] for _ in final.programs]
    are_shared = iter((columns == columns[0]).all(axis=0).tolist())
    together, by_group = list[EquationConstants](), list[list[tuple[Constant, ...]]]()
    for equation, program in enumerate(final.programs):
        groups = [known[equation].written for known in described]
        if equation in fixed:
            together.append(EquationConstants(groups[0]))
            by_group.append([])
            continue
        flags = [next(are_shared) for _ in groups[0]]
        groups = [tuple(one.replaced(shared=flag) for one, flag in zip(group, flags, strict=True)) for group in groups]
        values = program.constants[constant_places(program)].tolist()
        written = [_combine_groups(value, constants) for value, *constants in zip(values, *groups, strict=True)]
        together.append(EquationConstants(tuple(written)))
        by_group.append(groups)
    return together, by_group


def _describe_observations(final: FinalModel, errors: ConstantErrors) -> dict[str, ObservedColumn]:
    """Return the measured columns that are computed from states, with their constants."""
    observed, count = final.task.recording.observed, len(final.programs)
    described = describe_constants(
        final.comparison.held, (*final.explicit, *final.explicit_observations), (*final.programs, *final.observations),
        errors,
    )  # fmt: skip
    return {
        name: ObservedColumn(program, known.written, tuple(names))
        for name, program, known, names in zip(
            observed, final.observations, described[count:], final.names[count:], strict=True
        )
    }


def _combine_groups(value: float, constants: Sequence[Constant]) -> Constant:
    """Return a constant for all groups together: the shared constant, or else the mean over the groups, without a
    standard error."""
    if constants[0].shared:
        return constants[0]
    fitted = float(np.mean([constant.fitted or 0.0 for constant in constants]))
    is_known = all(constant.identifiable for constant in constants)
    return Constant(value=value, fitted=fitted, identifiable=is_known, shared=False)


def _describe_equation(
    final: FinalModel, index: int, known: EquationConstants, by_group: Sequence[tuple[Constant, ...]],
    held_out_r2: float | None, prediction: Prediction,
) -> Refined:  # fmt: skip
    """Return one equation as it is shown, with its alternatives."""
    task, ranking = final.task, final.ranking
    name, program = task.variables[index], final.programs[index]
    programs = [group_programs[index] for group_programs in final.by_group]
    problem = task.dataset.problem(name)
    error, mse = measure_grouped_errors(problem, programs or [final.searched[index]], task.config.evolution.loss)
    together = final.rounded.together
    return Refined(
        task.candidates[name].member_of(final.searched[index]),
        program,
        error,
        mse,
        known.written,
        known.unit_coefficients,
        _describe_alternatives(final, index, held_out_r2),
        origin=final.find_origin(index, ranking.selection.model.programs[index]),
        prediction=prediction,
        by_group=dict(zip(task.recording.groups, zip(programs, by_group, strict=True), strict=True))
        if by_group
        else {},
        simple_together=together[index] if together else None,
        parameters=tuple(final.names[index]) if final.names else (),
        unknowns=final.comparison.template.parts_of(name, final.searched),
    )


def _describe_alternatives(final: FinalModel, index: int, held_out_r2: float | None) -> tuple[Alternative, ...]:
    """Return the equation that is shown and its closest alternatives; all other equations stay the same."""
    ranking = final.ranking
    comparison, best = ranking.selection.comparison, ranking.selection.model
    column = final.columns[index]
    r2 = compute_r2(final.shown_comparison.estimator.measurements, final.shown_fit, slice(None))[column]
    origin = final.find_origin(index, best.programs[index])
    is_crossed = final.held_out_comparison is None and ranking.validated is not None

    def parts(searched: Sequence[Program], values: FloatArray) -> dict[str, Any]:
        """Return the unknown part of the equation, and the values of the template's parameters."""
        template = comparison.template
        if template.unknown_of(final.task.variables[index]) is None:
            return {}
        named = zip(template.parameters, values.tolist(), strict=True)
        return {"unknown": searched[index], "parameters": {one.name: value for one, value in named}}

    shown = parts(final.searched, final.shown_fit.system.parameter_values)
    alternatives = [Alternative(final.programs[index], 0.0, r2, held_out_r2, True, is_crossed, origin, **shown)]
    for alternative in ranking.alternatives[index]:
        model, nats = alternative.model, alternative.model.nats - best.nats
        programs = model.programs
        r2 = compute_r2(comparison.estimator.measurements, alternative.model.fit, slice(None))[column]
        held_out_r2 = None if alternative.validated is None else alternative.validated[column]
        if nats <= SETTINGS.inference.distinct_nats and final.held_out_comparison is not None and not final.by_group:
            parameters = model.fit.system.parameter_values
            fit = fit_initial_states(final.held_out_comparison, programs, parameters=parameters)
            measurements = final.held_out_comparison.estimator.measurements
            held_out_r2 = -math.inf if fit is None else compute_r2(measurements, fit, slice(None))[column]
        is_crossed = alternative.validated is not None
        origin = final.find_origin(index, programs[index])
        equation = comparison.equations_of(model)[index]
        other = parts(programs, model.fit.system.parameter_values)
        alternatives.append(Alternative(equation, nats, r2, held_out_r2, False, is_crossed, origin, **other))
    return tuple(alternatives)


def _simulate_held_out(
    final: FinalModel, held_out: ModelComparison, errors: ConstantErrors
) -> tuple[TrajectoryFit | None, FloatArray | None]:
    """Return the simulation of the held-out trajectories with fitted initial states, and the standard errors of this
    simulation.

    The simulation is None if it failed; there are no standard errors if there are groups.
    """
    fit = final.simulate_along(held_out)
    return fit, None if fit is None or final.by_group else _errors_along_trajectories(final, held_out, fit, errors)


def _errors_along_trajectories(
    final: FinalModel, comparison: ModelComparison, fit: TrajectoryFit, errors: ConstantErrors
) -> FloatArray | None:
    """Return the standard errors (O, N) of simulations along trajectories to which constants were not fitted.

    None if a simulation fails. Trajectories are simulated one after another: with dozens of states, all sensitivities
    together would not fit into memory.
    """
    free, trajectory_bands = final.free.fit, []
    for owner in sorted(set(comparison.estimator.measurements.owners.tolist())):
        estimator, starts = comparison.estimator.estimator_of_trajectory(owner, fit)
        near = estimator.fit(free.system, None, 0, starts, free.errors, is_stiff=fit.is_stiff)
        if near is None:
            return None
        trajectory_bands.append(
            simulated_standard_errors(estimator.measurements, near, errors.finite_covariance, errors.scale)
        )
    return np.concatenate(trajectory_bands, axis=1)


def _predict_states(final: FinalModel, errors: ConstantErrors, *, is_near: bool) -> list[Prediction]:
    """Return how well each state can be predicted from other initial states, see `compare_predictions`.

    The odds that follow from the data alone are divided by the number of alternatives of the same equation
    (Bonferroni): these alternatives were chosen from many equations because they describe the data well.
    """
    ranking = final.ranking
    own = ranking.selection.model
    others = [
        AlternativeSystem(
            alternative.model.fit.system,
            equation,
            _odds(alternative.model.nats - own.nats),
            _odds_without_prices(alternative.model, own, equation, final.visited_points) / len(alternatives),
        )
        for equation, alternatives in enumerate(ranking.alternatives)
        for alternative in alternatives
    ]
    drawn = draw_systems(final.free.fit.system, errors.finite_covariance)
    simulator = final.shown_comparison.estimator
    return compare_predictions(
        simulator.measurements.with_all_states(),
        final.shown_fit.system,
        others,
        simulator.tolerance,
        drawn,
        is_near=is_near,
    )


def _odds(nats: float) -> float:
    """Return the odds of a description that is `nats` longer than the description by the model; at most one."""
    return math.exp(-max(nats, 0.0))


def _odds_without_prices(other: FittedModel, own: FittedModel, equation: int, points: FloatArray) -> float:
    """Return the odds of another model. They follow from its misfit and its number of constants (Schwarz 1978), without
    the price of structures.

    Nested models are an exception: the other equation is equal to the model's equation for some values of the other
    equation's constants. There are many such equations, and each describes the data about as well. So their odds
    include the price of the structure.
    """
    program, contained = other.programs[equation], own.programs[equation]
    expansion = expand_program(program)
    whole = program if expansion is None else expansion.program
    if len(constant_places(whole)) > len(constant_places(contained)) and contains(whole, contained, points):
        return _odds(other.nats - own.nats)
    lengths = [model.nats - math.fsum(map(structure_length, model.programs)) for model in (other, own)]
    return _odds(lengths[0] - lengths[1])


def _estimate_state_errors(final: FinalModel) -> dict[str, Errors]:
    """Return the measurement errors of each state by name, estimated from residuals. The result is empty if there is no
    noise."""
    comparison, fit = final.comparison, final.free.fit
    if comparison.score.is_exact(final.free):
        return {}
    bounds = comparison.estimator.measurements.bounds
    rows = np.minimum(
        comparison.score.misfit.effective_rows(comparison.score.squares(fit)),
        comparison.score.counts / fit.errors.lengths,
    )
    errors_by_state, variances = {}, estimate_variances(final.task.recording)
    for index, name in enumerate(final.task.shown_names[: len(comparison.estimator.measurements.observed)]):
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


def _warn_of_poles(final: FinalModel) -> Iterator[str]:
    """Yield a warning for each pole of an equation within the measured region."""
    dataset = final.task.dataset
    for name, program in zip(final.task.variables, final.programs, strict=True):
        for part in find_poles(program, dataset.inputs):
            where = to_infix(part, dataset.names)
            yield f"The equation of {name} has a pole within the region that was measured, where {where} is 0."
