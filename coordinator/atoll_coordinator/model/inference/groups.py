"""Groups of trajectories that may differ in constants: which constants differ, and their estimates. Pure.

All constants begin with a value for each group. One after another, constants that differ least become shared by all
groups, as long as that makes the description shorter. A value for each group costs 1/2 ln(rows of a group), a shared
one 1/2 ln(rows). How an equation is written decides which constants there are: if r and q of x*(r - q*x) are twice as
large in one group, only r differs in r*(x - k*x*x). So each coefficient in turn is tried as a factor of the sum.

Letters: G groups, P constants of all equations, Q numbers that these are in all groups together.
"""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from atoll_coordinator.model.constants.standard_errors import ConstantErrors, joint_covariance
from atoll_coordinator.model.selection.comparison import ModelComparison
from atoll_coordinator.model.selection.score import FittedModel
from atoll_coordinator.model.selection.task import SelectedModel
from atoll_coordinator.model.shooting import system
from atoll_coordinator.model.shooting.trajectory_fit import covariance
from atoll_coordinator.result.equations import Constant
from atoll_coordinator.result.findings import Covariance, Place
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.program import Program, constant_places, structure
from atoll_core.expression.writing.expansion import factored_forms

Writer = Callable[[int, Program], Program]
"""Returns the shortest writing of the program of an equation."""


@dataclass(frozen=True, eq=False)
class ModelOfGroups:
    """A fitted system, and the constants of it that all groups have in common."""

    model: FittedModel
    shared: frozenset[system.Place] = frozenset()


def model_of_groups(whole: SelectedModel, write: Writer) -> ModelOfGroups:
    """Return the model with those constants shared, and in those writings, that make its description shortest."""
    comparison = whole.comparison
    begun = best = _with_shared(comparison, ModelOfGroups(whole.model))
    for equation in range(len(begun.model.programs)):
        if equation in comparison.fixed:
            continue
        for program in _writings(whole, equation, best.model.programs[equation], write):
            programs = [*best.model.programs]
            programs[equation] = program
            kept = frozenset(place for place in best.shared if place[0] != equation)
            fitted = comparison.fit_beside(best.model, programs, shared=_numbers(kept))
            if fitted is not None:
                trial = _with_shared(comparison, ModelOfGroups(fitted, kept))
                best = min(best, trial, key=lambda candidate: candidate.model.nats)
    return best


def _numbers(shared: Collection[system.Place]) -> frozenset[system.SharedNumber]:
    return frozenset(((place, 1.0),) for place in shared)


def _with_shared(comparison: ModelComparison, begun: ModelOfGroups) -> ModelOfGroups:
    """Return `begun` with constants shared, those first that differ least, as long as the description gets shorter."""
    while True:
        following = None
        for place in _alike_first(comparison, begun)[:2]:
            shared = begun.shared | {place}
            fitted = comparison.fit_beside(begun.model, begun.model.programs, shared=_numbers(shared))
            if fitted is not None and fitted.nats < begun.model.nats:
                following = ModelOfGroups(fitted, shared)
                break
        if following is None:
            return begun
        begun = following


def _alike_first(comparison: ModelComparison, begun: ModelOfGroups) -> list[system.Place]:
    """Return the constants that differ between groups, those first whose differences are the smallest for their errors.

    The statistic is the sum of squared deviations from the weighted mean over the variances (Cochran's Q).
    """
    fit = begun.model.fit
    values, variances = fit.system.by_place(fit.system.values), fit.system.by_place(np.diag(covariance(fit)), 2)
    weights = 1.0 / np.maximum(variances, 1e-300)
    with np.errstate(all="ignore"):
        means = (weights * values).sum(axis=0) / weights.sum(axis=0)
        statistics = np.nan_to_num((weights * (values - means) ** 2).sum(axis=0))
    places = comparison.places(fit.system)
    order = sorted(range(len(places)), key=lambda number: float(statistics[number]))
    return [places[number] for number in order if places[number] not in begun.shared]


def _writings(whole: SelectedModel, equation: int, program: Program, write: Writer) -> Iterator[Program]:
    """Yield other writings of an equation: the shortest, and each coefficient as a factor of all."""
    tried = {structure(program)}
    is_free = whole.comparison.restrictions(equation).bounds is None
    for writing in (write(equation, program), *(factored_forms(program) if is_free else ())):
        if structure(writing) not in tried and whole.task.may_be_shown(writing):
            tried.add(structure(writing))
            yield writing


class GroupConstants:
    """The constants of a model by group, with their errors."""

    def __init__(self, comparison: ModelComparison, chosen: ModelOfGroups, values: FloatArray) -> None:
        """`values` (Q,) are the numbers as they are shown."""
        self._comparison = comparison
        self._system = chosen.model.fit.system
        self._places = comparison.places(self._system)
        self._values = values.tolist()
        self.shared = chosen.shared

    def of_equation(
        self, errors: ConstantErrors, equation: int, program: Program, groups: int
    ) -> tuple[tuple[Constant, ...], list[tuple[Constant, ...]]]:
        """Return the constants of an equation in node order, of all groups together and of each.

        All groups together have the shared constants with their errors, and the means of the others without.
        """
        nodes = constant_places(program)
        if equation in self._comparison.fixed:
            return tuple(Constant(value=float(program.constants[node])) for node in nodes), []
        by_group = [self._of_group(errors, equation, group) for group in range(groups)]
        together = []
        for node in nodes:
            constants = [of_group[node] for of_group in by_group]
            value, known = float(program.constants[node]), constants[0]
            if not known.shared:
                fitted = float(np.mean([constant.fitted or 0.0 for constant in constants]))
                is_known = all(constant.identifiable for constant in constants)
                known = Constant(value=value, fitted=fitted, identifiable=is_known, shared=False)
            together.append(known)
        return tuple(together), [tuple(of_group[node] for node in nodes) for of_group in by_group]

    def _of_group(self, errors: ConstantErrors, equation: int, group: int) -> Mapping[int, Constant]:
        """Return the fitted constants of an equation in one group, by node."""
        return {
            node: errors.described(column, self._values[column], shared=(equation, node) in self.shared)
            for column, (owner, node) in zip(self._system.columns[group].tolist(), self._places, strict=True)
            if owner == equation
        }

    def covariances(self, errors: ConstantErrors, variables: Sequence[str]) -> list[Covariance | None]:
        """Return the joint covariance of the constants of each group."""
        counts = dict.fromkeys(variables, 0)
        places = []
        for equation, _ in self._places:
            name = variables[equation]
            places.append(Place(variable=name, constant=counts[name]))
            counts[name] += 1
        return [
            joint_covariance(places, errors.covariance[np.ix_(columns, columns)], errors.degrees_of_freedom)
            for columns in self._system.columns
        ]

    @property
    def are_one(self) -> bool:
        """Whether all groups have all constants in common."""
        return self.shared.issuperset(self._places)
