"""The closest alternatives to the chosen equations, and whether one of these predicts better. Pure.

Where two descriptions are nearly as long, trajectories that were left out decide between them: their misfit takes the
place of the misfit to all trajectories and of the price of constants, which stands for it. An equation with a pole in
the region that the data visit must be shorter by `InferenceSettings.distinct_nats` than any without.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from atoll_coordinator.model.criteria import structure_length, validated_length
from atoll_coordinator.model.regression.fit import LeastSquares
from atoll_coordinator.model.selection.comparison import ModelComparison, differ
from atoll_coordinator.model.selection.cross_validation import Validated, Validation
from atoll_coordinator.model.selection.local_search import LocalSearch
from atoll_coordinator.model.selection.proposals import rates_of
from atoll_coordinator.model.selection.score import FittedModel
from atoll_coordinator.model.selection.task import SelectedModel
from atoll_coordinator.model.sparse.atoms import libraries, sum_of
from atoll_coordinator.model.sparse.pursuit import pursue
from atoll_coordinator.model.structure.moves.neighbours import neighbours
from atoll_coordinator.model.structure.poles import find_poles
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import EXACT_ERROR, FloatArray
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.program import Expression, Program, constant_places, structure, with_constants
from atoll_core.expression.writing.expansion import form_of
from atoll_core.expression.writing.shortest import shortest


@dataclass(frozen=True, eq=False)
class RankedAlternative:
    """A system with another equation for one variable, and how well it predicts, if that was looked at."""

    model: FittedModel
    validated: Validated | None = None


@dataclass(frozen=True, eq=False)
class Ranking:
    """The outcome of the ranking: the best system, how well it predicts, and its closest alternatives by equation."""

    selection: SelectedModel
    validated: Validated | None
    alternatives: tuple[tuple[RankedAlternative, ...], ...]


def rank_alternatives(selection: SelectedModel, inputs: FloatArray) -> Ranking:
    """Return the end of the ranking.

    Args:
        selection: the shortest description.
        inputs: points (V, R) at which equations are compared.
    """
    selection, alternatives = _shortest(selection, inputs)
    selection, alternatives = _without_unearned_poles(selection, alternatives, inputs)
    simplest = _simplest_on_rows(selection, inputs)
    if simplest is not selection:
        selection, alternatives = simplest, _all_alternatives(simplest, inputs)
    is_held_out = any(trajectory.held_out for trajectory in selection.task.recording.trajectories)
    validation = Validation(selection.comparison)
    if is_held_out or not validation.is_possible:
        return Ranking(selection, None, tuple(tuple(map(RankedAlternative, models)) for models in alternatives))
    own = validation.of(selection.model)
    if own is None:
        return Ranking(selection, None, tuple(tuple(map(RankedAlternative, models)) for models in alternatives))
    validated = [_validated(validation, models, selection.model) for models in alternatives]
    winner = _winner(selection.model, own, validated)
    if winner is not None:
        selection = replace(selection, model=winner.model)
        own = winner.validated or own
        validated = [_validated(validation, models, selection.model) for models in _all_alternatives(selection, inputs)]
    return Ranking(selection, own, tuple(map(tuple, validated)))


def _shortest(selection: SelectedModel, inputs: FloatArray) -> tuple[SelectedModel, list[list[FittedModel]]]:
    """Return the selection and its alternatives, none of which is shorter: one that lost before may win now.

    If the work of a part of the selection is used up, an alternative may stay shorter; the result reports this.
    """
    until = selection.comparison.estimator.work + SETTINGS.effort.work
    while True:
        alternatives = _all_alternatives(selection, inputs)
        best = min(
            (model for models in alternatives for model in models[:1]),
            key=lambda model: model.nats,
            default=selection.model,
        )
        is_used_up = selection.comparison.estimator.work >= until
        if is_used_up or best.nats > selection.model.nats - SETTINGS.selection.least_gain:
            return selection, alternatives
        selection = replace(selection, model=best)


def _simplest_on_rows(selection: SelectedModel, inputs: FloatArray) -> SelectedModel:
    """Return the selection, equations exchanged for shorter ones that are multiples of them at all measured points.

    For an input that is switched between 0 and 1, 2.3*u/(0.16 + u**2) equals 2*u on all rows; the two differ only while
    the input changes between two rows, which was not measured.
    """
    comparison = selection.comparison
    if not len(comparison.estimator.measurements.inputs):
        return selection
    for equation, own in enumerate(selection.model.programs):
        if equation in comparison.fixed:
            continue
        values, longest = values_of(own, inputs), comparison.score.length(own) - SETTINGS.selection.least_gain
        tried = [
            model.programs[equation]
            for (tried_equation, _), model in comparison.tried.items()
            if tried_equation == equation
        ]
        tried += selection.lists[equation] if selection.lists else []
        for program in sorted({structure(program): program for program in tried}.values(), key=comparison.score.length):
            if comparison.score.length(program) >= longest:
                break
            if _is_multiple(values_of(program, inputs), values):
                model = comparison.fit_exchanged(selection.model, equation, program, SETTINGS.effort.steps)
                selection = selection if model is None else replace(selection, model=model)
                break
    return selection


def _is_multiple(values: FloatArray, others: FloatArray) -> bool:
    """Tell whether values are a multiple of others up to rounding."""
    with np.errstate(all="ignore"):
        size = float(values @ values)
        rest = others - values * (float(values @ others) / size if size > 0.0 else 0.0)
        return bool(float(rest @ rest) <= EXACT_ERROR**2 * float(others @ others))


def _without_unearned_poles(
    selection: SelectedModel, alternatives: list[list[FittedModel]], inputs: FloatArray
) -> tuple[SelectedModel, list[list[FittedModel]]]:
    """Return the selection with equations whose poles are not earned exchanged, one after another."""
    for index, own in enumerate(selection.model.programs):
        if index in selection.comparison.fixed or not find_poles(own, inputs):
            continue
        limit = selection.model.nats + SETTINGS.inference.distinct_nats
        near = (alternative for alternative in alternatives[index] if alternative.nats <= limit)
        replacement = next(
            (alternative for alternative in near if not find_poles(alternative.programs[index], inputs)), None
        )
        if replacement is not None:
            selection = replace(selection, model=replacement)
            alternatives = _all_alternatives(selection, inputs)
    return selection, alternatives


def _winner(
    model: FittedModel, own: Validated, alternatives: Sequence[Sequence[RankedAlternative]]
) -> RankedAlternative | None:
    """Return the alternative that is close behind and predicts best, and clearly better than the one in front, or None.

    Alternatives with more constants are left out: their gain on few trajectories is often chance.
    """
    best, winner = validated_length(own.misfit, model.programs) - SETTINGS.inference.distinct_nats, None
    for alternative in (alternative for equation_alternatives in alternatives for alternative in equation_alternatives):
        if alternative.validated is None or alternative.model.nats > model.nats + SETTINGS.inference.distinct_nats:
            continue
        if alternative.model.fit.system.count > model.fit.system.count:
            continue
        nats = validated_length(alternative.validated.misfit, alternative.model.programs)
        if nats < best:
            best, winner = nats, alternative
    return winner


def _validated(
    validation: Validation, alternatives: Sequence[FittedModel], best: FittedModel
) -> list[RankedAlternative]:
    return [
        RankedAlternative(
            model,
            validation.of(model) if model.nats <= best.nats + SETTINGS.inference.distinct_nats else None,
        )
        for model in alternatives
    ]


def _all_alternatives(selection: SelectedModel, inputs: FloatArray) -> list[list[FittedModel]]:
    fixed = selection.comparison.fixed
    return [
        [] if index in fixed else _alternatives(selection, index, inputs)
        for index in range(len(selection.model.programs))
    ]


def _alternatives(selection: SelectedModel, index: int, inputs: FloatArray) -> list[FittedModel]:
    """Return the closest alternatives for the equation of one variable, distinct as functions, the closest first.

    The user's guesses are among them, however far behind they are.

    Programs of the same misfit count as one function unless they differ off the measured curves, also if groups have
    their own constants. The same form with other constants is the same equation, unless they fit better.
    """
    comparison, best = selection.comparison, selection.model
    tried = sorted(
        (model for (equation, _), model in comparison.tried.items() if equation == index), key=lambda model: model.nats
    )
    agreeing = _agreeing(selection, index)
    programs = {structure(program): program for program in [*agreeing, *(model.programs[index] for model in tried)]}
    near = comparison.narrow_down(
        best,
        index,
        list(programs.values())[: SETTINGS.effort.kept],
        ((SETTINGS.effort.steps, SETTINGS.effort.kept),),
        most=math.inf,
    )
    near = sorted([*near, *_without_needless_constants(comparison, best, near, index)], key=lambda model: model.nats)
    guesses = fit_guesses(selection, index)
    distinct_models, functions = [best], [values_of(best.programs[index], inputs)]
    forms = {form_of(best.programs[index])}
    shorter = best.nats - SETTINGS.selection.least_gain
    for model in comparison.distinct([best, *guesses, *near], index)[1:]:
        form = form_of(model.programs[index])
        if form in forms and model.nats > shorter:
            continue
        values = values_of(model.programs[index], inputs)
        if all(
            differ(values, function) or comparison.differ_beside(model, other, index)
            for other, function in zip(distinct_models, functions, strict=True)
        ):
            forms.add(form)
            functions.append(values)
            distinct_models.append(model)
    others = sorted(distinct_models[1:], key=lambda model: model.nats)
    beyond = (model for model in others[SETTINGS.effort.beam :] if any(model is guess for guess in guesses))
    return [*others[: SETTINGS.effort.beam], *beyond]


def _without_needless_constants(
    comparison: ModelComparison, best: FittedModel, models: Sequence[FittedModel], index: int
) -> list[FittedModel]:
    """Return alternatives about as short as the best system, without their unnecessary constants.

    Without such a constant an alternative may be the law, and shorter than the best system.
    """
    limit = best.nats + SETTINGS.inference.distinct_nats
    search = LocalSearch(comparison, lambda *_: iter(()), comparison.estimator.work)
    close = [model for model in models if model.nats <= limit][: SETTINGS.effort.beam]
    pruned = [(model, search.prune(model, index)) for model in close]
    return [shorter for model, shorter in pruned if shorter is not model]


def fit_guesses(selection: SelectedModel, index: int) -> list[FittedModel]:
    """Return the user's guesses for one equation, each fitted along the trajectories, all other equations as they are.

    Every guess begins from the fit of the selection, and once more from its own constants and the smoothed states: far
    from the selection the one may fail, in long pieces the other. One that fails twice cannot be simulated.
    """
    comparison, best, steps = selection.comparison, selection.model, SETTINGS.effort.steps
    fitted = []
    for guess in selection.task.candidates[selection.task.variables[index]].fitted_guesses:
        programs = [*best.programs[:index], guess, *best.programs[index + 1 :]]
        models = [comparison.fit_beside(best, programs, steps), comparison.fit_model(programs, steps)]
        known = [model for model in models if model is not None and math.isfinite(model.nats)]
        if known:
            model = min(known, key=lambda model: model.nats)
            comparison.tried[index, structure(guess)] = model
            fitted.append(model)
    return fitted


def _agreeing(selection: SelectedModel, index: int) -> list[Program]:
    """Return other possible equations of one variable without noise, which agree along the measured curves.

    These are candidates, its neighbours if terms are dependent along the curves, and sums that a pursuit of its values
    finds. Only equations about as short are returned: the odds of others are too small to count.
    """
    task, comparison, own = selection.task, selection.comparison, selection.model.programs[index]
    if not task.is_nearly_clean or task.recording.groups or task.is_over:
        return []
    name = task.variables[index]
    problem = rates_of(own, task.dataset.problem(name), EXACT_ERROR)
    if problem is None:
        return []
    columns, operators, candidates = task.columns(name), task.operators(name), task.candidates[name].programs
    most = comparison.score.length(own) + SETTINGS.inference.exact_nats
    if any(_are_dependent(terms, problem.inputs) for terms in libraries(columns, operators)):
        unfactored = most + SETTINGS.inference.exact_nats  # it prices sums term by term
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
