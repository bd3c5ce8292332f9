"""Groups of trajectories that may differ in constants: decides which constants differ. Pure.

`choose_shared_constants` starts with a separate value of every constant for each group. One after another, the
constants that differ least between groups become shared, as long as the description gets shorter. A value for one group
costs 1/2 ln(rows of the group), a shared value 1/2 ln(rows). How many constants differ depends on the form of the
equation. For example, let r and q of x*(r - q*x) be twice as large in one group: in the form r*(x - k*x*x) only r
differs. So each coefficient in turn is tried as a common factor of the sum.

Doubtful: the choice is greedy, and only the two most similar constants are tried in each step. A constant is either the
same in all groups or different in each group: subsets of groups are not considered.

Letters: G groups, P constants of all equations, Q fitted numbers: the different values of these constants in all
groups.
"""

from collections.abc import Callable, Collection, Iterator

import numpy as np

from atoll_coordinator.model.selection.comparison import ModelComparison
from atoll_coordinator.model.selection.score import FittedModel
from atoll_coordinator.model.selection.task import SelectedModel
from atoll_coordinator.model.shooting import system
from atoll_coordinator.model.shooting.fit_result import covariance
from atoll_core.expression.program import Program, structure
from atoll_core.expression.writing.expansion import factored_forms

Writer = Callable[[int, Program], Program]
"""A function of an equation (index, program). It returns the shortest writing of the program."""


def choose_shared_constants(whole: SelectedModel, write: Writer) -> FittedModel:
    """Return the model with the shortest description, over choices of the shared constants and of the forms of its
    equations."""
    comparison = whole.comparison
    best = _share_similar_constants(comparison, whole.model)
    for equation in range(len(best.programs)):
        if equation in comparison.fixed:
            continue
        for program in _generate_writings(whole, equation, best.programs[equation], write):
            programs = [*best.programs]
            programs[equation] = program
            kept = [place for place in _find_shared_constants(comparison, best) if place[0] != equation]
            fitted = comparison.fit_from(best, programs, shared=_shared_numbers(kept))
            if fitted is not None:
                best = min(best, _share_similar_constants(comparison, fitted), key=lambda candidate: candidate.nats)
    return best


def _find_shared_constants(comparison: ModelComparison, model: FittedModel) -> list[system.Place]:
    """Return the constants that have the same value in all groups."""
    columns = model.fit.system.columns
    are_shared = (columns == columns[0]).all(axis=0).tolist()
    places = zip(comparison.places(model.fit.system), are_shared, strict=True)
    return [place for place, is_shared in places if is_shared]


def _shared_numbers(shared: Collection[system.Place]) -> frozenset[system.SharedNumber]:
    return frozenset(((place, 1.0),) for place in shared)


def _share_similar_constants(comparison: ModelComparison, start: FittedModel) -> FittedModel:
    """Return `start` with constants shared one by one, as long as the description gets shorter."""
    while True:
        following = None
        shared = _find_shared_constants(comparison, start)
        for place in _rank_by_difference(comparison, start)[:2]:
            fitted = comparison.fit_from(start, start.programs, shared=_shared_numbers([*shared, place]))
            if fitted is not None and fitted.nats < start.nats:
                following = fitted
                break
        if following is None:
            return start
        start = following


def _rank_by_difference(comparison: ModelComparison, start: FittedModel) -> list[system.Place]:
    """Return the constants that differ between groups, the least significant differences first.

    The statistic is Cochran's Q: the sum, over groups, of the squared deviation from the weighted mean, divided by the
    variance.
    """
    fit = start.fit
    values, variances = fit.system.by_place(fit.system.values), fit.system.by_place(np.diag(covariance(fit)), 2)
    weights = 1.0 / np.maximum(variances, 1e-300)
    with np.errstate(all="ignore"):
        means = (weights * values).sum(axis=0) / weights.sum(axis=0)
        statistics = np.nan_to_num((weights * (values - means) ** 2).sum(axis=0))
    places, shared = comparison.places(fit.system), _find_shared_constants(comparison, start)
    order = sorted(range(len(places)), key=lambda number: float(statistics[number]))
    return [places[number] for number in order if places[number] not in shared]


def _generate_writings(whole: SelectedModel, equation: int, program: Program, write: Writer) -> Iterator[Program]:
    """Yield other forms of an equation: the shortest form, and forms with one coefficient as a common factor."""
    tried = {structure(program)}
    is_free = whole.comparison.restrictions(equation).bounds is None
    for writing in (write(equation, program), *(factored_forms(program) if is_free else ())):
        if structure(writing) not in tried and whole.task.may_be_shown(writing):
            tried.add(structure(writing))
            yield writing
