"""From the chosen law of a process to the reported model: constants with errors, alternatives, verdicts, ensembles.

For the right law the whitened steps are independent, normal and of variance one in every state. Each is tested:
neighbours (Ljung & Box 1978), means and squares in bins of the states (chi-square), the fourth moment, products with
other states, and squares of states that have no noise of their own.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from atoll_coordinator.data.increments import Rows, split_into_bins, take_steps
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
from atoll_coordinator.model.inference.residuals import residual_statistics
from atoll_coordinator.model.inference.verdict import Verdict, failures, sentence
from atoll_coordinator.model.pools import Origin
from atoll_coordinator.model.refinement import Alternative, Refined, Refinement
from atoll_coordinator.model.regression.errors import errors_on
from atoll_coordinator.model.regression.fit import contains
from atoll_coordinator.model.selection.candidates import CandidateSet, form
from atoll_coordinator.model.stochastic.likelihood import FittedProcess, ProcessLikelihood, ProcessModel
from atoll_coordinator.model.stochastic.path_ensembles import settle, simulate_ensemble
from atoll_coordinator.model.stochastic.process_choice import ChosenProcess, is_zero
from atoll_coordinator.result.equations import Check
from atoll_coordinator.result.findings import Covariance, MeasurementNoise, Process
from atoll_coordinator.settings import SETTINGS
from atoll_coordinator.stochastic.paths import Simulator
from atoll_core.config import JobConfig
from atoll_core.data.dataset import Dataset, FloatArray
from atoll_core.expression.program import Program, constant_places
from atoll_core.expression.unit_coefficients import ExplicitCoefficients, make_coefficients_explicit

_NO_COVARIANCE: Final = "The noises of these states are not correlated beyond chance."
_NO_VARIANCE: Final = "This state has no noise of its own: the noise of other states explains its steps."
_CERTAIN: Final = "The steps follow this equation up to rounding."
_NO_NOISE: Final = (
    "No state shows noise, so that these are not the equations of a stochastic process: leave out --stochastic to have "
    "the equations of motion judged."
)
_STOPPED: Final = "the time limit stopped the choice of the equations: give more time with --max-time"


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
    verdicts = _judge(chosen, shown)
    refined = {}
    for number in chosen.sought:
        name, program, known = chosen.variables[number], shown.rounded.programs[number], shown.known[number]
        candidate_set = candidates.get(name, CandidateSet())
        error, mse = errors_on(dataset.problem(name), program, config.evolution.loss)
        verdict = verdicts[number]
        refined[name] = Refined(
            None,
            program,
            error,
            mse,
            known.written,
            known.unit_coefficients,
            _alternatives(chosen, number, program, candidate_set),
            verdict.grade,
            verdict.reason,
            verdict.checks,
            _origin(program, candidate_set),
            simple_together=shown.rounded.together[number],
        )
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
    key = form(make_coefficients_explicit(program).program)
    for origin, programs in sources.items():
        if any(form(make_coefficients_explicit(candidate).program) == key for candidate in programs):
            return origin
    return "descent"


# ------------------------------------------------------------------------------------------------- verdicts


def _judge(chosen: ChosenProcess, shown: ShownProcess) -> list[Verdict]:
    """Return the verdict on each equation."""
    model, equations = shown.fitted.model, shown.rounded.programs
    if not _has_noise(chosen, model):
        return [Verdict("doubtful", _NO_NOISE, (Check(name="noise", outcome="failed", reason=_NO_NOISE),))] * len(
            equations
        )
    residuals = chosen.likelihood.whitened(model).residuals
    steps = chosen.likelihood.steps
    bins = split_into_bins(steps.points, SETTINGS.effort.kept)
    states = len(model.drift)
    driven = _without_noise(model)
    is_certain = [
        state in driven and model.discretisation == "Euler-Maruyama" and float(np.mean(residuals[state] ** 2)) < 1.0
        for state in range(states)
    ]

    def of_steps(state: int) -> list[Check]:
        if is_certain[state]:
            return []
        checks = _drift_checks(residuals[state], bins, steps.follows)
        return checks + joint_checks(residuals, state, chosen.process.states, has_noise=state not in driven)

    verdicts = []
    for number, program in enumerate(equations):
        good = "The residual steps are independent and without a pattern over the states"
        if number < states and is_certain[number]:
            checks, good = [], _CERTAIN
        elif number < states:
            checks, good = of_steps(number) + _model_checks(chosen, number, program, shown.known[number]), f"{good}."
        elif is_zero(program):
            i, j = model.pairs[number - states]
            checks, good = ([], _NO_COVARIANCE) if i != j else (of_steps(i), _NO_VARIANCE)
        else:
            i, j = model.pairs[number - states]
            checks = _diffusion_checks(residuals[i], residuals[j], bins, is_variance=i == j)
            checks, good = (
                checks + _model_checks(chosen, number, program, shown.known[number]),
                f"{good}, and their sizes are normal.",
            )
        if chosen.is_stopped:
            checks.append(Check(name="time", outcome="not made", reason=_STOPPED))
        against = list(failures(checks))
        verdicts.append(
            Verdict("doubtful", sentence(against), tuple(checks)) if against else Verdict("good", good, tuple(checks))
        )
    return verdicts


def _has_noise(chosen: ChosenProcess, model: ProcessModel) -> bool:
    """Tell whether a state has noise that counts: with less, the process counts as deterministic.

    The output of a numerical method, or a table that repeats after a few rows, follows a law exactly, and there is no
    noise to test it.
    """
    steps = chosen.likelihood.steps
    covariance = model.moments(steps.points, steps.lengths).covariance
    own = np.median(np.diagonal(covariance), axis=0)
    return any(model.noise) or not bool((own <= steps.least_variances).all())


def _without_noise(model: ProcessModel) -> list[int]:
    """Return the states that have no noise of their own."""
    return [i for (i, j), program in zip(model.pairs, model.diffusion, strict=True) if i == j and is_zero(program)]


def _check(name: str, chance: float, limit: float, fault: str, merit: str) -> Check:
    """Return a check by a probability, which fails below the limit."""
    outcome, reason = ("failed", fault) if chance < limit else ("passed", merit)
    return Check(name=name, outcome=outcome, reason=reason, value=chance, limit=limit)


def _drift_checks(residuals: FloatArray, bins: Sequence[Rows], follows: npt.NDArray[np.bool_]) -> list[Check]:
    """Return the checks of the drift of one state, from the whitened steps (N,)."""
    limit = SETTINGS.inference.improbable
    pattern = _pattern([residuals[rows] for rows in bins])
    pieces = np.split(residuals, np.flatnonzero(~follows)[1:])
    serial = residual_statistics(pieces, 1.0).patterned
    serial = 2.0 * min(serial, 1.0 - serial)
    return [
        _check(
            "pattern of steps", pattern, limit,
            f"the residual steps follow a pattern over the states (p = {pattern:.1g})",
            "the steps show no pattern over the states",
        ),
        _check(
            "serial correlation", serial, limit, f"steps are correlated with the steps before them (p = {serial:.1g})",
            "steps are independent of the steps before them",
        ),
    ]  # fmt: skip


def joint_checks(residuals: FloatArray, state: int, names: Sequence[str], *, has_noise: bool) -> list[Check]:
    """Return the checks of one state against the others, from the whitened steps of all (S, N).

    They are independent of each other, and of variance one also where no diffusion of the state's own was fitted to it.
    """
    limit, checks = SETTINGS.inference.improbable, []
    if not has_noise:
        chance, size = _chance(residuals[state] ** 2 - 1.0), float(np.sqrt(np.mean(residuals[state] ** 2)))
        checks.append(
            _check(
                "size of steps", chance, limit,
                f"its steps are {size:.3g} times as large as the noise of other states makes them (p = {chance:.1g})",
                "its steps are as large as the noise of other states makes them",
            )
        )  # fmt: skip
    chances = {
        partner: _chance(residuals[state] * residuals[partner]) for partner in range(len(names)) if partner != state
    }
    least = min(chances, key=lambda partner: chances[partner], default=None)
    if least is not None:
        checks.append(
            _check(
                "correlation of states", chances[least], limit / len(chances),
                f"the residual steps are correlated with the steps of {names[least]} (p = {chances[least]:.1g})",
                "its steps are independent of the steps of other states",
            )
        )  # fmt: skip
    return checks


def _chance(values: FloatArray) -> float:
    """Return the probability of a mean as far from zero as the mean of independent `values` (N,) if theirs is zero."""
    from scipy import special

    error = float(values.std()) / math.sqrt(len(values))
    return 2.0 * float(special.ndtr(-abs(float(values.mean())) / error)) if error > 0.0 else 1.0


def _diffusion_checks(first: FloatArray, second: FloatArray, bins: Sequence[Rows], *, is_variance: bool) -> list[Check]:
    """Return the checks of a component of the diffusion, from the whitened steps (N,) of its two states."""
    from scipy import special

    limit = SETTINGS.inference.improbable
    products = first * second - (1.0 if is_variance else 0.0)
    pattern = _pattern([products[rows] for rows in bins])
    checks = [
        _check(
            "pattern of squared steps", pattern, limit,
            f"the squares of the residual steps follow a pattern over the states (p = {pattern:.1g})",
            "the squares of the steps show no pattern over the states",
        )
    ]  # fmt: skip
    if is_variance:
        kurtosis = float(np.mean(first**4)) - 3.0
        chance = float(special.ndtr(-kurtosis / math.sqrt(24.0 / len(first))))
        checks.append(
            _check(
                "normal steps", chance, limit,
                f"the steps have heavier tails than a normal distribution (excess kurtosis {kurtosis:.2g})",
                "the steps are normally distributed",
            )
        )  # fmt: skip
    return checks


def _pattern(parts: Sequence[FloatArray]) -> float:
    """Return the probability of means of `parts` as large as these if all have mean zero."""
    from scipy import special

    variance = float(np.var(np.concatenate(parts)))
    if not variance > 0.0:
        return 1.0  # all equal, as residuals of exact steps: there is no pattern, regardless of the mean
    squares = [len(part) * float(np.mean(part)) ** 2 / variance for part in parts if len(part)]
    return float(special.chdtrc(len(squares), math.fsum(squares)))


def _model_checks(chosen: ChosenProcess, number: int, program: Program, known: Known) -> list[Check]:
    """Return the checks of an equation other than residuals: its constants, and alternative equations."""
    checks, written = [], known.written
    if len(written) > 1:
        is_loose = any(not constant.identifiable for constant in written)
        reason = "a constant is not determined: its interval holds zero" if is_loose else "all constants are determined"
        checks.append(Check(name="constants", outcome="failed" if is_loose else "passed", reason=reason))
    rivals, limit = chosen.rivals[number], SETTINGS.inference.distinct_nats
    points = chosen.likelihood.steps.points
    near = (rival for rival in rivals[1:] if rival.length - rivals[0].length < limit)
    rival = next((rival for rival in near if not contains(rival.program, program, points)), None)
    if rival is None:
        reason = "no other equation describes the data about as well"
        return [*checks, Check(name="alternative equations", outcome="passed", reason=reason)]
    apart = rival.length - rivals[0].length
    reason = f"another equation describes the data about as well (Δ description length {apart:.1f})"
    return [*checks, Check(name="alternative equations", outcome="failed", reason=reason, value=apart, limit=limit)]


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
