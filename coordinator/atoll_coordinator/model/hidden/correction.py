"""The course of hidden states, corrected where the measured columns contradict the present law. Pure.

How it works. Along a simulated course, the rates of hidden states obey the present law exactly, so no regression could
change it. Two ways lead away from it:

- *By segments*, if no equations are given: the system is fitted in short segments, each with hidden initial states of
  its own, and the steps between segments are spread over them.
- *By a smoother*, if some equations are given: unknown parts have forces of their own, and the rest holds.

Doubts. By segments, the course follows the present law within a segment. The smoother needs parts that hold: with a
force in each equation, the forecast of the cascaded tanks was worse by half (RMSE 0.68 and 0.35 V) in 3 times the time.

Letters: D states, R rows of one trajectory, N rows of all trajectories.
"""

import math
from typing import Final

import numpy as np

from atoll_coordinator.model.hidden.coordinates import Course
from atoll_coordinator.model.hidden.kalman_smoother import KalmanSmoother, Series
from atoll_coordinator.model.selection.score import FittedModel
from atoll_coordinator.model.selection.task import ModellingTask
from atoll_coordinator.model.shooting.fit_result import TrajectoryFit
from atoll_coordinator.model.template.hidden_states import states_and_rates
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.evaluation import values_of

_DIFFUSE: Final = 10.0
"""Standard deviation of a first state without bounds, in units of its scale: as good as unknown."""


def simulate_all(task: ModellingTask, model: FittedModel) -> dict[bool, TrajectoryFit] | None:
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


def simulated_course(task: ModellingTask, fits: dict[bool, TrajectoryFit], coordinates: str) -> Course:
    """Return the hidden states as simulated along all trajectories, and their rates by the equations."""
    states = fits[False].simulated
    return _course_of(task, fits, states, np.zeros_like(states), coordinates)


def course_by_segments(
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


def course_by_smoother(
    task: ModellingTask, model: FittedModel, fits: dict[bool, TrajectoryFit], coordinates: str
) -> Course | None:
    """Return the smoothed hidden course with forces in the searched equations; None if that fails.

    Courses of trajectories that are held out are simulated.
    """
    smoother, several = _smoother_of(task, model), _series_of(task, fits)
    smoothed = smoother.smooth(several)
    if smoothed is None:
        return None
    hidden = [task.variables.index(name) for name in task.recording.hidden]
    values, rates, courses = list[FloatArray](), list[FloatArray](), zip(several, smoothed, strict=True)
    simulated = states_and_rates(task, fits, {held_out: fit.simulated for held_out, fit in fits.items()})
    for part, (states, slopes, _) in zip(task.recording.trajectories, simulated, strict=True):
        if not part.held_out:
            series, own = next(courses)
            states, slopes = own.states, smoother.rates(own.states, series.inputs, own.forces)
        values.append(np.ascontiguousarray(states[hidden]))
        rates.append(np.ascontiguousarray(slopes[hidden]))
    return Course(coordinates, tuple(values), tuple(rates))


def _series_of(task: ModellingTask, fits: dict[bool, TrajectoryFit]) -> list[Series]:
    """Return the trajectories that are not held out, with what is known of their first states."""
    measurements = fits[False].estimator.measurements
    known = np.where(measurements.weights > 0.0, measurements.measured, np.nan)
    is_hidden = np.isin(np.arange(len(task.variables)), measurements.hidden)
    ranges, several = measurements.start_ranges(measurements.bounds), list[Series]()
    for place, (first, end) in enumerate(measurements.bounds.tolist()):
        start = np.where(is_hidden, fits[False].simulated[:, first], measurements.smoothed[:, first])
        spread = _DIFFUSE * measurements.scales
        if ranges is not None:
            width = (ranges[1][place] - ranges[0][place]) / math.sqrt(12.0)  # of a uniform distribution
            spread = np.where(np.isfinite(width), width, spread)
        rows = slice(first, end)
        times, inputs = measurements.times[rows], measurements.inputs[:, rows]
        several.append(Series(times, inputs, known[:, rows], start, spread, float(times[-1] - times[0])))
    return several


def is_determined(task: ModellingTask, model: FittedModel, fits: dict[bool, TrajectoryFit]) -> bool:
    """Tell whether the measured columns and the given parts alone determine the course: with free forces, the errors of
    each hidden state are a small part of its variance, as small as for a verdict."""
    free = _smoother_of(task, model).smooth(_series_of(task, fits), is_free=True)
    if free is None:
        return False
    hidden = [task.variables.index(name) for name in task.recording.hidden]
    states = np.concatenate([part.states[hidden] for part in free], axis=1)
    variances = np.concatenate([part.variances[hidden] for part in free], axis=1)
    return bool((variances.mean(axis=1) <= SETTINGS.inference.part * states.var(axis=1)).all())


def _smoother_of(task: ModellingTask, model: FittedModel) -> KalmanSmoother:
    """Return the smoother of a system, with a force in each unknown part of its template."""
    measurements, system, template = task.measurements(task.variables), model.fit.system, task.template
    order = [measurements.variables.index(name) for name in task.dataset.names]
    programs = dict(zip(task.variables, model.programs, strict=True))
    searched = [name for name in task.variables if name not in task.known]
    homes = [searched.index(unknown.home) for unknown in template.unknowns]

    def rates(states: FloatArray, inputs: FloatArray, forces: FloatArray) -> FloatArray:
        points = np.ascontiguousarray(np.concatenate([states, inputs])[order])
        found = [values_of(programs[name], points) + force for name, force in zip(searched, forces, strict=True)]
        parameters = np.repeat(system.parameter_values[:, None], points.shape[1], axis=1)
        whole = np.concatenate([points, parameters, *(found[place][None] for place in homes)])
        own = dict(zip(searched, found, strict=True))
        return np.array([
            values_of(template.sides[name], whole) if name in template.sides else own[name] for name in task.variables
        ])  # fmt: skip

    def columns(states: FloatArray, inputs: FloatArray) -> FloatArray:
        points = np.concatenate([states, inputs])
        computed = [values_of(program, points)[None] for program in system.observation_programs]
        return np.concatenate([states, *computed])[measurements.observed]

    scales = [
        *measurements.scales.tolist(),
        *(task.dataset.problem(name).target.standard_deviation for name in searched),
    ]
    noise = np.maximum(measurements.noise, SETTINGS.common.negligible * measurements.observed_scales)
    return KalmanSmoother(rates, columns, len(task.variables), np.array(scales), noise)
