"""Groups of trajectories that may differ in constants: which constants differ. Pure.

All constants begin with a value for each group. One after another, constants that differ least become shared by all
groups, as long as that makes the description shorter. A value for each group costs 1/2 ln(rows of a group), a shared
one 1/2 ln(rows). How an equation is written decides which constants there are: if r and q of x*(r - q*x) are twice as
large in one group, only r differs in r*(x - k*x*x). So each coefficient in turn is tried as a factor of the sum.

Letters: G groups, P constants of all equations, Q numbers that these are in all groups together.
"""

from collections.abc import Callable, Collection, Iterator

import numpy as np

from atoll_coordinator.model.selection.comparison import ModelComparison
from atoll_coordinator.model.selection.score import FittedModel
from atoll_coordinator.model.selection.task import SelectedModel
from atoll_coordinator.model.shooting import system
from atoll_coordinator.model.shooting.trajectory_fit import covariance
from atoll_core.expression.program import Program, structure
from atoll_core.expression.writing.expansion import factored_forms

Writer = Callable[[int, Program], Program]
"""Returns the shortest writing of the program of an equation."""


def model_of_groups(whole: SelectedModel, write: Writer) -> FittedModel:
    """Return the model with those constants shared, and in those writings, that make its description shortest."""
    comparison = whole.comparison
    best = _with_shared(comparison, whole.model)
    for equation in range(len(best.programs)):
        if equation in comparison.fixed:
            continue
        for program in _writings(whole, equation, best.programs[equation], write):
            programs = [*best.programs]
            programs[equation] = program
            kept = [place for place in _shared(comparison, best) if place[0] != equation]
            fitted = comparison.fit_from(best, programs, shared=_numbers(kept))
            if fitted is not None:
                best = min(best, _with_shared(comparison, fitted), key=lambda candidate: candidate.nats)
    return best


def _shared(comparison: ModelComparison, model: FittedModel) -> list[system.Place]:
    """Return the constants that have one number in all groups."""
    columns = model.fit.system.columns
    are_shared = (columns == columns[0]).all(axis=0).tolist()
    places = zip(comparison.places(model.fit.system), are_shared, strict=True)
    return [place for place, is_shared in places if is_shared]


def _numbers(shared: Collection[system.Place]) -> frozenset[system.SharedNumber]:
    return frozenset(((place, 1.0),) for place in shared)


def _with_shared(comparison: ModelComparison, begun: FittedModel) -> FittedModel:
    """Return `begun` with constants shared, those first that differ least, as long as the description gets shorter."""
    while True:
        following = None
        shared = _shared(comparison, begun)
        for place in _alike_first(comparison, begun)[:2]:
            fitted = comparison.fit_from(begun, begun.programs, shared=_numbers([*shared, place]))
            if fitted is not None and fitted.nats < begun.nats:
                following = fitted
                break
        if following is None:
            return begun
        begun = following


def _alike_first(comparison: ModelComparison, begun: FittedModel) -> list[system.Place]:
    """Return the constants that differ between groups, those first whose differences are the smallest for their errors.

    The statistic is the sum of squared deviations from the weighted mean over the variances (Cochran's Q).
    """
    fit = begun.fit
    values, variances = fit.system.by_place(fit.system.values), fit.system.by_place(np.diag(covariance(fit)), 2)
    weights = 1.0 / np.maximum(variances, 1e-300)
    with np.errstate(all="ignore"):
        means = (weights * values).sum(axis=0) / weights.sum(axis=0)
        statistics = np.nan_to_num((weights * (values - means) ** 2).sum(axis=0))
    places, shared = comparison.places(fit.system), _shared(comparison, begun)
    order = sorted(range(len(places)), key=lambda number: float(statistics[number]))
    return [places[number] for number in order if places[number] not in shared]


def _writings(whole: SelectedModel, equation: int, program: Program, write: Writer) -> Iterator[Program]:
    """Yield other writings of an equation: the shortest, and each coefficient as a factor of all."""
    tried = {structure(program)}
    is_free = whole.comparison.restrictions(equation).bounds is None
    for writing in (write(equation, program), *(factored_forms(program) if is_free else ())):
        if structure(writing) not in tried and whole.task.may_be_shown(writing):
            tried.add(structure(writing))
            yield writing
