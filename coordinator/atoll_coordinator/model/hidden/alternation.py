"""Laws for the course of hidden states, and a course for the laws, in turns. Pure.

How it works. Each proposal of `coordinates` is a start. For its course, sums of products are fitted to the rates of all
states, measured and hidden, and the best sums of each equation are fitted together along whole trajectories; only
measured columns count. The best system by score is then fitted in segments, each with hidden initial states of its own.
So the measured columns pull the hidden course away from the law where the law is wrong. The steps between segments are
spread over the segments, and this course is the start of the next round. The rounds of a start end when the description
does not become shorter, or when the residuals are like noise. The best system of all starts gives the course of the
search, as simulated along whole trajectories, and its equations are the first laws of refining.

With given equations, the start is the fit in which linear functions stand for the unknown parts, and sums of products
are fitted to the values of the unknown parts. This needs a course that does not depend on the law: rounds are made only
if the measured columns and the given parts determine it, as they determine a velocity from positions. If no system has
residuals like noise, the search gets the corrected course: along a simulated course, an unknown part is what was
simulated.

Without given equations, the coordinates are fixed by convention: before a regression, a course gets mean 0 and standard
deviation 1.

Doubts. A law that is no sum of products is only approximated here; the search and refining begin at this approximation,
in its coordinates. Systems along whole chaotic trajectories cannot be fitted.

Letters: D states, H hidden states, R rows of one trajectory, N rows of all trajectories.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Final

import numpy as np

from atoll_coordinator.data.recording import Preparation
from atoll_coordinator.data.templates import template_of
from atoll_coordinator.model.batches import BatchFunction, Spread
from atoll_coordinator.model.deadline import Deadline
from atoll_coordinator.model.description_length import log, structure_length
from atoll_coordinator.model.hidden.coordinates import Course, propose_courses, scale_hidden_states
from atoll_coordinator.model.hidden.correction import (
    course_by_segments,
    course_by_smoother,
    is_determined,
    simulate_all,
    simulated_course,
)
from atoll_coordinator.model.pools import Law, LawsByGroup
from atoll_coordinator.model.selection.candidates import CandidateSet
from atoll_coordinator.model.selection.comparison import ModelComparison
from atoll_coordinator.model.selection.score import FittedModel
from atoll_coordinator.model.selection.task import ModellingTask
from atoll_coordinator.model.shooting.many_starts import StartPoint, StartsProblem
from atoll_coordinator.model.sparse.atoms import polynomial_libraries, product_atoms
from atoll_coordinator.model.sparse.regression import SparseRegression
from atoll_coordinator.model.sparse.rows import RegressionRows
from atoll_coordinator.model.template.hidden_states import (
    HiddenCourse,
    fit_course,
    linear_parts,
    with_initial_values,
)
from atoll_coordinator.model.template.unknown_targets import with_unknown_targets
from atoll_coordinator.settings import SETTINGS
from atoll_core.config import JobConfig
from atoll_core.errors import DataError
from atoll_core.expression.program import MAX_NODES, Program, structure
from atoll_core.expression.template import ZERO

_ROUNDS: Final = 5
"""Most rounds of one start: in later rounds, descriptions of the systems tried here changed little."""
_DEGREES: Final = range(1, SETTINGS.sparse.degree)
"""Degrees of products. The course is known too badly for products of the highest degree."""

_ROWS_OF_AN_ERROR: Final = 16.0
"""Rows whose rates have an error in common, at most: about the span of a smoother."""
_SHARE_OF_TIME: Final = 0.5
"""Largest share of ``--max-time`` for hidden states of given equations; the search and refining need the rest."""


@dataclass(frozen=True, eq=False)
class CourseProblem:
    """What all starts share: the preparation before any course is recorded, and the resolved configuration.

    With given equations, the preparation has the parameters of the first fit, and the parts by which it was made.
    """

    preparation: Preparation
    config: JobConfig


@dataclass(frozen=True, eq=False)
class CourseOutcome:
    """The best system of one start.

    `programs` are the searched equations or unknown parts, `course` is simulated along all trajectories, and `nats` are
    the length of the description. `corrected` is the course by the smoother, with given equations; None: the residuals
    are like noise, or there is no such course.
    """

    programs: tuple[Program, ...]
    course: Course
    nats: float
    is_like_noise: bool
    corrected: Course | None = None


def with_hidden_states(preparation: Preparation, config: JobConfig, spread: Spread | None = None) -> Preparation:
    """Return the preparation with the course of the hidden states of given equations; the preparation itself if there
    are none.

    `config` is resolved; `spread` computes fits in threads or on workers. With a time limit, no further starts are
    tried after half of it.

    Raises:
        DataError: the system can be simulated from no start.
    """
    recording = preparation.recording
    if recording is None:
        return preparation
    recording = with_initial_values(recording, config)
    preparation = replace(preparation, recording=recording)
    template = template_of(config, preparation.dataset.names)
    if not template.sides or not (recording.hidden or recording.observed):
        return preparation
    spread, limit = spread or Spread(), config.budget.max_time
    deadline = None if limit is None else Deadline(_SHARE_OF_TIME * limit)
    first = fit_course(preparation, config, linear_parts(template, config, preparation), spread, deadline)
    if not (recording.hidden and first.slots) or (deadline is not None and deadline.is_over):
        return first.record(preparation)
    start = replace(preparation, parameters=first.parameters, parts=first.slots, minima=first.minima)
    course = _first_correction(start, config, _hidden_part(first.record(preparation)))
    found = None if course is None else next(iter(_improve(CourseProblem(start, config), course, deadline)), None)
    if found is None:
        return first.record(preparation)
    programs = dict(zip(preparation.dataset.variables, found.programs, strict=True))
    slots = {name: programs[name] for name in first.slots}
    if any(structure(slots[name]) != structure(part) for name, part in first.slots.items()):
        scaled = first.record(preparation).recording if first.is_rescaled else recording
        first = fit_course(replace(start, recording=scaled), config, slots, spread, deadline)
    if found.corrected is None:
        return first.record(preparation)
    start = replace(preparation, parameters=first.parameters, parts=first.slots, minima=first.minima)
    return _record(start, found.corrected)


def _first_correction(preparation: Preparation, config: JobConfig, course: Course) -> Course | None:
    """Return the course that the measured columns determine where the first fit contradicts them.

    None: the residuals are like noise, or the law is needed to determine the course; then a law that is wrong would be
    found again.
    """
    task = _task_of(_record(preparation, course), config)
    comparison = task.comparison
    fitted = _fit_along(comparison, [preparation.parts.get(name, ZERO) for name in task.variables])
    if fitted is None or comparison.score.excess(fitted) <= SETTINGS.inference.excess:
        return None
    fits = simulate_all(task, fitted)
    if fits is None or not is_determined(task, fitted, fits):
        return None
    return course_by_smoother(task, fitted, fits, course.coordinates)


def with_proposed_states(
    preparation: Preparation, config: JobConfig, spread: Spread
) -> tuple[Preparation, LawsByGroup]:
    """Return the preparation with a course of its hidden states, and the laws by which this course was computed.

    Raises:
        DataError: no law with hidden states could be simulated along the trajectories.
    """
    recording = preparation.recording
    assert recording is not None
    courses = propose_courses(recording, len(recording.hidden))
    problem = CourseProblem(preparation, config)
    found = spread.map(_STARTS, lambda: problem, courses, 1, lambda: problem)
    outcomes = [outcome for several in found for outcome in several or ()]
    best = min(outcomes, key=lambda outcome: outcome.nats, default=None)
    if best is None:
        raise DataError(
            "no law with hidden states could be simulated along the measured trajectories; give equations with "
            "--equation, or leave --hidden out"
        )
    variables, symbols = preparation.dataset.variables, preparation.dataset.names
    hidden = {
        name: symbols.index(symbol)
        for name, symbol in zip(recording.states, recording.state_symbols, strict=True)
        if name in recording.hidden
    }
    programs, factors = scale_hidden_states(dict(zip(variables, best.programs, strict=True)), hidden)
    prepared = _record(preparation, best.course.scaled([factors[name] for name in recording.hidden]))
    laws = {
        name: (Law(program, structure_length(program), 1.0 if best.is_like_noise else math.inf, is_tested=True),)
        for name, program in programs.items()
    }
    return prepared, [laws]


def _record(preparation: Preparation, course: Course) -> Preparation:
    """Return the preparation with this course of the hidden states, and with its own parameters."""
    assert preparation.recording is not None
    values, rates = np.concatenate(course.values, axis=1), np.concatenate(course.rates, axis=1)
    whole = HiddenCourse(
        preparation.recording.hidden, values, rates, preparation.parameters, preparation.parts, preparation.minima
    )
    return whole.record(preparation)


def _hidden_part(preparation: Preparation) -> Course:
    """Return the course of hidden states that is recorded in a preparation."""
    recording = preparation.recording
    assert recording is not None
    places = [recording.states.index(name) for name in recording.hidden]
    parts = recording.trajectories
    return Course("given", tuple(part.smoothed[places] for part in parts), tuple(part.slopes[places] for part in parts))


# ---------------------------------------------------------------------------------------------------------- one start


def _improve(problem: CourseProblem, course: Course, deadline: Deadline | None = None) -> tuple[CourseOutcome, ...]:
    """Return the best system that begins with a course; nothing if none can be simulated."""
    best: CourseOutcome | None = None
    preparation = problem.preparation
    for _ in range(_ROUNDS):
        if deadline is not None and deadline.is_over:
            break
        task = _task_of(_record(preparation, course), problem.config)
        comparison = task.comparison
        fitted = _best_system(task, comparison, preparation.parts)
        if fitted is None or not math.isfinite(fitted.nats):
            break
        if best is not None and fitted.nats > best.nats - SETTINGS.selection.least_gain:
            break
        fits = simulate_all(task, fitted)
        if fits is None:
            break
        own = simulated_course(task, fits, course.coordinates)
        is_like_noise = comparison.score.excess(fitted) <= SETTINGS.inference.excess
        if not task.template.sides:
            best = CourseOutcome(fitted.programs, own, fitted.nats, is_like_noise)
            corrected = None if is_like_noise else course_by_segments(task, fitted, fits, course.coordinates)
        else:
            corrected = None if is_like_noise else course_by_smoother(task, fitted, fits, course.coordinates)
            best = CourseOutcome(fitted.programs, own, fitted.nats, is_like_noise, corrected)
            preparation = _with_parts(preparation, dict(zip(task.variables, fitted.programs, strict=True)), fitted)
        if corrected is None:
            break
        course = corrected if task.template.sides else corrected.normalised(task.recording)
    return () if best is None else (best,)


def _with_parts(preparation: Preparation, programs: Mapping[str, Program], fitted: FittedModel) -> Preparation:
    """Return the preparation with the parameters and unknown parts of a fitted system."""
    parameters = tuple(fitted.fit.system.parameter_values.tolist())
    return replace(preparation, parameters=parameters, parts={name: programs[name] for name in preparation.parts})


_STARTS: Final[BatchFunction[CourseProblem, Course, tuple[CourseOutcome, ...]]] = BatchFunction(
    "hidden courses", CourseProblem, Course, tuple[CourseOutcome, ...], _improve
)


def _task_of(preparation: Preparation, config: JobConfig) -> ModellingTask:
    """Return the task of fitting whole trajectories; with given equations, only unknown parts are searched."""
    preparation = with_unknown_targets(preparation, config)
    recording = preparation.recording
    assert recording is not None
    known = ZERO if template_of(config, preparation.dataset.names).sides else None
    candidates = {
        name: CandidateSet(known=None if name in preparation.parts else known) for name in preparation.dataset.variables
    }
    parameters = np.array(preparation.parameters) if preparation.parameters else None
    task = ModellingTask(preparation.dataset, recording, config, candidates, parameters=parameters)
    return replace(task, piece=task.longest)


def _best_system(task: ModellingTask, comparison: ModelComparison, parts: Mapping[str, Program]) -> FittedModel | None:
    """Return the best system of the sums proposed for each equation, fitted along whole trajectories.

    With the `parts` of a system that is known already, its parts are replaced one after another.
    """
    if not parts:
        systems = product(*(_propose_sums(task, name) for name in task.variables))
        models = [model for programs in systems if (model := _fit_along(comparison, programs)) is not None]
        return min(models, key=lambda model: model.nats, default=None)
    programs = [parts.get(name, ZERO) for name in task.variables]
    best = _fit_along(comparison, programs)
    for place, name in enumerate(task.variables):
        for program in _propose_sums(task, name) if name in parts else ():
            model = _fit_along(comparison, [*programs[:place], program, *programs[place + 1 :]])
            if model is not None and (best is None or model.nats < best.nats):
                best = model
        programs = programs if best is None else list(best.programs)
    return best


def _propose_sums(task: ModellingTask, name: str) -> list[Program]:
    """Return the sums of products that describe the rates of a state best, by degree and at two prices of a number.

    Rates of neighbouring rows have errors in common, so the number of independent rows is not known: the price is that
    of all rows, and that of a sixteenth of them. All linear terms are proposed, too: terms with small effects on noisy
    rates matter along trajectories.
    """
    problem = task.dataset.problem(name)
    rows, columns = RegressionRows(problem.inputs, problem.target.values), task.columns(name)
    count, chosen = float(len(problem.target.values)), dict[bytes, Program]()
    for terms, _ in polynomial_libraries(columns, count, _DEGREES):
        regression = SparseRegression(rows, product_atoms(problem.inputs, terms))
        if not regression.is_finite:
            break
        sums = list[tuple[float, int, Program]]()
        for fit in regression.elimination_path(range(len(terms)), np.ones(len(rows.sides))):
            residuals = regression.residuals(fit)
            square = max(math.fsum((residuals * residuals).tolist()) / count, 1e-300)
            program = fit.sum_of_products()
            if len(program) <= MAX_NODES and task.may_be_shown(program):
                sums.append((log(square), len(fit.kept), program))
        for share in (1.0, _ROWS_OF_AN_ERROR) if sums else ():
            scored = [
                (0.5 * count / share * nats + 0.5 * log(count / share) * kept + structure_length(program), program)
                for nats, kept, program in sums
            ]
            best = min(scored, key=lambda one: one[0])[1]
            chosen.setdefault(structure(best), best)
        if sums and len(terms) == len(columns) + 1:
            chosen.setdefault(structure(sums[-1][2]), sums[-1][2])
    return list(chosen.values())


def _fit_along(comparison: ModelComparison, programs: Sequence[Program]) -> FittedModel | None:
    """Return a system fitted to growing horizons of all trajectories; None if it cannot be simulated."""
    admitted = comparison.admissible_programs(programs)
    if admitted is None:
        return None
    estimator, system = comparison.estimator, comparison.system(admitted)
    measurements = estimator.measurements
    problem = StartsProblem(measurements, estimator.tolerance, estimator.measured_rows, system, None)
    starts = np.ascontiguousarray(measurements.smoothed[:, measurements.bounds[:, 0]].T)
    point, _ = problem.fit(StartPoint(system.values, starts))
    if point is None:
        return None
    fit = estimator.fit(
        system.with_values(point.values), None, SETTINGS.effort.steps, point.starts, point.errors,
        is_stiff=point.is_stiff,
    )  # fmt: skip
    return None if fit is None else comparison.score_fit(fit)
