"""The closest alternatives to the chosen equations, and how well each predicts trajectories that were left out. Pure.

How it works. For each equation, two kinds of programs are fitted again: programs that were already fitted in its place,
and programs that agree with it along the measured curves. Equivalent equations are dropped. If an alternative is
shorter than the model, it becomes the model, and its alternatives are ranked. So the model is the shortest description,
with two exceptions: the allowed work may end first; and in a table with inputs, an equation may be replaced by a
shorter equation that is equal on all rows. Alternatives that are nearly as short as the model make its verdict
doubtful, even if they predict worse.

Doubts. Only equations that a search has proposed can appear. Two equations are compared at the points of the dataset
and at a few points away from the measured curves; a difference at other points is not noticed.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from atoll_coordinator.model.description_length import structure_length
from atoll_coordinator.model.regression.fit import LeastSquares
from atoll_coordinator.model.selection.comparison import ModelComparison, differ
from atoll_coordinator.model.selection.cross_validation import R2, Validation
from atoll_coordinator.model.selection.local_search import LocalSearch
from atoll_coordinator.model.selection.proposals import with_target_values_of
from atoll_coordinator.model.selection.score import FittedModel
from atoll_coordinator.model.selection.task import SelectedModel
from atoll_coordinator.model.sparse.atoms import polynomial_and_fourier_libraries, sum_of
from atoll_coordinator.model.sparse.pursuit import pursue
from atoll_coordinator.model.structure.moves.neighbours import neighbours
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import EXACT_ERROR, FloatArray
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.program import Expression, Program, constant_places, structure, with_constants
from atoll_core.expression.writing.expansion import form_of
from atoll_core.expression.writing.shortest import shortest


@dataclass(frozen=True, eq=False)
class RankedAlternative:
    """A system with another equation for one variable. If it is nearly as short as the best system, `validated` is its
    R2 on trajectories left out."""

    model: FittedModel
    validated: R2 | None = None


@dataclass(frozen=True, eq=False)
class Ranking:
    """The best system, its R2 on trajectories left out, and its closest alternatives by equation."""

    selection: SelectedModel
    validated: R2 | None
    alternatives: tuple[tuple[RankedAlternative, ...], ...]


def rank_alternatives(selection: SelectedModel, inputs: FloatArray) -> Ranking:
    """Return the shortest description, which may be an alternative of `selection`, and its alternatives.

    Args:
        selection: the shortest description so far.
        inputs: points (V, R) at which equations are compared.
    """
    selection, alternatives = _select_shortest(selection, inputs)
    simplest = _select_simplest_on_rows(selection, inputs)
    if simplest is not selection:
        selection, alternatives = simplest, _find_all_alternatives(simplest, inputs)
    is_held_out = any(trajectory.held_out for trajectory in selection.task.recording.trajectories)
    validation = Validation(selection.comparison)
    own = validation.of(selection.model) if validation.is_possible and not is_held_out else None
    limit = selection.model.nats + SETTINGS.inference.distinct_nats

    def ranked(model: FittedModel) -> RankedAlternative:
        return RankedAlternative(model, None if own is None or model.nats > limit else validation.of(model))

    return Ranking(selection, own, tuple(tuple(map(ranked, models)) for models in alternatives))


def _select_shortest(selection: SelectedModel, inputs: FloatArray) -> tuple[SelectedModel, list[list[FittedModel]]]:
    """Return the selection and its alternatives; a shorter alternative replaces the selection.

    If the work budget is used up, an alternative may stay shorter than the selection; the result reports this.
    """
    until = selection.comparison.estimator.work + SETTINGS.effort.work
    while True:
        alternatives = _find_all_alternatives(selection, inputs)
        best = min(
            (model for models in alternatives for model in models[:1]),
            key=lambda model: model.nats,
            default=selection.model,
        )
        is_used_up = selection.comparison.estimator.work >= until
        if is_used_up or best.nats > selection.model.nats - SETTINGS.selection.least_gain:
            return selection, alternatives
        selection = replace(selection, model=best)


def _select_simplest_on_rows(selection: SelectedModel, inputs: FloatArray) -> SelectedModel:
    """Return the selection with equations replaced by shorter equations, if both agree on all rows up to a factor.

    For an input that switches between 0 and 1, 2.3*u/(0.16 + u**2) equals 2*u on all rows. The two differ only while
    the input changes between two rows, where it was not measured, so that a better fit there is no evidence.
    """
    comparison = selection.comparison
    if not len(comparison.estimator.measurements.inputs) or comparison.template.sides:
        return selection  # in a template, the factor of an unknown part may be given
    for equation, own in enumerate(selection.model.programs):
        if equation in comparison.fixed:
            continue
        values, longest = values_of(own, inputs), comparison.score.length(own) - SETTINGS.selection.least_gain
        candidates = [
            model.programs[equation] for (one, _), model in comparison.fitted_models.items() if one == equation
        ]
        candidates += selection.lists[equation] if selection.lists else []
        distinct = {structure(program): program for program in candidates}
        for program in sorted(distinct.values(), key=comparison.score.length):
            if comparison.score.length(program) >= longest:
                break
            if _is_multiple(values_of(program, inputs), values):
                model = comparison.fit_replacement(selection.model, equation, program, SETTINGS.effort.steps)
                selection = selection if model is None else replace(selection, model=model)
                break
    return selection


def _is_multiple(values: FloatArray, others: FloatArray) -> bool:
    """Return whether `others` (R,) are a multiple of `values` (R,) up to rounding."""
    with np.errstate(all="ignore"):
        size = float(values @ values)
        rest = others - values * (float(values @ others) / size if size > 0.0 else 0.0)
        return bool(float(rest @ rest) <= EXACT_ERROR**2 * float(others @ others))


def _find_all_alternatives(selection: SelectedModel, inputs: FloatArray) -> list[list[FittedModel]]:
    fixed = selection.comparison.fixed
    return [
        [] if index in fixed else _find_alternatives(selection, index, inputs)
        for index in range(len(selection.model.programs))
    ]


def _find_alternatives(selection: SelectedModel, index: int, inputs: FloatArray) -> list[FittedModel]:
    """Return the closest alternatives for the equation of one variable, distinct as functions, the closest first.

    The user's guesses are always included, for any length.

    Programs with the same misfit count as one function unless they differ away from the measured curves. The same form
    with other constants counts as the same equation, unless the other constants fit better.
    """
    comparison, best = selection.comparison, selection.model
    known_models = sorted(
        (model for (equation, _), model in comparison.fitted_models.items() if equation == index),
        key=lambda model: model.nats,
    )
    agreeing = _find_agreeing_programs(selection, index)
    programs = {
        structure(program): program for program in [*agreeing, *(model.programs[index] for model in known_models)]
    }
    near = comparison.narrow_down(
        best,
        index,
        list(programs.values())[: SETTINGS.effort.kept],
        ((SETTINGS.effort.steps, SETTINGS.effort.kept),),
    )
    near = sorted([*near, *_without_unnecessary_constants(comparison, best, near, index)], key=lambda model: model.nats)
    guesses = fit_guesses(selection, index)
    distinct_models, functions = [best], [values_of(best.programs[index], inputs)]
    forms = {form_of(best.programs[index])}
    shorter = best.nats - SETTINGS.selection.least_gain
    for model in comparison.distinct_models([best, *guesses, *near], index)[1:]:
        form = form_of(model.programs[index])
        if form in forms and model.nats > shorter:
            continue
        values = values_of(model.programs[index], inputs)
        if all(
            differ(values, function) or comparison.differ_off_trajectories(model, other, index)
            for other, function in zip(distinct_models, functions, strict=True)
        ):
            forms.add(form)
            functions.append(values)
            distinct_models.append(model)
    others = sorted(distinct_models[1:], key=lambda model: model.nats)
    beyond = (model for model in others[SETTINGS.effort.beam :] if any(model is guess for guess in guesses))
    return [*others[: SETTINGS.effort.beam], *beyond]


def _without_unnecessary_constants(
    comparison: ModelComparison, best: FittedModel, models: Sequence[FittedModel], index: int
) -> list[FittedModel]:
    """Return alternatives about as short as the best system, without their unnecessary constants.

    After an unnecessary constant is removed, an alternative may be the true law and shorter than the best system.
    """
    limit = best.nats + SETTINGS.inference.distinct_nats
    search = LocalSearch(comparison, lambda *_: iter(()), comparison.estimator.work)
    close = [model for model in models if model.nats <= limit][: SETTINGS.effort.beam]
    pruned = [(model, search.prune(model, index)) for model in close]
    return [shorter for model, shorter in pruned if shorter is not model]


def fit_guesses(selection: SelectedModel, index: int) -> list[FittedModel]:
    """Return the user's guesses for one equation, each fitted along the trajectories.

    All other equations are unchanged. Each guess is fitted twice: from the initial states of the selection, and from
    the smoothed states. The first fit may fail if the guess differs much from the selected equation. The second fit may
    fail on long pieces. A guess is left out if both fail.
    """
    comparison, best, steps = selection.comparison, selection.model, SETTINGS.effort.steps
    fitted = []
    for guess in selection.task.candidates[selection.task.variables[index]].fitted_guesses:
        programs = [*best.programs[:index], guess, *best.programs[index + 1 :]]
        models = [comparison.fit_from(best, programs, steps), comparison.fit_model(programs, steps)]
        known = [model for model in models if model is not None and math.isfinite(model.nats)]
        if known:
            model = min(known, key=lambda model: model.nats)
            comparison.fitted_models[index, structure(guess)] = model
            fitted.append(model)
    return fitted


def _find_agreeing_programs(selection: SelectedModel, index: int) -> list[Program]:
    """Return other possible equations of one noise-free variable, which agree along the measured curves.

    They come from the candidates. If terms are linearly dependent along the curves, they also come from the neighbours
    of the equation, and from sums that a pursuit of its values finds. Only equations that are about as short are
    returned: the odds of longer equations are negligible.
    """
    task, comparison, own = selection.task, selection.comparison, selection.model.programs[index]
    if not task.is_nearly_clean or task.recording.groups or task.is_over:
        return []
    name = task.variables[index]
    problem = with_target_values_of(own, task.dataset.problem(name), EXACT_ERROR)
    if problem is None:
        return []
    columns, operators, candidates = task.columns(name), task.operators(name), task.candidates[name].programs
    most = comparison.score.length(own) + SETTINGS.inference.exact_nats
    if any(_are_dependent(terms, problem.inputs) for terms in polynomial_and_fourier_libraries(columns, operators)):
        unfactored = most + SETTINGS.inference.exact_nats  # a pursuit adds up the lengths of terms, without factoring
        candidates += [*neighbours(own, columns, operators), *pursue(problem, columns, operators, (), unfactored)]
    squares = LeastSquares(problem, restrictions=comparison.restrictions(index))
    short = {structure(program): program for program in candidates if structure_length(program) <= most}
    limit = (SETTINGS.common.negligible * problem.target.standard_deviation) ** 2
    fitted = (squares.fit(program, enough=limit) for program in short.values())
    close = [_with_neutral_constants(candidate.program) for candidate in fitted if candidate.mse <= limit]
    others = {structure(program): program for program in close if structure(program) != structure(own)}
    return sorted(others.values(), key=comparison.score.length)[: SETTINGS.effort.beam]


def _with_neutral_constants(program: Program) -> Program:
    """Return a program without the constants that are 0, 1 or -1 up to rounding."""
    places = constant_places(program)
    near = {
        place: round(value)
        for place, value in zip(places, program.constants[places].tolist(), strict=True)
        if abs(value) < 1.5
    }
    values = {
        place: float(neutral)
        for place, neutral in near.items()
        if abs(program.constants[place] - neutral) <= SETTINGS.inference.exact
    }
    return shortest(with_constants(program, values))


def _are_dependent(terms: Sequence[Expression], inputs: FloatArray) -> bool:
    """Tell whether some terms are a linear combination of others on all measured rows."""
    columns = np.array([values_of(sum_of([term], [1.0]), inputs) for term in terms])
    sizes = np.sqrt((columns**2).sum(axis=1))
    if len(sizes) > inputs.shape[1] or not np.isfinite(sizes).all() or not (sizes > 0.0).all():
        return True
    singular = np.linalg.svd(columns / sizes[:, None], compute_uv=False)
    return bool(singular[-1] <= SETTINGS.shooting.exact * singular[0])
