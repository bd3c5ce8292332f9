"""The course of hidden states: a template is fitted to the measured columns, and its hidden states are recorded. Pure.

How it works. Each unknown part is replaced by a linear function of few variables. The parameters, the coefficients of
these functions and the initial values are fitted to whole trajectories from many starts. The hidden states of the best
fit then count as smoothed states: their values and slopes become columns of the dataset and of the recording, so that
the targets of unknown parts, the search and refining treat them as other states. Only their measured values are
missing.

Doubtful: the course belongs to the present law. If the unknown part is not nearly linear, the course is wrong, and the
targets of the search with it; `hidden.alternation` then improves both. Refining fits the found law again, with the
initial values of hidden states.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from atoll_coordinator.data.differentiation.kernels.stencils import moments
from atoll_coordinator.data.recording import FoundMinima, Preparation, Recording, Trajectory
from atoll_coordinator.data.templates import parameter_of
from atoll_coordinator.model.batches import Spread
from atoll_coordinator.model.deadline import Deadline
from atoll_coordinator.model.selection.candidates import CandidateSet
from atoll_coordinator.model.selection.task import ModellingTask
from atoll_coordinator.model.shooting.fit_result import TrajectoryFit
from atoll_coordinator.model.shooting.many_starts import StartsFit, fit_from_many_starts
from atoll_coordinator.model.shooting.multiple_shooting import MultipleShooting
from atoll_coordinator.model.sparse.atoms import sum_of
from atoll_coordinator.settings import SETTINGS
from atoll_core.config import JobConfig
from atoll_core.data.dataset import Dataset, FloatArray, IntArray
from atoll_core.errors import DataError
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.operators import VARIABLE
from atoll_core.expression.program import Expression, Program
from atoll_core.expression.template import ZERO, EquationTemplate

_DIGITS: Final = 12
"""Digits of the parameters, so that they do not depend on the last bits."""
_FIRST: Final = 0.01
"""First value of the coefficients of a function that stands for an unknown part. They are not 0, so that a factor does
not switch its term off. Along long trajectories they are smaller, so that no state grows by more than a few e-folds."""

_OTHER_SCALE: Final = 100.0
"""Ratio of two scales of a hidden state above which fits from many starts are repeated. It is set by hand: tolerances
of the solver are 1e-6 of a scale, and fits to noise of a per cent bear errors of 1e-4."""


def initial_values(config: JobConfig) -> tuple[tuple[str, float, float], ...]:
    """Return the bounds on initial values: name of the state, lower and upper bound.

    A start value without bounds is a given value: both bounds.
    """
    found = []
    for name, one in config.prior.initial.items():
        is_given = one.start is not None and one.lower is None and one.upper is None
        lower = one.start if is_given else one.lower
        upper = one.start if is_given else one.upper
        found.append((name, -np.inf if lower is None else lower, np.inf if upper is None else upper))
    found += [(name, *config.prior.parameters[name].ends) for name in config.prior.by_run]
    return tuple(found)


def with_initial_values(recording: Recording, config: JobConfig) -> Recording:
    """Return the recording with the bounds on initial values, and with the start values of parameters by run as their
    course."""
    parts = list[Trajectory]()
    for part in recording.trajectories if config.prior.by_run else ():
        smoothed = part.smoothed.copy()
        for name in config.prior.by_run:
            smoothed[recording.states.index(name)] = parameter_of(name, config.prior.parameters[name]).first_value
        parts.append(replace(part, smoothed=smoothed))
    return replace(recording, initial=initial_values(config), trajectories=tuple(parts) or recording.trajectories)


@dataclass(frozen=True, eq=False)
class HiddenCourse:
    """A fit of a template, along all trajectories.

    Attributes:
        variables: names of the equations (D).
        states: the states (D, R) at all rows of all trajectories.
        rates: their derivatives (D, R) by the equations.
        parameters: values (P,) of the parameters of the template.
        slots: the functions that stand for the unknown parts, by equation.
        minima: what the fits from many starts found; None: it was not found by such fits.
        is_rescaled: whether the hidden states have other magnitudes than was assumed before the fits.
    """

    variables: tuple[str, ...]
    states: FloatArray
    rates: FloatArray
    parameters: tuple[float, ...]
    slots: Mapping[str, Program]
    minima: FoundMinima | None
    is_rescaled: bool = False

    def record(self, preparation: Preparation) -> Preparation:
        """Return the preparation with the hidden states as smoothed states."""
        recording, dataset = preparation.recording, preparation.dataset
        assert recording is not None
        ends = np.cumsum([len(part.times) for part in recording.trajectories])
        rows_of_parts = np.split(np.arange(int(ends[-1])), ends[:-1])
        trajectories = tuple(
            self._with_course(recording, part, rows)
            for part, rows in zip(recording.trajectories, rows_of_parts, strict=True)
        )
        held_out = preparation.held_out
        return replace(
            preparation,
            recording=replace(recording, trajectories=trajectories),
            dataset=self._fill(dataset, recording),
            held_out=None if held_out is None else self._fill(held_out, recording),
            parameters=self.parameters,
            minima=self.minima,
            parts=self.slots,
        )

    def _with_course(self, recording: Recording, part: Trajectory, rows: IntArray) -> Trajectory:
        smoothed, slopes = part.smoothed.copy(), part.slopes.copy()
        for name in recording.hidden:
            place, own = recording.states.index(name), self.variables.index(name)
            smoothed[place], slopes[place] = self.states[own, rows], self.rates[own, rows]
        return replace(part, smoothed=smoothed, slopes=slopes)

    def _fill(self, dataset: Dataset, recording: Recording) -> Dataset:
        """Return the dataset with the hidden states; until now the number of each row stands for them."""
        if not recording.hidden:
            return dataset
        inputs, targets = dataset.inputs.copy(), list(dataset.targets)
        measured = [target for target in targets if target.variable not in recording.hidden]
        uncertainty = max((target.uncertainty for target in measured), default=1.0)
        noise = max((target.noise for target in measured), default=1.0)
        places = [dataset.names.index(symbol) for symbol in recording.state_symbols[-len(recording.hidden) :]]
        rows = inputs[places[0]].astype(np.int64)
        for name, place in zip(recording.hidden, places, strict=True):
            own = self.variables.index(name)
            inputs[place] = self.states[own, rows]
            index = next((index for index, target in enumerate(targets) if target.variable == name), None)
            if index is not None:
                values = self.rates[own, rows]
                _, scale = moments(np.ascontiguousarray(values))
                scale = scale or 1.0
                # the course follows the measured states, so it is about as uncertain as they are
                targets[index] = replace(
                    targets[index], values=values, standard_deviation=scale, uncertainty=uncertainty, noise=noise
                )
        return replace(dataset, inputs=np.ascontiguousarray(inputs), targets=tuple(targets))


def fit_course(
    preparation: Preparation, config: JobConfig, slots: Mapping[str, Program], spread: Spread, deadline: Deadline | None
) -> HiddenCourse:
    """Return the fit of a template with hidden states to the trajectories, from many starts; held-out trajectories are
    simulated with its parameters.

    `slots` are functions that stand for the unknown parts, by equation; their constants are fitted, too. After the
    `deadline` no further starts are tried.

    Raises:
        DataError: the system can be simulated from no start.
    """
    recording, dataset = preparation.recording, preparation.dataset
    assert recording is not None
    programs = [slots.get(name, ZERO) for name in dataset.variables]
    candidates = {name: CandidateSet(known=program) for name, program in zip(dataset.variables, programs, strict=True)}
    parameters = np.array(preparation.parameters) if preparation.parameters else None
    task = ModellingTask(
        dataset, recording, config, candidates, spread=spread, deadline=deadline, parameters=parameters
    )  # fmt: skip
    task = replace(task, piece=max(len(part.times) for part in recording.trajectories))
    comparison = task.make_comparison(task.measurements(task.variables), task.variables)
    system = comparison.system(programs)
    found = fit_from_many_starts(comparison.estimator, system, config.seed)
    is_rescaled = found is not None and _has_other_scales(comparison.estimator, found.fit)
    if found is not None and is_rescaled:
        found = fit_from_many_starts(found.fit.estimator, system, config.seed) or found
    if found is None:
        raise DataError(
            "the given equations with hidden states can be simulated from no start values of their parameters; give "
            "start values with --parameter and --initial that are nearer to the truth"
        )
    fits = {False: found.fit}
    if any(part.held_out for part in recording.trajectories):
        other = task.make_comparison(task.measurements(task.variables, held_out=True), task.variables)
        fixed = found.fit.system.with_fixed_constants()
        if config.prior.by_run:  # their values in these trajectories may be far from the start value
            best = fit_from_many_starts(other.estimator, fixed, config.seed)
            simulated = None if best is None else best.fit
        else:
            simulated = other.estimator.fit(fixed, None, SETTINGS.effort.steps)
        if simulated is None:
            raise DataError("the held-out trajectories cannot be simulated by the given equations; leave --holdout out")
        fits[True] = simulated
    return replace(_along_trajectories(task, fits, slots, _summarize_minima(found)), is_rescaled=is_rescaled)


def _has_other_scales(estimator: MultipleShooting, fit: TrajectoryFit) -> bool:
    """Tell whether the hidden states have other magnitudes than the fits of `estimator` assumed. An integration is then
    too coarse, or fails since its steps are too short."""
    hidden = list(estimator.measurements.hidden)
    ratios = fit.estimator.measurements.scales[hidden] / estimator.measurements.scales[hidden]
    return bool(((ratios > _OTHER_SCALE) | (ratios < 1.0 / _OTHER_SCALE)).any())


def _summarize_minima(found: StartsFit) -> FoundMinima:
    """Return how often the best minimum was reached, and the minima that are almost as good."""
    best, system = found.minima[0], found.fit.system
    rivals = [
        (minimum.misfit - best.misfit, tuple(system.with_values(point.values).parameter_values.tolist()))
        for minimum in found.minima
        if minimum.misfit - best.misfit < SETTINGS.inference.distinct_nats
        for point in (minimum.point, *minimum.others)
        if point is not best.point
    ]
    return FoundMinima(found.starts, best.reached, tuple(rivals))


def _along_trajectories(
    task: ModellingTask, fits: Mapping[bool, TrajectoryFit], slots: Mapping[str, Program], minima: FoundMinima
) -> HiddenCourse:
    """Return the states and rates of fits at all rows, in the order of the recording's trajectories."""
    parts = list(states_and_rates(task, fits, {held_out: fit.simulated for held_out, fit in fits.items()}))
    states, rates = (np.concatenate([part[place] for part in parts], axis=1) for place in (0, 1))
    values = fits[False].system.parameter_values
    parameters = tuple(float(f"{value:.{_DIGITS - 1}e}") for value in values.tolist())
    found = dict(zip(task.variables, fits[False].system.searched(0), strict=True))
    return HiddenCourse(task.variables, states, rates, parameters, {name: found[name] for name in slots}, minima)


def states_and_rates(
    task: ModellingTask, fits: Mapping[bool, TrajectoryFit], states: Mapping[bool, FloatArray]
) -> Iterator[tuple[FloatArray, FloatArray, slice]]:
    """Yield, for each trajectory of the recording, the states (D, R), their rates (D, R) by the equations of its fit,
    and its rows.

    `fits` and `states` (D, N) are those of held-out trajectories (True) and of the others (False).
    """
    used = {False: 0, True: 0}
    for part in task.recording.trajectories:
        fit, first = fits[part.held_out], used[part.held_out]
        used[part.held_out] = end = first + len(part.times)
        measurements, rows = fit.estimator.measurements, slice(first, end)
        own = states[part.held_out][:, rows]
        points = np.concatenate([own, measurements.inputs[:, rows]])
        points = points[[measurements.variables.index(name) for name in task.dataset.names]]
        yield own, np.array([values_of(program, points) for program in fit.system.programs[: len(own)]]), rows


def linear_parts(template: EquationTemplate, config: JobConfig, preparation: Preparation) -> dict[str, Program]:
    """Return linear functions that stand for the unknown parts of equations: of the variables that the user named for
    it, else of the equation's own state.

    They have no constant term: with few rows, each further number makes the minimum flatter.
    """
    assert preparation.recording is not None
    duration = max(float(part.times[-1] - part.times[0]) for part in preparation.recording.trajectories)
    first, parts = min(_FIRST, 1.0 / duration), dict[str, Program]()
    for equation in (unknown.home for unknown in template.unknowns):
        named, by_run = config.space.variables_of.get(equation), {*config.prior.by_run}
        if named is not None and by_run and {*named} == {*template.names} - by_run:
            named = None  # nothing was named: these are all variables that it may depend on
        symbols = named if named is not None else (preparation.dataset.symbols[equation],)
        terms: list[Expression] = [(VARIABLE, template.names.index(symbol)) for symbol in symbols]
        parts[equation] = sum_of(terms, [first * (place + 1) for place, _ in enumerate(terms)])
    return parts
