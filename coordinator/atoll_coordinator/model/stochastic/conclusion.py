"""From the chosen law of a process to the reported model: constants with errors, alternatives, verdicts, ensembles."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from atoll_coordinator.data.increments import take_steps
from atoll_coordinator.model.constants.rounding import Estimates, FittedEquations, RoundedEquations
from atoll_coordinator.model.constants.standard_errors import (
    ConstantErrors,
    Known,
    describe_constants,
    explicit_coefficients,
    fitted_places,
    joint_covariance,
    with_refuted_factors,
)
from atoll_coordinator.model.inference.verdict import judge
from atoll_coordinator.model.pools import Origin
from atoll_coordinator.model.refinement import Alternative, Refined, Refinement
from atoll_coordinator.model.regression.errors import errors_on
from atoll_coordinator.model.selection.candidates import CandidateSet, form_key
from atoll_coordinator.model.stochastic.checks import ProcessChecks, ProcessSteps
from atoll_coordinator.model.stochastic.likelihood import FittedProcess, ProcessLikelihood, ProcessModel
from atoll_coordinator.model.stochastic.path_ensembles import settle, simulate_ensemble
from atoll_coordinator.model.stochastic.process_choice import ChosenProcess
from atoll_coordinator.result.findings import Covariance, MeasurementNoise, Process
from atoll_coordinator.stochastic.paths import Simulator
from atoll_core.config import JobConfig
from atoll_core.data.dataset import Dataset
from atoll_core.expression.program import Program, constant_places
from atoll_core.expression.unit_coefficients import ExplicitCoefficients, make_coefficients_explicit


@dataclass(frozen=True, eq=False)
class ShownProcess:
    """The equations of a process as they are shown, with the estimates of their constants (`known`).

    `fitted` is the fit of `explicit`, all constants free, whose parameters have these `errors`; those that are not
    constants are the logarithms of standard errors of noise.
    """

    rounded: RoundedEquations
    known: Sequence[Known]
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
    """Return the refinement that the chosen law gives."""
    shown = show_process(chosen)
    steps, refined = ProcessSteps(chosen, shown.fitted.model), {}
    for number in chosen.sought:
        name, program, known = chosen.variables[number], shown.rounded.programs[number], shown.known[number]
        candidate_set, problem = candidates.get(name, CandidateSet()), dataset.problem(name)
        equation = Refined(
            None,
            program,
            *errors_on(problem, program, config.evolution.loss),
            known.written,
            known.unit_coefficients,
            _alternatives(chosen, number, program, candidate_set),
            origin=_origin(program, candidate_set),
            simple_together=shown.rounded.together[number],
        )
        refined[name] = replace(equation, **vars(judge(ProcessChecks(equation, problem.target, steps, number))))
    places = fitted_places(_given(chosen), chosen.variables, shown.explicit)
    freedom, matrix = shown.errors.degrees_of_freedom, shown.errors.covariance[: len(places), : len(places)]
    covariance = joint_covariance(places, matrix, freedom) or Covariance(constants=(), matrix=(), freedom=freedom)
    return Refinement(refined, process=_process(chosen, shown, config.seed), covariance=covariance)


def show_process(chosen: ChosenProcess) -> ShownProcess:
    """Return the equations as they are shown: constants simple where the steps single them out, others rounded.

    Factors of one are written where their intervals do not hold one.
    """
    likelihood, given = chosen.likelihood, _given(chosen)

    def growth(programs: Sequence[Program]) -> float:
        return likelihood.whitened(chosen.fitted.model.with_programs(programs)).misfit - chosen.fitted.misfit

    programs: Sequence[Program] = _fitted_equations(chosen, chosen.fitted).simplified(growth)
    for _ in range(2):
        explicit = [
            explicit_coefficients(program, restrictions, is_given=number in given)
            for number, (program, restrictions) in enumerate(zip(programs, chosen.restrictions, strict=True))
        ]
        fitted = likelihood.fit(chosen.fitted.model.with_programs([one.program for one in explicit]), chosen.free)
        errors = likelihood.errors(fitted, chosen.free)
        known = describe_constants(given, explicit, programs, errors)
        written = with_refuted_factors(explicit, fitted.model.programs, programs, known)
        if written == [*programs]:
            break
        programs = written
    as_shown = likelihood.fit(chosen.fitted.model.with_programs(programs), chosen.free)
    rounded = _fitted_equations(chosen, as_shown).rounded()
    known = describe_constants(given, explicit, rounded.programs, errors)
    known = [one.with_simple(simple) for one, simple in zip(known, rounded.simple, strict=True)]
    return ShownProcess(rounded, known, explicit, fitted, errors)


def _given(chosen: ChosenProcess) -> list[int]:
    """Return the equations, by number, whose constants are not fitted."""
    return [number for number in range(len(chosen.variables)) if number not in chosen.free]


def _fitted_equations(chosen: ChosenProcess, fitted: FittedProcess) -> FittedEquations:
    """Return the equations of a fit with the estimates of their constants, for rounding."""
    errors, given = chosen.likelihood.errors(fitted, chosen.free), _given(chosen)
    count = sum(len(constant_places(fitted.model.programs[number])) for number in chosen.free)
    estimates = Estimates(errors.values[:count], errors.bounded[:count, :count])
    return FittedEquations(fitted.model.programs, estimates, chosen.restrictions, given)


def _alternatives(
    chosen: ChosenProcess, number: int, program: Program, candidates: CandidateSet
) -> tuple[Alternative, ...]:
    rivals = [rival for rival in chosen.rivals[number] if math.isfinite(rival.length)]
    best = rivals[0].length if rivals else 0.0
    first = Alternative(program, 0.0, None, is_shown=True, origin=_origin(program, candidates))
    rest = [
        Alternative(rival.program, rival.length - best, None, origin=_origin(rival.program, candidates))
        for rival in rivals[1:]
    ]
    return (first, *rest)


def _origin(program: Program, candidates: CandidateSet) -> Origin:
    """Return the source of an equation, regardless of its constants and factors."""
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


def _process(chosen: ChosenProcess, shown: ShownProcess, seed: int) -> Process:
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
    unseen = take_steps(process, held_out=True)
    held_out = None
    if len(unseen.lengths):
        likelihood = ProcessLikelihood(unseen)
        held_out = likelihood.of_a_step(likelihood.whitened(model).misfit)
    return Process(
        steps=len(steps.lengths),
        step=float(np.median(steps.lengths)),
        discretisation=model.discretisation,
        discretisation_nats=chosen.discretisation_nats,
        log_likelihood=chosen.likelihood.of_a_step(shown.fitted.misfit),
        held_out_log_likelihood=held_out,
        measurement_noise=noise,
        ensemble=simulate_ensemble(simulator, process),
        stationary=settle(simulator, process, steps),
    )
