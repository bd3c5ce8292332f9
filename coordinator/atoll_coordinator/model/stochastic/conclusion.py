"""From the chosen law of a process to the reported model: constants with errors, alternatives, verdicts, ensembles.

`show_process` fixes the equations as they are shown. A constant is replaced by a simple number if the steps support
this number. A factor of one is written as a constant if the steps refute the value one. `summarize_process` then lists
alternatives, grades each equation (`checks`), and simulates ensembles of paths.

Doubtful: errors of the constants come from Fisher's information and are conditional on the chosen structure.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from atoll_coordinator.data.increments import take_steps
from atoll_coordinator.model.constants.rounding import Estimates, FittedEquations, RoundedEquations
from atoll_coordinator.model.constants.standard_errors import (
    ConstantErrors,
    EquationConstants,
    describe_constants,
    joint_covariance,
    list_fitted_places,
    make_explicit_if_free,
    write_refuted_factors,
)
from atoll_coordinator.model.inference.verdict import judge
from atoll_coordinator.model.pools import Origin
from atoll_coordinator.model.refinement import Alternative, Refined, Refinement
from atoll_coordinator.model.regression.errors import measure_errors
from atoll_coordinator.model.selection.candidates import CandidateSet, form_key
from atoll_coordinator.model.stochastic.checks import ProcessChecks, ProcessSteps
from atoll_coordinator.model.stochastic.likelihood import FittedProcess, ProcessLikelihood, ProcessModel
from atoll_coordinator.model.stochastic.path_ensembles import simulate_ensemble, simulate_stationary_density
from atoll_coordinator.model.stochastic.process_choice import ChosenProcess
from atoll_coordinator.process_steps.paths import Simulator
from atoll_coordinator.result.findings import Covariance, MeasurementNoise, Process
from atoll_core.config import JobConfig
from atoll_core.data.dataset import Dataset
from atoll_core.expression.program import Program, constant_places
from atoll_core.expression.unit_coefficients import ExplicitCoefficients, make_coefficients_explicit


@dataclass(frozen=True, eq=False)
class ShownProcess:
    """The equations of a process as they are shown, with the estimates of their constants (`known`).

    `fitted` is the fit of `explicit` with all constants free, and `errors` are the errors of its parameters: constants
    first, then the logarithms of the standard deviations of the measurement noise.
    """

    rounded: RoundedEquations
    known: Sequence[EquationConstants]
    explicit: Sequence[ExplicitCoefficients]
    fitted: FittedProcess
    errors: ConstantErrors

    @property
    def model(self) -> ProcessModel:
        """The process as it is shown."""
        return self.fitted.model.with_programs(self.rounded.programs)


def summarize_process(
    chosen: ChosenProcess, dataset: Dataset, config: JobConfig, candidates: Mapping[str, CandidateSet]
) -> Refinement:
    """Return the refinement for the chosen law."""
    shown = show_process(chosen)
    steps, refined = ProcessSteps(chosen, shown.fitted.model), {}
    for number in chosen.searched:
        name, program, known = chosen.variables[number], shown.rounded.programs[number], shown.known[number]
        candidate_set, problem = candidates.get(name, CandidateSet()), dataset.problem(name)
        equation = Refined(
            None,
            program,
            *measure_errors(problem, program, config.evolution.loss),
            known.written,
            known.unit_coefficients,
            _describe_alternatives(chosen, number, program, candidate_set),
            origin=_find_origin(program, candidate_set),
            simple_together=shown.rounded.together[number],
        )
        refined[name] = replace(equation, **vars(judge(ProcessChecks(equation, problem.target, steps, number))))
    places = list_fitted_places(_fixed_equations(chosen), chosen.variables, shown.explicit)
    freedom, matrix = shown.errors.degrees_of_freedom, shown.errors.covariance[: len(places), : len(places)]
    covariance = joint_covariance(places, matrix, freedom) or Covariance(constants=(), matrix=(), freedom=freedom)
    return Refinement(refined, process=_describe_process(chosen, shown, config.seed), covariance=covariance)


def show_process(chosen: ChosenProcess) -> ShownProcess:
    """Return the equations as they are shown: constants become simple numbers if the steps support them, or are
    rounded.

    Factors of one are written as constants if their 95 % intervals do not contain one.
    """
    likelihood, given = chosen.likelihood, _fixed_equations(chosen)

    def misfit_increase(programs: Sequence[Program]) -> float:
        return likelihood.whiten(chosen.fitted.model.with_programs(programs)).misfit - chosen.fitted.misfit

    programs: Sequence[Program] = _attach_estimates(chosen, chosen.fitted).accept_simple_numbers(misfit_increase)
    for _ in range(2):
        explicit = [
            make_explicit_if_free(program, restrictions, is_given=number in given)
            for number, (program, restrictions) in enumerate(zip(programs, chosen.restrictions, strict=True))
        ]
        fitted = likelihood.fit(chosen.fitted.model.with_programs([one.program for one in explicit]), chosen.free)
        errors = likelihood.estimate_errors(fitted, chosen.free)
        known = describe_constants(given, explicit, programs, errors)
        written = write_refuted_factors(explicit, fitted.model.programs, programs, known)
        if written == [*programs]:
            break
        programs = written
    as_shown = likelihood.fit(chosen.fitted.model.with_programs(programs), chosen.free)
    rounded = _attach_estimates(chosen, as_shown).round_equations()
    known = describe_constants(given, explicit, rounded.programs, errors)
    known = [one.with_simple_numbers(simple) for one, simple in zip(known, rounded.simple, strict=True)]
    return ShownProcess(rounded, known, explicit, fitted, errors)


def _fixed_equations(chosen: ChosenProcess) -> list[int]:
    """Return the indices of the equations whose constants are not fitted."""
    return [number for number in range(len(chosen.variables)) if number not in chosen.free]


def _attach_estimates(chosen: ChosenProcess, fitted: FittedProcess) -> FittedEquations:
    """Return the equations of a fit with the estimates of their constants, ready for rounding."""
    errors, given = chosen.likelihood.estimate_errors(fitted, chosen.free), _fixed_equations(chosen)
    count = sum(len(constant_places(fitted.model.programs[number])) for number in chosen.free)
    estimates = Estimates(errors.values[:count], errors.finite_covariance[:count, :count])
    return FittedEquations(fitted.model.programs, estimates, chosen.restrictions, given)


def _describe_alternatives(
    chosen: ChosenProcess, number: int, program: Program, candidates: CandidateSet
) -> tuple[Alternative, ...]:
    alternatives = [alternative for alternative in chosen.alternatives[number] if math.isfinite(alternative.length)]
    best = alternatives[0].length if alternatives else 0.0
    first = Alternative(program, 0.0, None, is_shown=True, origin=_find_origin(program, candidates))
    rest = [
        Alternative(
            alternative.program, alternative.length - best, None, origin=_find_origin(alternative.program, candidates)
        )
        for alternative in alternatives[1:]
    ]
    return (first, *rest)


def _find_origin(program: Program, candidates: CandidateSet) -> Origin:
    """Return the origin of an equation: the kind of candidates with the same form. Constants and factors of one do not
    matter for the form."""
    sources: dict[Origin, Sequence[Program]] = {
        "front": [member.program for member in candidates.front],
        "runner-up": candidates.runners_up,
        "guess": candidates.guesses,
    }
    key = form_key(make_coefficients_explicit(program).program)
    for origin, programs in sources.items():
        if any(form_key(make_coefficients_explicit(candidate).program) == key for candidate in programs):
            return origin
    return "descent"


# ------------------------------------------------------------------------------------------------- simulations


def _describe_process(chosen: ChosenProcess, shown: ShownProcess, seed: int) -> Process:
    """Return the findings on the process as a whole."""
    process, steps, model = chosen.process, chosen.likelihood.steps, shown.model
    noisy = [state for state, variance in zip(process.states, model.noise, strict=True) if variance > 0.0]
    relative = shown.errors.standard_errors[len(shown.errors.values) - len(noisy) :].tolist()
    noise = {}
    for state, error in zip(noisy, relative, strict=True):
        sd = math.sqrt(model.noise[process.states.index(state)])
        interval = (sd * math.exp(-1.96 * error), sd * math.exp(1.96 * error)) if error < 50.0 else None
        noise[state] = MeasurementNoise(sd=sd, std_error=sd * error, interval=interval)
    simulator = Simulator(model.moments, np.random.default_rng(seed))
    held_out_steps = take_steps(process, held_out=True)
    held_out = None
    if len(held_out_steps.lengths):
        likelihood = ProcessLikelihood(held_out_steps)
        held_out = likelihood.log_likelihood_per_step(likelihood.whiten(model).misfit)
    return Process(
        steps=len(steps.lengths),
        step=float(np.median(steps.lengths)),
        discretisation=model.discretisation,
        discretisation_nats=chosen.discretisation_nats,
        log_likelihood=chosen.likelihood.log_likelihood_per_step(shown.fitted.misfit),
        held_out_log_likelihood=held_out,
        measurement_noise=noise,
        ensemble=simulate_ensemble(simulator, process),
        stationary=simulate_stationary_density(simulator, process, steps),
    )
