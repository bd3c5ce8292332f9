"""Laws for the course of hidden states, and a course for the laws, in turns. Pure.

How it works. Each proposal of `coordinates` is a start. For its course, sums of products are fitted to the rates of all
states, measured and hidden, and the best sums of each equation are fitted together along whole trajectories; only
measured columns count. The best system by score is then fitted in segments, each with hidden initial states of its own.
So the measured columns pull the hidden course away from the law where the law is wrong. The steps between segments are
spread over the segments, and this course is the start of the next round. The rounds of a start end when the description
does not become shorter. The best system of all starts gives the course of the search, as simulated along whole
trajectories, and its equations are the first laws of refining.

The coordinates are fixed by convention: before a regression, a course gets mean 0 and standard deviation 1.

Doubts. A law that is no sum of products is only approximated here; the search and refining begin at this approximation,
in its coordinates. Systems along whole chaotic trajectories cannot be fitted.

Letters: D states, H hidden states, R rows of one trajectory, N rows of all trajectories.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Final

import numpy as np

from atoll_coordinator.data.recording import Preparation
from atoll_coordinator.model.batches import BatchFunction, Spread
from atoll_coordinator.model.description_length import log, structure_length
from atoll_coordinator.model.hidden.coordinates import Course, propose_courses
from atoll_coordinator.model.pools import Law, LawsByGroup
from atoll_coordinator.model.selection.candidates import CandidateSet
from atoll_coordinator.model.selection.comparison import ModelComparison
from atoll_coordinator.model.selection.score import FittedModel
from atoll_coordinator.model.selection.task import ModellingTask
from atoll_coordinator.model.shooting.fit_result import TrajectoryFit
from atoll_coordinator.model.shooting.many_starts import StartPoint, StartsProblem
from atoll_coordinator.model.sparse.atoms import polynomial_libraries, product_atoms
from atoll_coordinator.model.sparse.regression import SparseRegression
from atoll_coordinator.model.sparse.rows import RegressionRows
from atoll_coordinator.model.template.hidden_states import HiddenCourse, states_and_rates
from atoll_coordinator.settings import SETTINGS
from atoll_core.config import JobConfig
from atoll_core.data.dataset import FloatArray
from atoll_core.errors import DataError
from atoll_core.expression.program import MAX_NODES, Program, structure

_ROUNDS: Final = 5
"""Most rounds of one start: in later rounds, descriptions of the systems tried here changed little."""
_DEGREES: Final = range(1, SETTINGS.sparse.degree)
"""Degrees of products. The course is known too badly for products of the highest degree."""

_ROWS_OF_AN_ERROR: Final = 16.0
"""Rows whose rates have an error in common, at most: about the span of a smoother."""


@dataclass(frozen=True, eq=False)
class CourseProblem:
    """What all starts share: the preparation before any course is recorded, and the resolved configuration."""

    preparation: Preparation
    config: JobConfig


@dataclass(frozen=True, eq=False)
class CourseOutcome:
    """The best system of one start: its equations, its course along all trajectories, its nats, and whether the
    residuals are like noise."""

    programs: tuple[Program, ...]
    course: Course
    nats: float
    is_like_noise: bool


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
    prepared = _record(preparation, best.course)
    variables = preparation.dataset.variables
    laws = {
        name: (Law(program, structure_length(program), 1.0 if best.is_like_noise else math.inf, is_tested=True),)
        for name, program in zip(variables, best.programs, strict=True)
    }
    return prepared, [laws]


def _record(preparation: Preparation, course: Course) -> Preparation:
    """Return the preparation with this course of the hidden states."""
    assert preparation.recording is not None
    values, rates = np.concatenate(course.values, axis=1), np.concatenate(course.rates, axis=1)
    whole = HiddenCourse(preparation.recording.hidden, values, rates, (), {}, None)
    return whole.record(preparation)


# ---------------------------------------------------------------------------------------------------------- one start


def _improve(problem: CourseProblem, course: Course) -> tuple[CourseOutcome, ...]:
    """Return the best system that begins with a course; nothing if none can be simulated."""
    best: CourseOutcome | None = None
    for _ in range(_ROUNDS):
        prepared = _record(problem.preparation, course)
        task = _task_of(prepared, problem.config)
        comparison = task.comparison
        fitted = _best_system(task, comparison)
        if fitted is None or not math.isfinite(fitted.nats):
            break
        if best is not None and fitted.nats > best.nats - SETTINGS.selection.least_gain:
            break
        fits = _simulate(task, fitted)
        if fits is None:
            break
        nothing = np.zeros_like(fits[False].simulated)
        own = _course_of(task, fits, fits[False].simulated, nothing, course.coordinates)
        is_like_noise = comparison.score.excess(fitted) <= SETTINGS.inference.excess
        best = CourseOutcome(fitted.programs, own, fitted.nats, is_like_noise)
        corrected = None if is_like_noise else _corrected_course(task, fitted, fits, course.coordinates)
        if corrected is None:
            break
        course = corrected.normalised(task.recording)
    return () if best is None else (best,)


_STARTS: Final[BatchFunction[CourseProblem, Course, tuple[CourseOutcome, ...]]] = BatchFunction(
    "hidden courses", CourseProblem, Course, tuple[CourseOutcome, ...], _improve
)


def _task_of(preparation: Preparation, config: JobConfig) -> ModellingTask:
    """Return the task of fitting whole trajectories."""
    recording = preparation.recording
    assert recording is not None
    candidates = {name: CandidateSet() for name in preparation.dataset.variables}
    task = ModellingTask(preparation.dataset, recording, config, candidates)
    return replace(task, piece=task.longest)


def _best_system(task: ModellingTask, comparison: ModelComparison) -> FittedModel | None:
    """Return the best system of the sums proposed for each equation, fitted along whole trajectories."""
    sums = [_propose_sums(task, name) for name in task.variables]
    models = list[FittedModel]()
    for programs in product(*sums):
        model = _fit_along(comparison, programs)
        if model is not None:
            models.append(model)
    return min(models, key=lambda model: model.nats, default=None)


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


# ------------------------------------------------------------------------------------------------------- its course


def _simulate(task: ModellingTask, model: FittedModel) -> dict[bool, TrajectoryFit] | None:
    """Return the model along all rows, of held-out trajectories (True) and of the others; None if that fails."""
    fits = dict[bool, TrajectoryFit]()
    for held_out in sorted({part.held_out for part in task.recording.trajectories}):
        measurements = task.measurements(task.variables, held_out=held_out)
        estimator = task.make_comparison(measurements, task.variables).estimator
        starts, steps = (None, SETTINGS.effort.steps) if held_out else (model.fit.starts, 0)
        fit = estimator.fit(model.fit.system.with_fixed_constants(), None, steps, starts, model.fit.errors)
        if fit is None:
            return None
        fits[held_out] = fit
    return fits


def _course_of(
    task: ModellingTask, fits: dict[bool, TrajectoryFit], states: FloatArray, slopes: FloatArray, coordinates: str
) -> Course:
    """Return the hidden states and their rates by trajectory, with `states` (D, N) of the trajectories that are not
    held out, and `slopes` (D, N) in addition to the rates by the equations."""
    hidden = [task.variables.index(name) for name in task.recording.hidden]
    values, rates = list[FloatArray](), list[FloatArray]()
    own = {held_out: fit.simulated for held_out, fit in fits.items()} | {False: states}
    parts = zip(task.recording.trajectories, states_and_rates(task, fits, own), strict=True)
    for part, (course, by_law, rows) in parts:
        values.append(np.ascontiguousarray(course[hidden]))
        rates.append(by_law[hidden] if part.held_out else by_law[hidden] + slopes[hidden, rows])
    return Course(coordinates, tuple(values), tuple(rates))


def _corrected_course(
    task: ModellingTask, model: FittedModel, fits: dict[bool, TrajectoryFit], coordinates: str
) -> Course | None:
    """Return the hidden course of the system fitted in segments, without steps between them; None if that fails.

    A step from the end of one segment to the start of the next is an error of the law over a segment. The course is
    moved by a broken line that is continuous with half of each step at either side, and the slope of this line is added
    to the rates.
    """
    estimator, length = fits[False].estimator, SETTINGS.shooting.lengths[1]
    measurements = estimator.measurements
    segments, times = measurements.segments(length), measurements.times
    starts = np.ascontiguousarray(fits[False].simulated[:, segments[:, 0]].T)
    fit = estimator.fit(model.fit.system, length, SETTINGS.effort.steps, starts, model.fit.errors)
    if fit is None:
        return None
    states, slopes = fit.simulated.copy(), np.zeros_like(fit.simulated)
    ends, steps = set(measurements.bounds[:, 1].tolist()), np.zeros((len(segments) + 1, len(states)))
    for place, (begin, end) in enumerate(segments.tolist()):
        if end not in ends and end - begin > 1:
            ahead = (times[end] - times[end - 1]) / (times[end - 1] - times[end - 2])
            steps[place + 1] = states[:, end] - states[:, end - 1] - ahead * (states[:, end - 1] - states[:, end - 2])
    for place, (begin, end) in enumerate(segments.tolist()):
        if end - begin < 2:
            continue
        slope = 0.5 * (steps[place] + steps[place + 1]) / (times[end - 1] - times[begin])
        slopes[:, begin:end] = slope[:, None]
        states[:, begin:end] += slope[:, None] * (times[begin:end] - times[begin]) - 0.5 * steps[place][:, None]
    return _course_of(task, fits | {False: fit}, states, slopes, coordinates)
