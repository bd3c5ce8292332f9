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
from atoll_coordinator.model.inference.checks import Finding
from atoll_coordinator.model.inference.residuals import residual_statistics
from atoll_coordinator.model.inference.standard_errors import joint_covariance
from atoll_coordinator.model.inference.verdict import Verdict, checks_of, failures, sentence
from atoll_coordinator.model.pools import Origin
from atoll_coordinator.model.refinement import Alternative, Refined, Refinement
from atoll_coordinator.model.regression.covariance import Known, describe, student_95
from atoll_coordinator.model.regression.errors import errors_on
from atoll_coordinator.model.regression.fit import contains
from atoll_coordinator.model.regression.rounding import Estimates
from atoll_coordinator.model.selection.candidates import CandidateSet, form
from atoll_coordinator.model.stochastic.likelihood import FittedProcess, ProcessLikelihood, ProcessModel
from atoll_coordinator.model.stochastic.path_ensembles import settle, simulate_ensemble
from atoll_coordinator.model.stochastic.process_choice import ChosenProcess, is_zero
from atoll_coordinator.result.equations import Constant
from atoll_coordinator.result.findings import Covariance, MeasurementNoise, Place, Process
from atoll_coordinator.settings import SETTINGS
from atoll_coordinator.stochastic.paths import Simulator
from atoll_core.config import JobConfig
from atoll_core.data.dataset import Dataset, FloatArray
from atoll_core.expression.program import Program, constant_places, with_constants
from atoll_core.expression.unit_coefficients import (
    ExplicitCoefficients,
    as_written,
    make_coefficients_explicit,
    write_factors,
)

_NO_COVARIANCE: Final = "The noises of these states are not correlated beyond chance."
_NO_VARIANCE: Final = "This state has no noise of its own: the noise of other states explains its steps."
_CERTAIN: Final = "The steps follow this equation up to rounding."
_NO_NOISE: Final = (
    "No state shows noise, so that these are not the equations of a stochastic process: leave out --stochastic to have "
    "the equations of motion judged."
)
_STOPPED: Final = Finding(
    "not made", "the time limit stopped the choice of the equations", advice="give more time with --max-time"
)


@dataclass(frozen=True, eq=False)
class _Equation:
    """One equation as it is shown, with the estimates of its constants."""

    program: Program
    known: Known


def summarize_process(
    chosen: ChosenProcess, dataset: Dataset, config: JobConfig, candidates: Mapping[str, CandidateSet]
) -> Refinement:
    """Return the refinement that the chosen law gives."""
    fitted, coefficients, equations = _written(chosen)
    shown = fitted.model
    for number, equation in enumerate(equations):
        shown = shown.with_program(number, equation.program)
    verdicts = _judge(chosen, fitted.model, equations)
    refined = {}
    for number, (name, equation) in enumerate(zip(chosen.variables, equations, strict=True)):
        if number not in chosen.sought:
            continue
        candidate_set = candidates.get(name, CandidateSet())
        error, mse = errors_on(dataset.problem(name), equation.program, config.evolution.loss)
        verdict = verdicts[number]
        refined[name] = Refined(
            None,
            equation.program,
            error,
            mse,
            equation.known.written,
            equation.known.unit_coefficients,
            _alternatives(chosen, number, equation.program, candidate_set),
            verdict.grade,
            verdict.reason,
            verdict.checks,
            _origin(equation.program, candidate_set),
        )
    process = _process(chosen, fitted, shown, config.seed)
    return Refinement(refined, process=process, covariance=_covariance(chosen, fitted, coefficients))


def _written(chosen: ChosenProcess) -> tuple[FittedProcess, list[ExplicitCoefficients], list[_Equation]]:
    """Return the law with all its factors as constants, fitted, these equations, and those that are written.

    Factors of one are written where their intervals do not hold one.
    """
    programs = list(chosen.fitted.model.programs)
    for _ in range(2):
        coefficients = [
            make_coefficients_explicit(program)
            if number in chosen.free and chosen.restrictions[number].bounds is None
            else as_written(program)
            for number, program in enumerate(programs)
        ]
        fitted = _fitted(chosen, coefficients)
        described = _described(chosen, fitted, coefficients, programs)
        refuted = [known.refuted_factors for known in described]
        if not any(refuted):
            break
        programs = [
            write_factors(explicit, fitted_program, factors) if factors else program
            for explicit, fitted_program, factors, program in zip(
                coefficients, fitted.model.programs, refuted, programs, strict=True
            )
        ]
    places = _slices(chosen, fitted.model)
    covariance, equations = fitted.covariance, []
    for number, (program, explicit) in enumerate(zip(programs, coefficients, strict=True)):
        if number in chosen.free:
            origins = {origin: k for k, origin in enumerate(explicit.origins) if origin is not None}
            written = [origins[constant] for constant in range(len(origins))]
            values = fitted.model.parameters(chosen.free)[places[number]][written]
            block = covariance[places[number], places[number]][np.ix_(written, written)]
            rounded = _rounded(program, values, block)
            bounds = chosen.restrictions[number].bounds
            program = rounded if bounds is None else bounds.clipped(rounded)
        equations.append(program)
    described = _described(chosen, fitted, coefficients, equations)
    return fitted, coefficients, [_Equation(*parts) for parts in zip(equations, described, strict=True)]


def _covariance(
    chosen: ChosenProcess, fitted: FittedProcess, coefficients: Sequence[ExplicitCoefficients]
) -> Covariance:
    """Return the joint covariance of all constants except the noise."""
    places = [
        Place(variable=chosen.variables[number], constant=origin)
        for number in chosen.free
        for origin in coefficients[number].origins
    ]
    freedom = float(len(chosen.likelihood.steps.lengths) - len(fitted.information))
    matrix = fitted.covariance[: len(places), : len(places)]
    return joint_covariance(places, matrix, freedom) or Covariance(constants=(), matrix=(), freedom=freedom)


def _fitted(chosen: ChosenProcess, coefficients: Sequence[ExplicitCoefficients]) -> FittedProcess:
    model = chosen.fitted.model
    for number, explicit in enumerate(coefficients):
        model = model.with_program(number, explicit.program)
    return chosen.likelihood.fit(model, chosen.free)


def _slices(chosen: ChosenProcess, model: ProcessModel) -> dict[int, slice]:
    """Return where the constants of each equation stand among the parameters."""
    slices, first = {}, 0
    for number in chosen.free:
        count = len(constant_places(model.programs[number]))
        slices[number] = slice(first, first + count)
        first += count
    return slices


def _described(
    chosen: ChosenProcess,
    fitted: FittedProcess,
    coefficients: Sequence[ExplicitCoefficients],
    programs: Sequence[Program],
) -> list[Known]:
    """Return the estimates of the constants of `programs`, as they are written."""
    errors = np.sqrt(np.maximum(np.diag(fitted.covariance), 0.0))
    values, places = fitted.model.parameters(chosen.free), _slices(chosen, fitted.model)
    quantile = student_95(float(len(chosen.likelihood.steps.lengths) - len(values)))
    descriptions = []
    for number, (explicit, program) in enumerate(zip(coefficients, programs, strict=True)):
        if number in chosen.free:
            place = places[number]
            descriptions.append(describe(explicit, program, values[place].tolist(), errors[place].tolist(), quantile))
        else:
            constants = program.constants[constant_places(program)].tolist()
            descriptions.append(Known(tuple(Constant(value=value) for value in constants), ()))
    return descriptions


def _rounded(program: Program, values: FloatArray, covariance: FloatArray) -> Program:
    """Return `program` with its constants rounded by their standard errors."""
    places = constant_places(program)
    if not places:
        return program
    rounded = Estimates(values, covariance).rounded(estimates=range(len(places))).values
    return with_constants(program, dict(zip(places, rounded.tolist(), strict=True)))


def _alternatives(
    chosen: ChosenProcess, number: int, program: Program, candidates: CandidateSet
) -> tuple[Alternative, ...]:
    rivals = [rival for rival in chosen.rivals[number] if math.isfinite(rival.nats)]
    best = rivals[0].nats if rivals else 0.0
    first = Alternative(program, 0.0, None, is_shown=True, origin=_origin(program, candidates))
    rest = [
        Alternative(rival.program, rival.nats - best, None, origin=_origin(rival.program, candidates))
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


def _judge(chosen: ChosenProcess, model: ProcessModel, equations: Sequence[_Equation]) -> list[Verdict]:
    """Return the verdict on each equation."""
    if not _has_noise(chosen, model):
        checks = checks_of({"noise": Finding("failed", _NO_NOISE)})
        return [Verdict("doubtful", _NO_NOISE, checks)] * len(equations)
    residuals = chosen.likelihood.whitened(model).residuals
    steps = chosen.likelihood.steps
    bins = split_into_bins(steps.points, SETTINGS.effort.kept)
    states = len(model.drift)
    driven = _without_noise(model)
    is_certain = [
        state in driven and model.discretisation == "Euler-Maruyama" and float(np.mean(residuals[state] ** 2)) < 1.0
        for state in range(states)
    ]

    def of_steps(state: int) -> dict[str, Finding]:
        if is_certain[state]:
            return {}
        checks = _drift_checks(residuals[state], bins, steps.follows)
        return checks | joint_checks(residuals, state, chosen.process.states, has_noise=state not in driven)

    verdicts = []
    for number, equation in enumerate(equations):
        good = "The residual steps are independent and without a pattern over the states"
        if number < states and is_certain[number]:
            findings, good = {}, _CERTAIN
        elif number < states:
            findings, good = of_steps(number) | _model_checks(chosen, number, equation), f"{good}."
        elif is_zero(equation.program):
            i, j = model.pairs[number - states]
            findings, good = ({}, _NO_COVARIANCE) if i != j else (of_steps(i), _NO_VARIANCE)
        else:
            i, j = model.pairs[number - states]
            findings = _diffusion_checks(residuals[i], residuals[j], bins, is_variance=i == j)
            findings, good = findings | _model_checks(chosen, number, equation), f"{good}, and their sizes are normal."
        if chosen.is_stopped:
            findings = {**findings, "time": _STOPPED}
        against, checks = failures(findings.values()), checks_of(findings)
        verdicts.append(Verdict("doubtful", sentence(against), checks) if against else Verdict("good", good, checks))
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


def _by_chance(chance: float, limit: float, fault: str, merit: str) -> Finding:
    """Return the finding of a check by a probability, which fails below the limit."""
    return Finding("failed", fault, chance, limit) if chance < limit else Finding("passed", merit, chance, limit)


def _drift_checks(residuals: FloatArray, bins: Sequence[Rows], follows: npt.NDArray[np.bool_]) -> dict[str, Finding]:
    """Return the checks of the drift of one state, from the whitened steps (N,)."""
    limit = SETTINGS.inference.improbable
    pattern = _pattern([residuals[rows] for rows in bins])
    pieces = np.split(residuals, np.flatnonzero(~follows)[1:])
    serial = residual_statistics(pieces, 1.0).patterned
    serial = 2.0 * min(serial, 1.0 - serial)
    return {
        "pattern of steps": _by_chance(
            pattern, limit,
            f"the residual steps follow a pattern over the states (p = {pattern:.1g})",
            "the steps show no pattern over the states",
        ),
        "serial correlation": _by_chance(
            serial, limit, f"steps are correlated with the steps before them (p = {serial:.1g})",
            "steps are independent of the steps before them",
        ),
    }  # fmt: skip


def joint_checks(residuals: FloatArray, state: int, names: Sequence[str], *, has_noise: bool) -> dict[str, Finding]:
    """Return the checks of one state against the others, from the whitened steps of all (S, N).

    They are independent of each other, and of variance one also where no diffusion of the state's own was fitted to it.
    """
    limit, findings = SETTINGS.inference.improbable, dict[str, Finding]()
    if not has_noise:
        chance, size = _chance(residuals[state] ** 2 - 1.0), float(np.sqrt(np.mean(residuals[state] ** 2)))
        findings["size of steps"] = _by_chance(
            chance, limit,
            f"its steps are {size:.3g} times as large as the noise of other states makes them (p = {chance:.1g})",
            "its steps are as large as the noise of other states makes them",
        )  # fmt: skip
    chances = {
        partner: _chance(residuals[state] * residuals[partner]) for partner in range(len(names)) if partner != state
    }
    least = min(chances, key=lambda partner: chances[partner], default=None)
    if least is not None:
        findings["correlation of states"] = _by_chance(
            chances[least], limit / len(chances),
            f"the residual steps are correlated with the steps of {names[least]} (p = {chances[least]:.1g})",
            "its steps are independent of the steps of other states",
        )  # fmt: skip
    return findings


def _chance(values: FloatArray) -> float:
    """Return the probability of a mean as far from zero as the mean of independent `values` (N,) if theirs is zero."""
    from scipy import special

    error = float(values.std()) / math.sqrt(len(values))
    return 2.0 * float(special.ndtr(-abs(float(values.mean())) / error)) if error > 0.0 else 1.0


def _diffusion_checks(
    first: FloatArray, second: FloatArray, bins: Sequence[Rows], *, is_variance: bool
) -> dict[str, Finding]:
    """Return the checks of a component of the diffusion, from the whitened steps (N,) of its two states."""
    from scipy import special

    limit = SETTINGS.inference.improbable
    products = first * second - (1.0 if is_variance else 0.0)
    pattern = _pattern([products[rows] for rows in bins])
    findings = {
        "pattern of squared steps": _by_chance(
            pattern, limit,
            f"the squares of the residual steps follow a pattern over the states (p = {pattern:.1g})",
            "the squares of the steps show no pattern over the states",
        )
    }  # fmt: skip
    if is_variance:
        kurtosis = float(np.mean(first**4)) - 3.0
        chance = float(special.ndtr(-kurtosis / math.sqrt(24.0 / len(first))))
        findings["normal steps"] = _by_chance(
            chance, limit,
            f"the steps have heavier tails than a normal distribution (excess kurtosis {kurtosis:.2g})",
            "the steps are normally distributed",
        )  # fmt: skip
    return findings


def _pattern(parts: Sequence[FloatArray]) -> float:
    """Return the probability of means of `parts` as large as these if all have mean zero."""
    from scipy import special

    variance = float(np.var(np.concatenate(parts)))
    if not variance > 0.0:
        return 1.0  # all equal, as residuals of exact steps: there is no pattern, regardless of the mean
    squares = [len(part) * float(np.mean(part)) ** 2 / variance for part in parts if len(part)]
    return float(special.chdtrc(len(squares), math.fsum(squares)))


def _model_checks(chosen: ChosenProcess, number: int, equation: _Equation) -> dict[str, Finding]:
    """Return the checks of an equation other than residuals: its constants, and alternative equations."""
    findings, written = dict[str, Finding](), equation.known.written
    if len(written) > 1:
        is_loose = any(not constant.identifiable for constant in written)
        reason = "a constant is not determined: its interval holds zero" if is_loose else "all constants are determined"
        findings["constants"] = Finding("failed" if is_loose else "passed", reason)
    rivals, limit = chosen.rivals[number], SETTINGS.inference.distinct_nats
    points = chosen.likelihood.steps.points
    near = (rival for rival in rivals[1:] if rival.nats - rivals[0].nats < limit)
    rival = next((rival for rival in near if not contains(rival.program, equation.program, points)), None)
    if rival is None:
        reason = "no other equation describes the data about as well"
        return {**findings, "alternative equations": Finding("passed", reason)}
    apart = rival.nats - rivals[0].nats
    reason = f"another equation describes the data about as well (Δ description length {apart:.1f})"
    return {**findings, "alternative equations": Finding("failed", reason, apart, limit)}


# ------------------------------------------------------------------------------------------------- simulations


def _process(chosen: ChosenProcess, fitted: FittedProcess, shown: ProcessModel, seed: int) -> Process:
    """Return the findings on the process as a whole."""
    process, steps = chosen.process, chosen.likelihood.steps
    errors = np.sqrt(np.maximum(np.diag(fitted.covariance), 0.0))
    noisy = [state for state, variance in zip(process.states, shown.noise, strict=True) if variance > 0.0]
    relative = errors[len(errors) - len(noisy) :].tolist()
    noise = {}
    for state, error in zip(noisy, relative, strict=True):
        sd = math.sqrt(fitted.model.noise[process.states.index(state)])
        interval = (sd * math.exp(-1.96 * error), sd * math.exp(1.96 * error)) if error < 50.0 else None
        noise[state] = MeasurementNoise(sd=sd, std_error=sd * error, interval=interval)
    simulator = Simulator(shown.moments, np.random.default_rng(seed))
    unseen = take_steps(process, held_out=True)
    held_out = None
    if len(unseen.lengths):
        likelihood = ProcessLikelihood(unseen)
        held_out = likelihood.of_a_step(likelihood.whitened(shown).misfit)
    return Process(
        steps=len(steps.lengths),
        step=float(np.median(steps.lengths)),
        discretisation=shown.discretisation,
        discretisation_nats=chosen.discretisation_nats,
        log_likelihood=chosen.likelihood.of_a_step(fitted.misfit),
        held_out_log_likelihood=held_out,
        measurement_noise=noise,
        ensemble=simulate_ensemble(simulator, process),
        stationary=settle(simulator, process, steps),
    )
