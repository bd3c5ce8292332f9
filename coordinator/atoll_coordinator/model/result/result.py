"""The result of a job, made of what the search and refining have found; docs/result.md says what its keys mean."""

import math
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache
from importlib.metadata import PackageNotFoundError, version
from typing import Final, TypeVar
from weakref import WeakKeyDictionary

import numpy as np

from atoll_coordinator.data.recording import Preparation
from atoll_coordinator.model.criteria import select_member
from atoll_coordinator.model.pools import Origin
from atoll_coordinator.model.refinement import Constant, Refined, Refinement, SimpleNumber, SimpleTogether
from atoll_coordinator.model.regression.errors import errors_on
from atoll_coordinator.model.result.diagnostics import noise, smoothing
from atoll_coordinator.model.result.digest import result_digest
from atoll_coordinator.model.result.numbers import curve, finite, thinned
from atoll_coordinator.model.result.process_findings import process
from atoll_coordinator.model.result.regression import regression
from atoll_coordinator.model.result.shared_terms import shared_terms
from atoll_coordinator.model.result.source import data, settings, system
from atoll_coordinator.model.result.trust import (
    candidates,
    chaos,
    checks,
    correlations,
    covariance,
    groups,
    prediction,
    simulation,
    verdict,
)
from atoll_coordinator.result import equations as parts
from atoll_coordinator.result import findings
from atoll_coordinator.result.result import Result
from atoll_core import ENGINE_REVISION, PROTOCOL_VERSION, VERSION
from atoll_core.config import JobConfig, Loss
from atoll_core.data.dataset import Dataset, FloatArray, Problem, Target
from atoll_core.expression.operators import CONSTANT
from atoll_core.expression.program import Program, structure
from atoll_core.expression.restrictions import restrictions_of
from atoll_core.expression.text.infix import PRINTABLE_SIZE, to_infix, tree_size
from atoll_core.expression.writing.shortest import points_of, shortest_at
from atoll_core.search.pareto import FrontEntry
from atoll_core.wire.messages.views import FINAL_STATES, JobState

KNOWN: Final = "known"
"""Why there was no search: the equation was given."""
EstimateT = TypeVar("EstimateT", bound=parts.Estimate)

MOST_STEPS: Final = 40
"""Improvements of one island that are listed."""
NOT_BY_GROUP: Final = (
    "Constants by group were not fitted; those shown are of all groups of trajectories together, and --group cannot "
    "choose one."
)

_POINTS: Final[WeakKeyDictionary[Dataset, FloatArray]] = WeakKeyDictionary()

_PACKAGES: Final = ("eclipse-zenoh", "numpy", "numba", "scipy", "sympy", "msgpack", "pydantic", "polars")


@dataclass(frozen=True)
class VariableOutcome:
    """How the search for one equation stands or ended.

    `front` is the merged front up to the cut, by rising complexity; `epoch` the number of completely reported epochs up
    to the cut (0: none yet); `generation` the one that met the target, counted from the search's beginning, or None
    when none did; `evaluations` the cumulative point evaluations by part, all islands together; `seconds` the time from
    the first epoch's start to the cut's end; `why` how the search ended (None: it has not), as in
    `atoll_core.wire.messages.views.VariableView`; `refined` is the equation made of the front after the search (None:
    none yet); `runners_up` is what was kept beside the front; `convergence` has, for each island, the generations in
    which it found a lower error, with that error. A known equation is the only member of its front, and `why` is
    `KNOWN`.
    """

    variable: str
    front: tuple[FrontEntry, ...]
    epoch: int
    generation: int | None = None
    evaluations: Mapping[str, int] = field(default_factory=dict)
    seconds: float = 0.0
    why: str | None = None
    refined: Refined | None = None
    runners_up: tuple[FrontEntry, ...] = ()
    convergence: Mapping[int, Sequence[tuple[int, float]]] = field(default_factory=dict)


@dataclass(frozen=True)
class Account:
    """What a result says of the job as a whole.

    `seconds` is the time since the job was submitted, `search_seconds` from the first epoch's start to the last needed
    epoch's end; `reason` says why a job failed.
    """

    state: JobState
    seconds: float
    search_seconds: float
    reason: str | None = None


def build_result(
    job: str,
    config: JobConfig,
    preparation: Preparation,
    outcomes: Sequence[VariableOutcome],
    account: Account,
    refinement: Refinement | None = None,
) -> Result:
    """Return the result of `job`; also the best so far while it runs.

    Args:
        job: the job's id.
        config: the configuration that was run.
        preparation: its dataset supplies names, left-hand sides, scales and warnings.
        outcomes: one for each equation, in the dataset's order.
        account: state and times.
        refinement: what belongs to the model as a whole; what belongs to one equation is in its outcome.
    """
    dataset, model, recording = preparation.dataset, refinement or Refinement(), preparation.recording
    warnings = (*dataset.warnings, *model.warnings, *_of_groups(preparation, model, account.state))
    notes = {*dataset.notes, *model.notes}
    return Result(
        job=job,
        seed=config.seed,
        preset=config.preset,
        state=account.state,
        reason=account.reason,
        equations=tuple(_equation(config, preparation, outcome, account.state) for outcome in outcomes),
        shared_terms=_shared_terms(config, dataset, outcomes, account.state, model),
        noise=noise(recording, model.errors),
        smoothing=smoothing(recording),
        correlations=correlations(model.correlations),
        covariance=covariance(model.covariance),
        groups=groups(recording, model.by_group),
        simulation=simulation(model.simulation, preparation),
        chaos=chaos(model.chaos),
        process=process(model.process, preparation.process),
        regression=regression(preparation, _first_program(outcomes, dataset, config)),
        symbols=dict(dataset.symbols),
        system=system(preparation),
        data=data(preparation, has_trajectories=account.state in FINAL_STATES),
        config=settings(config),
        refining=model.end if account.state in ("done", "cancelled") else None,
        warnings=tuple(map(str, warnings)),
        notes=tuple(sentence for sentence in dict.fromkeys(map(str, warnings)) if sentence in notes),
        point_evaluations=sum(_total(outcome) for outcome in outcomes),
        search_seconds=finite(account.search_seconds),
        seconds=finite(account.seconds),
        digest=result_digest([outcome for outcome in outcomes if outcome.why != KNOWN] or outcomes),
        versions=dict(versions()),
    )


def _of_groups(preparation: Preparation, model: Refinement, state: JobState) -> list[str]:
    """Return what is to be said where constants were to be fitted by group and were not."""
    recording = preparation.recording
    is_lacking = recording is not None and recording.groups and not model.by_group
    return [NOT_BY_GROUP] if is_lacking and state in FINAL_STATES else []


def _shared_terms(
    config: JobConfig, dataset: Dataset, outcomes: Sequence[VariableOutcome], state: JobState, model: Refinement
) -> tuple[findings.SharedTerm, ...]:
    """Return the terms that equations have in common, none as long as these may change."""
    if state not in FINAL_STATES or len(outcomes) < 2:
        return ()
    shown = {outcome.variable: equation_of(outcome, dataset, config) for outcome in outcomes}
    equations = {name: refined for name, refined in shown.items() if refined is not None}
    return shared_terms(equations, dataset.names, model.shared_terms)


def versions() -> dict[str, str | int]:
    """Return the versions of everything that can matter to a result."""
    version_by_name: dict[str, str | int] = {
        "atoll": VERSION,
        "engine": ENGINE_REVISION,
        "protocol": PROTOCOL_VERSION,
        "python": platform.python_version(),
    }
    return version_by_name | {package: _version(package) for package in _PACKAGES}


@cache
def _version(package: str) -> str:
    """Return the version of an installed package; it stays as it is while we run."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "unknown"


def _equation(config: JobConfig, given: Preparation, outcome: VariableOutcome, state: JobState) -> parts.Equation:
    dataset = given.dataset
    target = dataset.problem(outcome.variable).target
    problem = (given.counted or dataset).problem(outcome.variable)
    shown = equation_of(outcome, dataset, config)
    member = None if shown is None else shown.member
    has_trajectories = given.recording is not None
    judged = verdict(shown, problem, state, has_trajectories=has_trajectories, why=outcome.why, weights=given.weights)
    described = {} if shown is None else _best(shown, dataset, target, config)
    return parts.Equation.model_validate(
        {
            "variable": target.variable,
            "lhs": target.lhs,
            "expression": None if shown is None else to_infix(shown.program, dataset.names),
            "converged": False,
            **described,
            "verdict": None if judged is None else judged.grade,
            "reason": None if judged is None else judged.reason,
            "checks": () if judged is None else checks(judged.checks),
            "epoch": outcome.epoch,
            "generation": _generation(None if member is None else outcome.front[member], outcome, config),
            "point_evaluations": _total(outcome),
            "point_evaluations_by_part": {part: int(outcome.evaluations[part]) for part in sorted(outcome.evaluations)},
            "seconds": finite(outcome.seconds),
            "why": outcome.why,
            "bounds": _bounds(shown, dataset, config, target.variable),
            "derivative_floor": finite(target.uncertainty),
            "target_error": target.convergence_threshold(config.budget.target_error),
            "prediction": prediction(None if shown is None else shown.prediction),
            "convergence": _convergence(outcome, target),
            "candidates": candidates(shown.alternatives if shown is not None else (), dataset),
            "front": _front(config, given, outcome, member),
        }
    )


def _front(
    config: JobConfig, given: Preparation, outcome: VariableOutcome, selected: int | None
) -> tuple[parts.Member, ...]:
    dataset = given.dataset
    target = dataset.problem(outcome.variable).target
    unseen = given.held_out.problem(outcome.variable) if given.held_out is not None else None
    return tuple(
        parts.Member(
            expression=to_infix(program, dataset.names),
            complexity=len(program),
            error=finite(entry.error),
            normalized_error=finite(_normalized(entry.error, target)),
            r2=_r2(entry.mse, target),
            constants=_constants(program),
            holdout_error=_unseen_error(program, unseen, config.evolution.loss),
            selected=is_selected,
        )
        for entry, program, is_selected in _written_front(outcome, dataset, selected)
    )


def _normalized(error: float, target: Target) -> float:
    return error / target.standard_deviation if target.standard_deviation else math.inf


def equation_of(outcome: VariableOutcome, dataset: Dataset, config: JobConfig) -> Refined | None:
    """Return the equation that is shown: the refined one, before that the selected member of the front as it stands.

    None when there is no member that can be printed.
    """
    if outcome.refined is not None:
        return outcome.refined
    target = dataset.problem(outcome.variable).target
    printable = [index for index, entry in enumerate(outcome.front) if _is_printable(entry, dataset)]
    if not printable:
        return None
    front = [outcome.front[index] for index in printable]
    member = printable[select_member(front, len(target.values), target, config.budget.target_error)]
    entry = outcome.front[member]
    origin: Origin = "known" if outcome.why == KNOWN else "front"
    return Refined(member, _written(entry, outcome, dataset), entry.error, entry.mse, origin=origin)


def _first_program(outcomes: Sequence[VariableOutcome], dataset: Dataset, config: JobConfig) -> Program | None:
    shown = equation_of(outcomes[0], dataset, config) if outcomes else None
    return None if shown is None else shown.program


def _written_front(
    outcome: VariableOutcome, dataset: Dataset, selected: int | None
) -> list[tuple[FrontEntry, Program, bool]]:
    """Return the members that can be printed in their shortest writing, by rising complexity and falling error.

    Of members of one structure the most accurate stays, and is the selected one if any of them is.
    """
    best: dict[bytes, tuple[FrontEntry, Program, bool]] = {}
    for index, entry in enumerate(outcome.front):
        if _is_printable(entry, dataset):
            program = _written(entry, outcome, dataset)
            member = best.get(structure(program), (entry, program, False))
            nearer = (entry, program) if entry.error < member[0].error else member[:2]
            best[structure(program)] = (*nearer, member[2] or index == selected)
    members: list[tuple[FrontEntry, Program, bool]] = []
    for member in sorted(best.values(), key=lambda candidate: (len(candidate[1]), candidate[0].error)):
        if member[2] or all(member[0].error < predecessor[0].error for predecessor in members):
            members.append(member)
    return members


def _written(entry: FrontEntry, outcome: VariableOutcome, dataset: Dataset) -> Program:
    """Return the shortest writing of a member; a known equation as it was given."""
    program = _program(entry, dataset)
    return program if outcome.why == KNOWN else shortest_at(program, lambda: _points(dataset))


def _points(dataset: Dataset) -> FloatArray:
    """Return points of the box of a dataset; they are looked for in all its rows once."""
    points = _POINTS.get(dataset)
    if points is None:
        points = _POINTS[dataset] = points_of(dataset.inputs)
    return points


def _is_printable(entry: FrontEntry, dataset: Dataset) -> bool:
    return is_printable(entry.program, len(dataset.names))


@lru_cache(maxsize=4096)
def is_printable(program: bytes, inputs: int) -> bool:
    """Tell whether an equation, written out, has a length that anybody could read."""
    return tree_size(Program.from_bytes(program, inputs)) <= PRINTABLE_SIZE


def _best(shown: Refined, dataset: Dataset, target: Target, config: JobConfig) -> dict[str, object]:
    """Return what is said of the equation that is shown, by field."""
    normalized = _normalized(shown.error, target)
    return {
        "program": shown.program.to_bytes().hex(),
        "origin": shown.origin,
        "complexity": len(shown.program),
        "error": finite(shown.error),
        "normalized_error": finite(normalized),
        "r2": _r2(shown.mse, target),
        "converged": normalized <= target.convergence_threshold(config.budget.target_error),
        "constants": _constants(shown.program, shown.constants, shown),
        "simple_together": _together(shown.simple_together),
        "units": _units(shown),
        "groups": _groups(shown, dataset),
        "implied": tuple(
            _estimate(parts.ImpliedConstant, factor.constant, of=to_infix(factor.of, dataset.names))
            for factor in shown.unit_coefficients
        ),
    }


def _generation(entry: FrontEntry | None, outcome: VariableOutcome, config: JobConfig) -> int | None:
    """Return the generation in which the equation was found."""
    if outcome.generation is None and entry is not None and outcome.why != KNOWN:
        return entry.epoch * config.migration.generations + entry.generation
    return outcome.generation


def _convergence(outcome: VariableOutcome, target: Target) -> tuple[parts.Convergence, ...]:
    """Return by island the generations in which its error fell, at most `MOST_STEPS`, and the normalized errors."""
    courses = []
    for island, steps in sorted(outcome.convergence.items()):
        chosen = [steps[index] for index in thinned(len(steps), MOST_STEPS)]
        errors = np.array([error for _, error in chosen]) / (target.standard_deviation or math.nan)
        generations = tuple(step for step, _ in chosen)
        courses.append(parts.Convergence(island=island, generations=generations, errors=curve(errors)))
    return tuple(courses)


def _r2(mse: float, target: Target) -> float | None:
    """Return the share of the target's variance that a mean squared error leaves explained; None if that is unknown."""
    variance = target.standard_deviation * target.standard_deviation
    return finite(1.0 - mse / variance if variance else math.nan)


def _unseen_error(program: Program, unseen: Problem | None, loss: Loss) -> float | None:
    """Return the loss on held-out rows; None when there are none, or when it is not finite."""
    return finite(errors_on(unseen, program, loss)[0]) if unseen is not None else None


def _constants(
    program: Program, known: Sequence[Constant] = (), shown: Refined | None = None
) -> tuple[parts.Constant, ...]:
    """Return the constants in node order; `known` is what refinement knows of them, if there was any.

    Of the equation that is `shown`, also their units and which of them all groups of trajectories have in common.
    """
    values = program.constants[program.operators == np.int8(CONSTANT)].tolist()
    pairs = zip(values, known or map(Constant, values), strict=True)
    shared = shown.shared if shown is not None else ()
    units = shown.units.constants if shown is not None and shown.units is not None else ()
    return tuple(
        _estimate(
            parts.Constant,
            replace(constant, value=value),
            shared=shared[place] if shared else None,
            unit=str(units[place]) if units and units[place] is not None else None,
        )
        for place, (value, constant) in enumerate(pairs)
    )


def _units(shown: Refined) -> parts.Units | None:
    """Return what units say of an equation beside those of its constants; None where no unit is known."""
    if shown.units is None:
        return None
    implied = tuple(parts.ImpliedUnit(of=term, unit=str(unit)) for term, unit in shown.units.implied)
    return parts.Units(implied=implied, faults=tuple(shown.units.faults))


def _groups(shown: Refined, dataset: Dataset) -> tuple[parts.GroupEquation, ...]:
    """Return the equation of each group of trajectories, where these may differ in constants."""
    return tuple(
        parts.GroupEquation(
            group=equation.group,
            expression=to_infix(equation.program, dataset.names),
            program=equation.program.to_bytes().hex(),
            constants=_constants(equation.program, equation.constants, shown),
        )
        for equation in shown.by_group
    )


def _estimate(kind: type[EstimateT], constant: Constant, **more: object) -> EstimateT:
    """Return what is known of a constant as this kind of estimate, with the fields that only that kind has."""
    known = {
        "value": finite(constant.value),
        "std_error": finite(constant.std_error),
        "fitted": finite(constant.fitted),
        "interval": _pair(constant.interval),
        "identifiable": constant.identifiable,
        "simple": None if constant.simple is None else _simple(constant.simple),
        "bounds": _pair(constant.bounds),
        "at_bound": constant.is_at_bound,
    }
    return kind.model_validate({**known, **more})


def _pair(ends: tuple[float, float] | None) -> tuple[float | None, float | None] | None:
    return None if ends is None else (finite(ends[0]), finite(ends[1]))


def _bounds(shown: Refined | None, dataset: Dataset, config: JobConfig, variable: str) -> tuple[parts.Bound, ...]:
    """Return the bounds that the user has set, with the numbers of the equation that each is about."""
    bounds = restrictions_of(config, variable, dataset.names).bounds
    if shown is None or bounds is None:
        return ()
    return tuple(
        parts.Bound(
            bound=governed_bound.bound.text,
            values=tuple(map(finite, governed_bound.values)),
            active=governed_bound.is_active,
        )
        for governed_bound in bounds.governed(shown.program)
    )


def _simple(simple: SimpleNumber) -> parts.SimpleNumber:
    return parts.SimpleNumber(
        value=simple.value, odds=finite(simple.odds), standard_errors=finite(simple.standard_errors)
    )


def _together(together: SimpleTogether | None) -> parts.SimpleTogether | None:
    if together is None:
        return None
    return parts.SimpleTogether(
        constants=together.constants,
        values=tuple(map(finite, together.values)),
        odds=finite(together.odds),
        chi_square=finite(together.chi_square),
    )


def _program(entry: FrontEntry, dataset: Dataset) -> Program:
    return Program.from_bytes(entry.program, len(dataset.names))


def _total(outcome: VariableOutcome) -> int:
    return int(sum(outcome.evaluations.values()))
