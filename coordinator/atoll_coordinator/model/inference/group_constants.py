"""What is reported where groups of trajectories may differ in constants: which of them do, and the values of each.

All constants begin with a value for each group. One after another, those that differ least become shared by all
groups, as long as that makes the description shorter. A value for each group costs 1/2 ln(rows of a group), a shared
one 1/2 ln(rows). How an equation is written decides which constants there are: of x*(r - q*x) with r and q twice as
large in one group, r*(x - k*x*x) has one that differs. So each coefficient in turn is tried as a factor of the sum.

Letters: G groups, P constants of all equations, Q numbers that these are in all groups together.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from atoll_coordinator.model.inference.conclusion import (
    Final,
    HeldOut,
    Shown,
    long_run_of,
    pole_remarks,
    predictions_of,
    refined_equation,
    shortest_writing,
    state_errors,
    unseen_comparison,
)
from atoll_coordinator.model.inference.standard_errors import Errors, estimate_errors
from atoll_coordinator.model.inference.trajectory_simulation import (
    bands,
    not_simulated,
    r2_of,
    scaled_covariance,
    simulated,
)
from atoll_coordinator.model.refinement import (
    Constant,
    Covariance,
    GroupCovariance,
    GroupEquation,
    Refinement,
    Simulation,
)
from atoll_coordinator.model.regression.covariance import Known, student_95
from atoll_coordinator.model.regression.rounding import Estimates
from atoll_coordinator.model.selection.alternatives import rank_alternatives
from atoll_coordinator.model.selection.comparison import FittedModel, ModelComparison
from atoll_coordinator.model.selection.piece_lengths import on_all_rows, remarks
from atoll_coordinator.model.selection.rounding import RoundedSystem
from atoll_coordinator.model.selection.task import SelectedModel
from atoll_coordinator.model.shooting.system import Place, SharedNumber
from atoll_coordinator.model.shooting.trajectory_fit import bounded_covariance, covariance
from atoll_coordinator.model.structure.one_sided import within_bounds
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.program import Program, constant_places, structure
from atoll_core.expression.unit_coefficients import as_written
from atoll_core.expression.writing.expansion import factored_forms


@dataclass(frozen=True, eq=False)
class SharedModel:
    """A fitted system and the constants of it that all groups have in common."""

    model: FittedModel
    shared: frozenset[Place] = frozenset()


def _numbers(shared: Collection[Place]) -> frozenset[SharedNumber]:
    """Return a number for each of these constants."""
    return frozenset(((place, 1.0),) for place in shared)


def summarize_groups(selection: SelectedModel) -> Refinement | None:
    """Return the refinement that the chosen system gives; None when it cannot be simulated on all rows."""
    task = selection.task
    ranking = rank_alternatives(selection, task.dataset.inputs)
    whole = on_all_rows(ranking.selection)
    if whole is None:
        return None
    comparison = whole.comparison
    chosen = _written(whole, _with_shared(comparison, SharedModel(whole.model)))
    model = chosen.model
    errors = estimate_errors(comparison, model)
    values = _shown_values(comparison, model)
    fixed = model.fit.system.with_values(values).with_fixed_constants()
    estimator = comparison.estimator
    fit = estimator.fit(
        fixed, None, SETTINGS.effort.steps, model.fit.starts, model.fit.errors, is_stiff=model.fit.is_stiff
    )
    if fit is None:
        return None
    programs = fixed.programs[len(comparison.leading) :]
    by_group = [
        fixed.of_group(group).programs[len(comparison.leading) :] for group in range(len(task.recording.groups))
    ]
    candidates = task.candidates.values()
    shown = Shown(
        RoundedSystem(programs, tuple(() for _ in programs)),
        replace(model, programs=programs, made=fit),
        tuple(map(as_written, programs)),
        model,
    )
    final = Final(
        whole.task,
        ranking,
        tuple(
            equation_candidates.origins(compared)
            for equation_candidates, compared in zip(candidates, selection.lists, strict=True)
        ),
        unseen_comparison(whole.task),
        comparison,
        shown,
        comparison,
        fit,
        whole.task.piece,
        by_group,
    )
    return _refinement(final, chosen.shared, errors, values)


def _refinement(final: Final, shared: frozenset[Place], errors: Errors, values: FloatArray) -> Refinement:
    """Return what is reported of the final model."""
    comparison, model, task = final.comparison, final.free, final.task
    spread = bands(comparison.estimator.measurements, model.fit, *scaled_covariance(model.fit, errors))
    out = None if final.unseen is None else _held_out(final, final.unseen)
    trajectories = simulated(comparison.estimator.measurements, final.seen_fit, spread, task.variables, held_out=False)
    long_run = long_run_of(final)
    predictions = predictions_of(final, errors, is_near=False)
    described = _Described(final, errors, values)
    equations, by_group = {}, described.covariances()
    for index, name in enumerate(task.variables):
        known = Known(described.means(index, shared), ())
        r2 = None if out is None else out.r2[index]
        equations[name] = replace(
            refined_equation(final, index, known, r2, predictions[index], long_run),
            by_group=described.equations(index),
            shared=()
            if index in comparison.fixed
            else tuple((index, node) in shared for node in constant_places(final.shown[index])),
        )
    is_one = shared.issuperset(comparison.places(model.fit.system))
    return Refinement(
        equations,
        Simulation(
            task.variables, (*trajectories, *(out.trajectories if out else ())), student_95(errors.degrees_of_freedom)
        ),
        errors=state_errors(final),
        warnings=(*remarks(task, is_tested_in_whole=long_run.fits is True), *pole_remarks(final)),
        covariance=by_group[0].covariance if is_one else None,
        by_group=by_group,
    )


def _held_out(final: Final, unseen: ModelComparison) -> HeldOut:
    """Simulate the held-out trajectories with the constants of their groups."""
    measurements = unseen.estimator.measurements
    fit = unseen.estimator.fit(final.seen_fit.system, None, SETTINGS.effort.steps)
    if fit is None:
        return HeldOut(tuple(not_simulated(measurements, held_out=True)), tuple(-np.inf for _ in measurements.observed))
    return HeldOut(
        tuple(simulated(measurements, fit, None, final.task.variables, held_out=True)),
        tuple(r2_of(measurements, fit, slice(None))),
    )


# ------------------------------------------------------------------------------------------- what differs


def _with_shared(comparison: ModelComparison, model: SharedModel) -> SharedModel:
    """Return `model` with constants shared, those first that differ least, as long as the description gets shorter."""
    while True:
        following = None
        for place in _alike_first(comparison, model)[:2]:
            shared = model.shared | {place}
            fitted = comparison.fit_beside(model.model, model.model.programs, shared=_numbers(shared))
            if fitted is not None and fitted.nats < model.model.nats:
                following = SharedModel(fitted, shared)
                break
        if following is None:
            return model
        model = following


def _alike_first(comparison: ModelComparison, model: SharedModel) -> list[Place]:
    """Return the constants that differ between groups, those first whose differences are the smallest for their errors.

    The statistic is the sum of squared deviations from the weighted mean over the variances (Cochran's Q).
    """
    fit = model.model.fit
    system = fit.system
    values, variances = system.by_place(system.values), system.by_place(np.diag(covariance(fit)), 2)
    weights = 1.0 / np.maximum(variances, 1e-300)
    with np.errstate(all="ignore"):
        means = (weights * values).sum(axis=0) / weights.sum(axis=0)
        statistics = np.nan_to_num((weights * (values - means) ** 2).sum(axis=0))
    places = comparison.places(system)
    order = sorted(range(len(places)), key=lambda number: float(statistics[number]))
    return [places[number] for number in order if places[number] not in model.shared]


def _written(whole: SelectedModel, begun: SharedModel) -> SharedModel:
    """Return the model in those writings of its equations that make its description shortest."""
    comparison, best = whole.comparison, begun
    for equation in range(len(begun.model.programs)):
        if equation in comparison.fixed:
            continue
        for program in _writings(whole, equation, best.model.programs[equation]):
            programs = [*best.model.programs]
            programs[equation] = program
            kept = frozenset(place for place in best.shared if place[0] != equation)
            fitted = comparison.fit_beside(best.model, programs, shared=_numbers(kept))
            if fitted is not None:
                trial = _with_shared(comparison, SharedModel(fitted, kept))
                best = min(best, trial, key=lambda shared_model: shared_model.model.nats)
    return best


def _writings(whole: SelectedModel, equation: int, program: Program) -> Iterator[Program]:
    """Yield other writings of an equation: the shortest, and each coefficient as a factor of all."""
    comparison = whole.comparison
    seen = {structure(program)}
    is_free = comparison.restrictions(equation).bounds is None
    others = [shortest_writing(whole.task, comparison, equation, program)]
    for writing in (*others, *(factored_forms(program) if is_free else ())):
        if structure(writing) not in seen and whole.task.may_be_shown(writing):
            seen.add(structure(writing))
            yield writing


def _shown_values(comparison: ModelComparison, model: FittedModel) -> FloatArray:
    """Return the numbers (Q,) as they are shown: with two digits of their errors, simple ones where singled out."""
    system = model.fit.system
    if not system.count:
        return system.values
    spread = comparison.inflation(model) * bounded_covariance(model.fit)
    is_many = system.count > SETTINGS.effort.beam
    return Estimates(system.values, spread).rounded(estimates=range(system.count) if is_many else ()).values


# ------------------------------------------------------------------------------------------- what is said of it


class _Described:
    """Constants of the final model by group."""

    def __init__(self, final: Final, errors: Errors, values: FloatArray) -> None:
        """`values` (Q,) are the numbers as they are shown."""
        self._final = final
        self._groups: Sequence[str] = final.task.recording.groups
        self._errors = errors
        self._system = final.free.fit.system
        self._columns = self._system.columns
        self._places = final.comparison.places(self._system)
        self._numbers = [self._described(number, value) for number, value in enumerate(values.tolist())]

    def _described(self, number: int, value: float) -> Constant:
        """Return one of the Q numbers with its errors."""
        errors = self._errors
        error, fitted = float(np.sqrt(max(errors.covariance[number, number], 0.0))), float(errors.values[number])
        reach = student_95(errors.degrees_of_freedom) * error
        interval = (fitted - reach, fitted + reach) if np.isfinite(error) else None
        made = Constant(value, fitted, error, interval, reach < abs(fitted))
        if errors.lower is None or errors.upper is None:
            return made
        return within_bounds(made, float(errors.lower[number]), float(errors.upper[number]), errors.reaches.get(number))

    def _of(self, equation: int, group: int) -> Mapping[int, Constant]:
        """Return the fitted constants of an equation in one group, by node."""
        return {
            node: self._numbers[int(self._columns[group, place])]
            for place, (owner, node) in enumerate(self._places)
            if owner == equation
        }

    def equations(self, equation: int) -> tuple[GroupEquation, ...]:
        """Return an equation with the constants of each group; nothing of one that was given."""
        if equation in self._final.comparison.fixed:
            return ()
        return tuple(
            GroupEquation(
                name,
                self._final.by_group[group][equation],
                tuple(constant for _, constant in sorted(self._of(equation, group).items(), key=lambda item: item[0])),
            )
            for group, name in enumerate(self._groups)
        )

    def means(self, equation: int, shared: frozenset[Place]) -> tuple[Constant, ...]:
        """Return shared constants with their errors, and the means of the others without."""
        program = self._final.shown[equation]
        constants_by_group = [self._of(equation, group) for group in range(len(self._groups))]
        constants = []
        for node in constant_places(program):
            value = float(program.constants[node])
            if node not in constants_by_group[0]:
                constants.append(Constant(value))  # of a given equation
            elif (equation, node) in shared:
                constants.append(constants_by_group[0][node])
            else:
                fitted = [constant.fitted or 0.0 for by_node in constants_by_group if (constant := by_node[node])]
                is_known = all(by_node[node].identifiable for by_node in constants_by_group)
                constants.append(Constant(value, float(np.mean(fitted)), identifiable=is_known))
        return tuple(constants)

    def covariances(self) -> tuple[GroupCovariance, ...]:
        """Return the joint covariance of the constants of each group."""
        numbers: dict[int, int] = {}
        names = []
        for equation, _ in self._places:
            names.append((self._final.task.variables[equation], numbers.get(equation, 0)))
            numbers[equation] = numbers.get(equation, 0) + 1
        return tuple(
            GroupCovariance(
                name,
                Covariance(
                    tuple(names), self._errors.covariance[np.ix_(columns, columns)], self._errors.degrees_of_freedom
                )
                if names
                else None,
            )
            for name, columns in zip(self._groups, self._columns, strict=True)
        )
