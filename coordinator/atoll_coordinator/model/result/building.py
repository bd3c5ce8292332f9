"""Builds the result of a job from the outcome of the search and of refining; docs/result.md explains its keys.

`build_result` decides everything in result.json. `select_shown_equation` chooses the equation that is shown: the
refined equation, or a member of the front. `_judge_equation` decides its grade and the reason, and `_list_front` the
members that are listed. Programs become text with the names and units of the columns.

Doubtful: an equation that refining did not judge is judged here, by its error on the target alone, when a client asks
for the result. `result_digest` covers the search only: results with equal digests can differ in refined equations.
"""

import hashlib
import math
import platform
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Final
from weakref import WeakKeyDictionary

import numpy as np

from atoll_coordinator.data.recording import Preparation
from atoll_coordinator.data.templates import template_of
from atoll_coordinator.model.pools import Origin
from atoll_coordinator.model.refinement import Alternative, ObservedColumn, Refined, Refinement
from atoll_coordinator.model.regression.errors import measure_errors
from atoll_coordinator.model.result.shared_terms import find_shared_terms
from atoll_coordinator.model.result.tables import (
    describe_data,
    describe_noise,
    describe_regression,
    describe_smoothing,
    describe_system,
)
from atoll_coordinator.model.selection.front_member import select_shortest_description
from atoll_coordinator.model.thinning import curve, spread_places
from atoll_coordinator.result.base import finite
from atoll_coordinator.result.equations import (
    Bound,
    Candidate,
    Constant,
    Convergence,
    DemandedShape,
    Equation,
    Estimate,
    GivenSide,
    GroupEquation,
    ImpliedConstant,
    ImpliedUnit,
    Member,
    Observation,
    Units,
    UnknownPart,
)
from atoll_coordinator.result.findings import Group, SharedTerm
from atoll_coordinator.result.result import Result
from atoll_core import ENGINE_REVISION, PROTOCOL_VERSION, VERSION
from atoll_core.config import JobConfig
from atoll_core.data.dataset import Dataset, FloatArray, Target
from atoll_core.data.notes import notes_of
from atoll_core.expression.program import Program, constant_places, structure, tree_size
from atoll_core.expression.restrictions import equation_shapes, restrictions_of
from atoll_core.expression.shapes import shape_points
from atoll_core.expression.template import ZERO
from atoll_core.expression.text.infix import PRINTABLE_SIZE, to_infix
from atoll_core.expression.writing.shortest import points_of, shortest_at
from atoll_core.search.pareto import FrontEntry
from atoll_core.wire.messages.views import FINAL_STATES, JobState

if TYPE_CHECKING:
    from atoll_coordinator.model.inference.checks import EquationChecks
    from atoll_coordinator.model.inference.verdict import Verdict

KNOWN: Final = "known"
"""The value of `VariableOutcome.why` if there was no search, because the user gave the equation."""
_ADVICE_AFTER_STOP: Final = {
    "max-time": "the time limit stopped the search before it converged or stagnated: give more time with --max-time",
    "max-epochs": "the search ended with its last epoch before it converged or stagnated: allow more with --max-epochs",
    "cancelled": "the search was cancelled before it converged or stagnated: let it run longer",
}
"""The sentence about a search that was stopped early, by the reason why it ended."""
MOST_STEPS: Final = 40
"""Most listed improvements of one island."""
MOST_CANDIDATES: Final = 20
NOT_BY_GROUP: Final = (
    "Constants by group were not fitted. The constants shown were fitted to all groups of trajectories together, and "
    "--group cannot choose a group."
)

_POINTS: Final[WeakKeyDictionary[Dataset, FloatArray]] = WeakKeyDictionary()

_PACKAGES: Final = ("eclipse-zenoh", "numpy", "numba", "scipy", "sympy", "msgpack", "pydantic", "polars")


@dataclass(frozen=True)
class VariableOutcome:
    """The state of the search for one equation, or how it ended.

    The numbers include the last completely reported epoch, or the slice of generations in which the search stopped.
    `front` is the merged front, by rising complexity. `epoch` is the number of completely reported epochs (0: none
    yet). `generation` is the generation that reached the target error, counted from the start of the search; None: no
    generation has reached it. `evaluations` are the cumulative point evaluations by part, for all islands together.
    `seconds` is the time from the start of the first epoch to the end of the last counted epoch. `why` is the reason
    for the end of the search (None: the search still runs), as in `atoll_core.wire.messages.views.VariableView`.
    `runners_up` are the next best programs. `convergence` has, for each island, the generations in which the island
    found a lower error, and this error. A known equation is the only member of its front, and `why` is `KNOWN`.
    """

    variable: str
    front: tuple[FrontEntry, ...]
    epoch: int
    generation: int | None = None
    evaluations: Mapping[str, int] = field(default_factory=dict)
    seconds: float = 0.0
    why: str | None = None
    refined: None = None  # always None; the field remains because it is part of the serialised task
    runners_up: tuple[FrontEntry, ...] = ()
    convergence: Mapping[int, Sequence[tuple[int, float]]] = field(default_factory=dict)


@dataclass(frozen=True)
class Account:
    """The state of the whole job, and its times.

    `seconds` is the time since the job was submitted. `search_seconds` is the time from the start of the first epoch to
    the end of the last epoch that counts. `reason` says why a job failed.
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
    """Return the result of `job`. While the job runs, this is the best result so far.

    Args:
        job: the job's id.
        config: the configuration of the job.
        preparation: its dataset supplies names, left-hand sides, scales and warnings.
        outcomes: one outcome for each equation, in the order of the dataset.
        account: state and times of the job.
        refinement: the refined equations, and the findings on the model as a whole; None if there are none yet.
    """
    dataset, model, recording = preparation.dataset, refinement or Refinement(), preparation.recording
    is_final, by_run = account.state in FINAL_STATES, config.prior.by_run
    warnings = [*dataset.warnings, *model.warnings]
    if is_final and recording is not None and recording.groups and not model.by_group:
        warnings.append(NOT_BY_GROUP)
    notes = {*dataset.notes, *notes_of(model.warnings)}
    shown = {
        one.variable: select_shown_equation(one, model.equations.get(one.variable), dataset, config) for one in outcomes
    }
    shown = _complete_sides(shown, preparation, config)
    known = {name: equation for name, equation in shown.items() if equation is not None}
    first = next(iter(shown.values()), None)
    shared: tuple[SharedTerm, ...] = ()
    if is_final and len(outcomes) > 1:
        shared = find_shared_terms(known, dataset.names, model.fluxes)
    return Result(
        job=job,
        seed=config.seed,
        preset=config.preset,
        state=account.state,
        reason=account.reason,
        equations=tuple(
            _describe_equation(config, preparation, outcome, shown[outcome.variable], account.state)
            for outcome in outcomes
        ),
        shared_terms=shared,
        observations=tuple(
            _describe_observation(name, config.data.observe[name], one, dataset.names)
            for name, one in model.observations.items()
        ),
        hidden=() if recording is None else tuple(name for name in recording.hidden if name not in by_run),
        noise={name: one for name, one in describe_noise(recording, model.errors).items() if name not in by_run},
        smoothing=describe_smoothing(recording),
        correlations=model.correlations,
        covariance=model.covariance,
        groups=tuple(
            Group(
                group=name,
                trajectories=tuple(part.name for part in recording.trajectories if part.group == name),
                covariance=model.by_group.get(name),
            )
            for name in (recording.groups if recording is not None else ())
            if recording is not None
        ),
        simulation=model.simulation,
        chaos=model.chaos,
        process=model.process,
        regression=describe_regression(preparation, None if first is None else first.program),
        symbols=dict(dataset.symbols),
        system=describe_system(preparation),
        data=describe_data(preparation, has_trajectories=is_final),
        config=config.model_dump(mode="json", exclude_defaults=True),
        refining=model.end if account.state in ("done", "cancelled") else None,
        warnings=tuple(map(str, warnings)),
        notes=tuple(sentence for sentence in dict.fromkeys(map(str, warnings)) if sentence in notes),
        point_evaluations=sum(_total_evaluations(outcome) for outcome in outcomes),
        search_seconds=account.search_seconds,
        seconds=account.seconds,
        digest=result_digest([outcome for outcome in outcomes if outcome.why != KNOWN] or outcomes),
        versions=dict(versions()),
    )


def versions() -> dict[str, str | int]:
    """Return the versions of all programs and packages that can affect a result."""
    version_by_name: dict[str, str | int] = {
        "atoll": VERSION,
        "engine": ENGINE_REVISION,
        "protocol": PROTOCOL_VERSION,
        "python": platform.python_version(),
    }
    return version_by_name | {package: _version(package) for package in _PACKAGES}


@cache
def _version(package: str) -> str:
    """Return the version of an installed package; it is read once per process."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "unknown"


# ---------------------------------------------------------------------------------------------------- one equation


def _describe_equation(
    config: JobConfig, preparation: Preparation, outcome: VariableOutcome, shown: Refined | None, state: JobState
) -> Equation:
    dataset = preparation.dataset
    target = dataset.problem(outcome.variable).target
    threshold = target.convergence_threshold(config.budget.target_error)
    verdict = None if state not in FINAL_STATES else _judge_equation(preparation, outcome, shown, state)
    equation = Equation(
        variable=target.variable,
        lhs=target.lhs,
        expression=None,
        converged=False,
        verdict=None if verdict is None else verdict.grade,
        reason=None if verdict is None else verdict.reason,
        checks=() if verdict is None else verdict.checks,
        epoch=outcome.epoch,
        generation=outcome.generation,
        point_evaluations=_total_evaluations(outcome),
        point_evaluations_by_part={part: int(outcome.evaluations[part]) for part in sorted(outcome.evaluations)},
        seconds=outcome.seconds,
        why=outcome.why,
        derivative_floor=target.uncertainty,
        target_error=threshold,
        convergence=_describe_convergence(outcome, target),
        front=_list_front(config, preparation, outcome, None if shown is None else shown.member),
    )
    if shown is None:
        return equation
    if outcome.generation is None and shown.member is not None and outcome.why != KNOWN:
        entry = outcome.front[shown.member]
        equation = equation.replaced(generation=entry.epoch * config.migration.generations + entry.generation)
    normalized, names, estimate = target.normalized(shown.error), dataset.names, Estimate.model_fields
    bounds = restrictions_of(config, target.variable, names).bounds
    shapes = _describe_shapes(config, dataset, target.variable, shown)
    if verdict is not None and shapes:
        equation = equation.replaced(reason=f"{verdict.reason} {_demand(shapes, config, target.variable)}")
    return equation.replaced(
        expression=to_infix(shown.program, names),
        program=shown.program.to_bytes().hex(),
        origin=shown.origin,
        complexity=len(shown.program),
        error=shown.error,
        normalized_error=normalized,
        r2=target.r2(shown.mse),
        converged=normalized <= threshold,
        constants=_describe_constants(shown.program, shown.constants, shown),
        given=_describe_given(config.prior.equations.get(target.variable), shown, names),
        simple_together=shown.simple_together,
        units=_describe_units(shown),
        groups=tuple(
            GroupEquation(
                group=group,
                expression=to_infix(program, names),
                program=program.to_bytes().hex(),
                constants=_describe_constants(program, constants, shown),
            )
            for group, (program, constants) in shown.by_group.items()
        ),
        implied=tuple(
            ImpliedConstant(
                of=to_infix(factor.of, names),
                **{name: getattr(factor.constant, name) for name in estimate},
            )
            for factor in shown.unit_coefficients
        ),
        runs=shown.runs,
        bounds=tuple(
            Bound(bound=one.bound.text, values=tuple(map(finite, one.values)), active=one.is_active)
            for one in (() if bounds is None else bounds.governed(shown.program))
        ),
        shapes=shapes,
        prediction=shown.prediction,
        candidates=_list_candidates(shown.alternatives, names),
    )


def _judge_equation(
    preparation: Preparation, outcome: VariableOutcome, shown: Refined | None, state: JobState
) -> "Verdict":
    """Return the verdict on an equation of a job that has ended.

    If refining did not judge the equation, its error on the target decides. If there are trajectories, the grade is
    then at best `doubtful`: the equation was not simulated along the trajectories, because this failed or because there
    was no time.
    """
    # These modules load kernels. The server needs these modules only for jobs that were not refined.
    from atoll_coordinator.model.inference.target_checks import TargetChecks
    from atoll_coordinator.model.inference.trajectory_checks import UnsimulatedChecks
    from atoll_coordinator.model.inference.verdict import Verdict, add_objection, judge

    if shown is None:
        return Verdict("no model", "The search has found no equation.", ())
    why, has_trajectories = outcome.why, preparation.recording is not None
    if shown.grade is not None:
        verdict = Verdict(shown.grade, shown.reason or "", shown.checks)
    else:
        problem = (preparation.counted or preparation.dataset).problem(outcome.variable)
        is_known, is_cancelled = why == KNOWN, "cancelled" in (why, state)
        stopped = "the choice of the equation" if is_cancelled or why == "max-time" else ""
        if has_trajectories:
            checks: EquationChecks = UnsimulatedChecks(
                shown, problem.target, is_known=is_known, stopped=stopped, is_cancelled=is_cancelled
            )
        else:
            checks = TargetChecks(
                shown, problem, preparation.weights, is_known=is_known, stopped=stopped, is_cancelled=is_cancelled
            )
        verdict = judge(checks)
    if verdict.grade in ("exact", "good") and shown.units is not None and shown.units.faults:
        verdict = add_objection(verdict, "units", "failed", f"units contradict it: {shown.units.faults[0]}")
    if verdict.grade == "good" and why in _ADVICE_AFTER_STOP and not (has_trajectories and why == "max-epochs"):
        verdict = add_objection(verdict, "search", "not made", _ADVICE_AFTER_STOP[why])
    return verdict


def select_shown_equation(
    outcome: VariableOutcome, refined: Refined | None, dataset: Dataset, config: JobConfig
) -> Refined | None:
    """Return the equation that is shown: the `refined` equation if there is one, or else the selected member of the
    front.

    None if no member can be printed.
    """
    if refined is not None:
        return refined
    target = dataset.problem(outcome.variable).target
    printable = [index for index, entry in enumerate(outcome.front) if is_printable(entry.program, len(dataset.names))]
    if not printable:
        return None
    front = [outcome.front[index] for index in printable]
    member = printable[select_shortest_description(front, len(target.values), target, config.budget.target_error)]
    entry = outcome.front[member]
    origin: Origin = "known" if outcome.why == KNOWN else "front"
    return Refined(member, _write_member(entry, outcome, dataset), entry.error, entry.mse, origin=origin)


def _describe_constants(
    program: Program, known: Sequence[Constant] = (), shown: Refined | None = None
) -> tuple[Constant, ...]:
    """Return the constants in node order with the values of the program and the units of the equation `shown`.

    `known` are the constants with errors from refining; it is empty if there was no refining.
    """
    values = program.constants[constant_places(program)].tolist()
    units = shown.units.constants if shown is not None and shown.units is not None else ()
    return tuple(
        constant.replaced(value=value, unit=str(units[place]) if units and units[place] is not None else None)
        for place, (value, constant) in enumerate(zip(values, known or [Constant()] * len(values), strict=True))
    )


def _complete_sides(
    shown: Mapping[str, Refined | None], preparation: Preparation, config: JobConfig
) -> dict[str, Refined | None]:
    """Return the equations; a side of the template whose unknown part was not refined is completed.

    Its parameters have the values by the derivatives, and unknown parts that were not found are 0.
    """
    template = template_of(config, preparation.dataset.names)
    if not template.sides:
        return dict(shown)
    slots = [ZERO if one is None or one.parameters else one.program for one in shown.values()]
    values = np.array(preparation.parameters) if preparation.parameters else template.starts
    template = replace(template, equations=tuple(shown))
    composition = template.compose(slots, values)
    completed = dict(shown)
    for index, (name, equation) in enumerate(shown.items()):
        if equation is None or equation.parameters or equation.unknowns or name not in template.sides:
            continue
        completed[name] = replace(
            equation,
            program=composition.programs[index],
            constants=(),
            parameters=template.parameter_names(composition.sources(index)),
            unknowns=template.parts_of(name, slots),
            unit_coefficients=(),
            units=None,  # the units found are those of the unknown part
        )
    return completed


def _describe_shapes(config: JobConfig, dataset: Dataset, variable: str, shown: Refined) -> tuple[DemandedShape, ...]:
    """Return the shapes that the user demanded of an equation or of its unknown part; empty without a demand."""
    unknown = template_of(config, dataset.names).unknown_of(variable)
    program = shown.program if unknown is None else shown.unknowns.get(unknown.label, shown.program)
    points = shape_points(dataset.inputs)
    return tuple(
        DemandedShape(shape=text, kept=equation_shapes([text], dataset.names).are_kept(program, points))
        for text in config.prior.shapes_of(variable)
    )


def _demand(shapes: Sequence[DemandedShape], config: JobConfig, variable: str) -> str:
    """Return the sentence of a verdict that names the demanded shapes."""
    owner = "the unknown part" if variable in config.prior.equations else "this equation"
    texts = "; ".join(one.shape for one in shapes)
    left = ", ".join(one.shape for one in shapes if not one.kept)
    return f"The shape of {owner} was demanded, not found: {texts}{f' (not kept: {left})' if left else ''}."


def _describe_given(text: str | None, shown: Refined, names: Sequence[str]) -> GivenSide | None:
    """Return the side that the user gave with ``--equation``; None without one, and before refining."""
    if text is None or not (shown.parameters or shown.unknowns):
        return None
    return GivenSide(
        text=text,
        parameters={name: place for place, name in enumerate(shown.parameters) if name is not None},
        unknowns=tuple(
            UnknownPart(label=label, expression=to_infix(program, names), program=program.to_bytes().hex())
            for label, program in shown.unknowns.items()
        ),
    )


def _describe_observation(name: str, text: str, observed: ObservedColumn, names: Sequence[str]) -> Observation:
    """Return a measured column that is computed from states."""
    parameters = {called: place for place, called in enumerate(observed.parameters) if called is not None}
    return Observation(
        column=name,
        expression=to_infix(observed.program, names),
        program=observed.program.to_bytes().hex(),
        constants=_describe_constants(observed.program, observed.constants),
        given=GivenSide(text=text, parameters=parameters),
    )


def _describe_units(shown: Refined) -> Units | None:
    """Return the units that follow for an equation, and the contradictions between units. None if no unit is known."""
    if shown.units is None:
        return None
    implied = tuple(ImpliedUnit(of=term, unit=str(unit)) for term, unit in shown.units.implied)
    return Units(implied=implied, faults=tuple(shown.units.faults))


def _list_candidates(alternatives: Sequence[Alternative], names: Sequence[str]) -> tuple[Candidate, ...]:
    """Return the shown equation, then the best alternatives, and all guesses."""
    printable = [alternative for alternative in alternatives if tree_size(alternative.program) <= PRINTABLE_SIZE]
    ordered = sorted(printable, key=lambda alternative: (not alternative.is_shown, alternative.nats))
    return tuple(
        Candidate(
            expression=to_infix(alternative.program, names),
            complexity=len(alternative.program),
            nats=alternative.nats,
            r2=alternative.r2,
            held_out_r2=alternative.held_out_r2,
            cross_validated=alternative.is_cross_validated,
            origin=alternative.origin,
            selected=alternative.is_shown,
            unknown=None if alternative.unknown is None else to_infix(alternative.unknown, names),
            parameters=dict(alternative.parameters),
        )
        for place, alternative in enumerate(ordered)
        if place < MOST_CANDIDATES or alternative.origin == "guess"
    )


# ---------------------------------------------------------------------------------------------- the search behind it


def _list_front(
    config: JobConfig, preparation: Preparation, outcome: VariableOutcome, selected: int | None
) -> tuple[Member, ...]:
    """Return the printable members in their shortest form, by rising complexity and falling error.

    If several members have the same structure, only the most accurate of them is listed. It is marked as selected if
    one of these members was selected.
    """
    dataset = preparation.dataset
    best: dict[bytes, tuple[FrontEntry, Program, bool]] = {}
    for index, entry in enumerate(outcome.front):
        if is_printable(entry.program, len(dataset.names)):
            program = _write_member(entry, outcome, dataset)
            member = best.get(structure(program), (entry, program, False))
            nearer = (entry, program) if entry.error < member[0].error else member[:2]
            best[structure(program)] = (*nearer, member[2] or index == selected)
    members: list[tuple[FrontEntry, Program, bool]] = []
    for member in sorted(best.values(), key=lambda candidate: (len(candidate[1]), candidate[0].error)):
        if member[2] or all(member[0].error < predecessor[0].error for predecessor in members):
            members.append(member)
    target = dataset.problem(outcome.variable).target
    held_out_problem = preparation.held_out.problem(outcome.variable) if preparation.held_out is not None else None
    return tuple(
        Member(
            expression=to_infix(program, dataset.names),
            complexity=len(program),
            error=entry.error,
            normalized_error=target.normalized(entry.error),
            r2=target.r2(entry.mse),
            constants=_describe_constants(program),
            holdout_error=None
            if held_out_problem is None
            else measure_errors(held_out_problem, program, config.evolution.loss)[0],
            selected=is_selected,
        )
        for entry, program, is_selected in members
    )


def _write_member(entry: FrontEntry, outcome: VariableOutcome, dataset: Dataset) -> Program:
    """Return the shortest form of a member. A known equation is returned unchanged."""
    program = Program.from_bytes(entry.program, len(dataset.names))
    return program if outcome.why == KNOWN else shortest_at(program, lambda: _sampled_points(dataset))


def _sampled_points(dataset: Dataset) -> FloatArray:
    """Return points of the box of a dataset, computed once from all its rows."""
    points = _POINTS.get(dataset)
    if points is None:
        points = _POINTS[dataset] = points_of(dataset.inputs)
    return points


@lru_cache(maxsize=4096)
def is_printable(program: bytes, inputs: int) -> bool:
    """Tell whether an equation is short enough to be printed."""
    return tree_size(Program.from_bytes(program, inputs)) <= PRINTABLE_SIZE


def _describe_convergence(outcome: VariableOutcome, target: Target) -> tuple[Convergence, ...]:
    """Return, for each island, the generations in which its error decreased (at most `MOST_STEPS`), and the normalized
    errors."""
    courses = []
    for island, steps in sorted(outcome.convergence.items()):
        chosen = [steps[index] for index in spread_places(len(steps), MOST_STEPS)]
        errors = np.array([error for _, error in chosen]) / (target.standard_deviation or math.nan)
        generations = tuple(step for step, _ in chosen)
        courses.append(Convergence(island=island, generations=generations, errors=curve(errors)))
    return tuple(courses)


def _total_evaluations(outcome: VariableOutcome) -> int:
    return int(sum(outcome.evaluations.values()))


# ------------------------------------------------------------------------------------------------------------ digest


def result_digest(outcomes: Sequence[VariableOutcome]) -> str:
    """Return the hex digest (sha256) of the outcomes, in their order. Equal digests mean equal results of the searches.

    The digest covers epochs, counters, fronts and runners-up, with every bit of their constants and errors. It does not
    cover times, the number of workers, or refining. For a job without a search, the digest covers the known equations
    with their errors on the data.
    """
    digest = hashlib.sha256()
    for outcome in outcomes:
        _update(digest, outcome.variable.encode())
        _update(digest, struct.pack("<qq", outcome.epoch, -1 if outcome.generation is None else outcome.generation))
        for part in sorted(outcome.evaluations):
            _update(digest, part.encode() + struct.pack("<q", outcome.evaluations[part]))
        _update(digest, struct.pack("<q", len(outcome.front)))
        for entry in outcome.front:
            _update(digest, _entry_bytes(entry))
        if outcome.runners_up:
            _update(digest, b"runners-up" + struct.pack("<q", len(outcome.runners_up)))
        for entry in outcome.runners_up:
            _update(digest, _entry_bytes(entry))
    return digest.hexdigest()


def _entry_bytes(entry: FrontEntry) -> bytes:
    numbers = struct.pack(
        "<qddqqq", entry.complexity, entry.error, entry.mse, entry.epoch, entry.generation, entry.island
    )
    return numbers + entry.program


def _update(digest: "hashlib._Hash", data: bytes) -> None:
    """Add the length of `data`, then `data`. With the lengths, different lists of parts never give the same bytes."""
    digest.update(struct.pack("<q", len(data)))
    digest.update(data)
