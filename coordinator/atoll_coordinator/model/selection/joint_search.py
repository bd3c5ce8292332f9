"""The best system of all candidates, one equation exchanged at a time, and shorter descriptions nearby (ADR 0021).

From the best systems the descent looks for shorter descriptions nearby; unnecessary parts are left out. All
work is bounded by counts, never by the clock.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import combinations, product

import numpy as np

from atoll_coordinator.model.description_length import is_function
from atoll_coordinator.model.selection.comparison import ModelComparison
from atoll_coordinator.model.selection.local_search import LocalSearch
from atoll_coordinator.model.selection.score import FittedModel
from atoll_coordinator.model.selection.task import ModellingTask, SelectedModel
from atoll_coordinator.model.structure.moves.extensions import extensions, further_terms, leaps
from atoll_coordinator.model.structure.moves.neighbours import neighbours
from atoll_coordinator.settings import SETTINGS, Rounds
from atoll_core.expression.program import Program, structure
from atoll_core.expression.writing.expansion import expand_program


def fit_jointly(
    task: ModellingTask, lists: Sequence[Sequence[Program]], begun: Sequence[Program] | None = None, *,
    are_laws: bool = False,
) -> SelectedModel | None:  # fmt: skip
    """Return the best system of these candidates, None when none can be simulated.

    Args:
        task: what is modelled.
        lists: candidates of each variable, the best first.
        begun: a system to begin with; the best of a few unless given.
        are_laws: whether no terms are sought beyond the terms of the candidates, so that no term can describe errors
            of coarse integration steps.
    """
    comparison = task.comparison
    best = combine(comparison, lists) if begun is None else comparison.fit_model(begun)
    if best is None:
        return None
    if not are_laws:
        comparison, best = _without_noise(task, comparison, best)
    comparison, best = comparison.calibrated(best)
    comparison, best = comparison.calibrated(exchange(comparison, best, lists))
    return SelectedModel(task, comparison, best, lists)


def search_jointly(
    task: ModellingTask,
    lists: Sequence[Sequence[Program]],
    begun: Sequence[Program] | None = None,
    is_hopeless: Callable[[SelectedModel], bool] = lambda _: False,
) -> SelectedModel | None:
    """Return the best system of these candidates and their neighbourhood, see `fit_jointly`.

    `is_hopeless` tells of the best of the candidates when its neighbours need not be looked at.
    """
    selection = fit_jointly(task, lists, begun)
    if selection is None:
        return None
    comparison, best = selection.comparison, selection.model
    if comparison.score.is_exact(best):
        best = reduce_all(comparison, best)
    elif not is_hopeless(selection):
        best = search_locally(task, comparison, best, lists)
    return replace(selection, model=comparison.fit_beside(best, best.programs) or best)


def _without_noise(
    task: ModellingTask, comparison: ModelComparison, best: FittedModel
) -> tuple[ModelComparison, FittedModel]:
    """Return comparison and system treated as noise-free if that system shows that there is no noise, else unchanged.

    With few rows, or few rows in a period, a smoother treats motion that it cannot follow as noise. Integration steps
    with errors relative to such noise would be so coarse that unnecessary terms describe the integration errors.
    """
    limit = SETTINGS.selection.least_noise * comparison.estimator.measurements.scales
    observed = comparison.estimator.measurements.observed
    if task.is_nearly_clean or np.any(best.fit.squares > limit[observed] ** 2):
        return comparison, best
    precise = task.compare(comparison.estimator.measurements, task.variables, has_noise=False)
    model = precise.fit_beside(best, best.programs)
    return (comparison, best) if model is None else (precise, model)


def combine(comparison: ModelComparison, lists: Sequence[Sequence[Program]]) -> FittedModel | None:
    """Return the best of a few systems to begin with: the best of each list, one variable's next ones at a time."""
    first = [programs[0] for programs in lists]
    systems = [first] + [
        [*first[:index], program, *first[index + 1 :]]
        for index, programs in enumerate(lists)
        for program in programs[1 : SETTINGS.effort.rounds[1][1] + 1]
    ]
    systems += [
        [programs[min(rank, len(programs) - 1)] for programs in lists]
        for rank in range(1, SETTINGS.effort.rounds[1][1] + 1)
    ]
    models = comparison.fit_all(systems)
    if not models and comparison.estimator.deadline.is_over:
        return comparison.fit_model(first)  # as it is, without a step
    return models[0] if models else None


def exchange(
    comparison: ModelComparison, best: FittedModel, lists: Sequence[Sequence[Program]],
    rounds: Rounds = SETTINGS.effort.rounds,
) -> FittedModel:  # fmt: skip
    """Return the best system found by exchanging the program of one variable at a time; at first of all variables.

    If the residuals are integration errors, no longer program could make the description shorter. Candidates are
    narrowed down in `rounds`. With other workers, the candidates for all equations are fitted at the same time, as if
    the best system stayed the same: after an exchange the later results are dropped.
    """
    until = comparison.estimator.work + SETTINGS.effort.work
    if comparison.score.is_exact(best):
        lengths = [comparison.score.length(program) for program in best.programs]
        lists = [
            [program for program in programs if comparison.score.length(program) < length] or [own]
            for programs, length, own in zip(lists, lengths, best.programs, strict=True)
        ]
    tried: Sequence[Sequence[Program]] = lists
    while True:
        begun, promising_lists = best, _exchangeable(comparison, best, tried)
        foreseen = comparison.foresee(begun, promising_lists, rounds)
        for equation in range(len(tried)):
            ahead = foreseen.get(equation) if best is begun else None
            if ahead is not None and comparison.estimator.work + ahead.work < until:
                models = comparison.take_in(equation, ahead)
            else:
                promising_lists = promising_lists if best is begun else _exchangeable(comparison, best, tried)
                models = comparison.narrow_down(best, equation, promising_lists.get(equation, ()), rounds, until)
            if models and models[0].nats < best.nats - SETTINGS.selection.least_gain:
                best = models[0]
        if best.nats > begun.nats - SETTINGS.selection.least_gain:
            best = _exchange_two(comparison, best)
        if best.nats > begun.nats - SETTINGS.selection.least_gain or comparison.estimator.work >= until:
            return best
        tried = [programs[: SETTINGS.effort.kept] for programs in lists]


def _exchange_two(comparison: ModelComparison, best: FittedModel) -> FittedModel:
    """Return the best system, or a shorter description with two equations exchanged at the same time.

    Where noise hides the difference between alternatives, the best equation of one state depends on the equation of
    another, so that no single exchange leads on: with 21 rows of hares and lynxes the system of both best alternatives
    was 2 nats shorter. The pairs whose alternatives are closest are fitted.
    """
    alternatives: list[list[tuple[float, Program]]] = [[] for _ in best.programs]
    for (equation, _), model in comparison.tried.items():
        excess = model.nats - best.nats
        if excess < SETTINGS.inference.distinct_nats and equation not in comparison.fixed:
            alternatives[equation].append((excess, model.programs[equation]))
    pairs = [
        (one + other, first, second, program, partner)
        for first, second in combinations(range(len(alternatives)), 2)
        for (one, program), (other, partner) in product(alternatives[first], alternatives[second])
    ]
    pairs.sort(key=lambda pair: pair[0])
    systems = [
        [{first: program, second: partner}.get(index, own) for index, own in enumerate(best.programs)]
        for _, first, second, program, partner in pairs[: SETTINGS.effort.beam]
    ]
    models = comparison.fit_all(systems) if systems else []
    return models[0] if models and models[0].nats < best.nats - SETTINGS.selection.least_gain else best


def _exchangeable(
    comparison: ModelComparison, best: FittedModel, lists: Sequence[Sequence[Program]]
) -> dict[int, list[Program]]:
    """Return by equation the programs that may be better; equations without such programs are left out."""
    room = comparison.score.room(best)
    lengths = [comparison.score.affordable(best, equation, room) for equation in range(len(lists))]
    shorter = [
        [program for program in others if comparison.score.length(program) < most]
        for others, most in zip(lists, lengths, strict=True)
    ]
    return {
        equation: programs
        for equation, programs in enumerate(shorter)
        if programs and (len(programs) > 1 or programs[0] is not best.programs[equation])
    }


def search_locally(
    task: ModellingTask, comparison: ModelComparison, best: FittedModel, lists: Sequence[Sequence[Program]]
) -> FittedModel:
    """Return the end of the descent from the best system.

    If the residuals of the system are noise, programs so long that no misfit could make them better are not tried.
    """
    room = comparison.score.room(best)
    has_room = comparison.score.has_room(best)

    def around(equation: int, program: Program) -> Iterator[Program]:
        name = task.variables[equation]
        operators, columns = task.operators(name), task.columns(name)
        longer = extensions(program, task.sizes_for(name), operators) if has_room else ()
        yield from promising(program, (*longer, *neighbours(program, columns, operators)))

    def beyond(equation: int, program: Program) -> Iterator[Program]:
        return promising(program, leaps(program, task.operators(task.variables[equation])))

    def promising(program: Program, others: Iterable[Program]) -> Iterator[Program]:
        most = comparison.score.length(program) + room
        affordable = (candidate for candidate in others if comparison.score.length(candidate) < most)
        return filter(task.may_be_shown, affordable)

    descent = LocalSearch(comparison, around, comparison.estimator.work + SETTINGS.effort.work, beyond)
    equations = [index for index, _ in enumerate(lists) if index not in comparison.fixed]
    best = descent.improve(best, equations)
    for equation in equations if has_room else ():
        best = _restarted(comparison, descent, best, equation, lists[equation])
    best = exchange(comparison, best, lists)
    return reduce_all(comparison, best)


def search_terms(
    task: ModellingTask, comparison: ModelComparison, best: FittedModel, lists: Sequence[Sequence[Program]],
    pairs: Sequence[Sequence[Program]], until: int,
) -> FittedModel:  # fmt: skip
    """Return the end of the descent from the best system by one term more or less in one equation.

    Each is fitted along the trajectories, begun from the system as it is, until the estimator's work is `until`. All
    terms are tried, however small the residuals are: the other constants of a system partly compensate for a
    missing term, so that noise hides the remaining pattern. The expanded sum itself is tried as
    well: each of its terms can go, or lose its coefficient. Where an equation has functions, the
    best of its candidates (`lists`) without any is another beginning, and so is the best of some sums of two terms
    (`pairs`): adding one term to the equation does not reach these.
    """

    def around(equation: int, program: Program) -> Iterator[Program]:
        name = task.variables[equation]
        expansion = expand_program(program)
        expanded = (
            () if expansion is None or structure(expansion.program) == structure(program) else (expansion.program,)
        )
        longer = further_terms(program, task.sizes_for(name), task.operators(name))
        return filter(task.may_be_shown, (*expanded, *longer))

    equations = [index for index, _ in enumerate(best.programs) if index not in comparison.fixed]
    descent = LocalSearch(comparison, around, until, is_thorough=False)
    end = descent.improve(best, equations)
    for equation in equations:
        if lists and _kind(end.programs[equation]):
            end = _restarted(comparison, descent, end, equation, lists[equation])
        end = _restarted(comparison, descent, end, equation, pairs[equation])
    return end if end is best else reduce_all(comparison, end)


def recalibrated(
    comparison: ModelComparison, best: FittedModel, others: Sequence[FittedModel]
) -> tuple[ModelComparison, FittedModel]:
    """Return the comparison by the errors that the residuals of the best system show, and that system.

    The closest alternatives, and those of `others`, are compared again.
    """
    tried = sorted(comparison.tried.items(), key=lambda item: item[1].nats)
    comparison, best = comparison.calibrated(comparison.fit_beside(best, best.programs) or best)
    for equation, own in enumerate(best.programs):
        if equation in comparison.fixed:
            continue
        programs = [other.programs[equation] for other in others]
        programs += [model.programs[equation] for (changed, _), model in tried if changed == equation]
        distinct = {structure(program): program for program in reversed(programs)}
        distinct.pop(structure(own), None)
        nearest = list(reversed(distinct.values()))[: SETTINGS.effort.kept]
        compare_rivals(comparison, best, equation, nearest)
    return comparison, best


def compare_rivals(
    comparison: ModelComparison, best: FittedModel, equation: int, programs: Sequence[Program]
) -> None:  # fmt: skip
    """Fit programs in the place of one equation, and remember the best; the first without needless constants.

    With unnecessary constants, an alternative counts as an elaboration of the equation.
    """
    effort = SETTINGS.effort
    rounds = (effort.rounds[0], (effort.brief_steps, effort.beam))
    descent = LocalSearch(comparison, lambda *_: iter(()), comparison.estimator.work)
    for rival in comparison.narrow_down(best, equation, programs, rounds)[: effort.rounds[1][1]]:
        pruned = descent.prune(rival, equation)
        comparison.tried[equation, structure(pruned.programs[equation])] = pruned


def reduce_all(comparison: ModelComparison, best: FittedModel) -> FittedModel:
    """Return a system without the unnecessary parts of its equations."""
    last = LocalSearch(comparison, lambda *_: iter(()), comparison.estimator.work + SETTINGS.effort.work)
    for equation in range(len(best.programs)):
        if equation not in comparison.fixed:
            best = last.reduce(best, equation)
    return best


def _restarted(
    comparison: ModelComparison, descent: LocalSearch, best: FittedModel, equation: int, programs: Sequence[Program]
) -> FittedModel:
    """Return the best end of descents that begin with other programs for one equation, all others as they are."""
    effort = SETTINGS.effort
    rounds = (effort.rounds[0], (effort.brief_steps, effort.beam))
    others = comparison.narrow_down(best, equation, programs[: effort.kept], rounds)
    by_kind = {_kind(model.programs[equation]): model for model in reversed(others)}
    for start in sorted(by_kind.values(), key=lambda model: model.nats):
        if descent.is_exhausted:
            break
        end = descent.improve(start, [equation])
        if end.nats < best.nats - SETTINGS.selection.least_gain:
            best = descent.improve(
                end, [*(index for index in range(len(best.programs)) if index not in comparison.fixed)]
            )
    return best


def _kind(program: Program) -> bool:
    """Return whether a program has functions: descents from other kinds end elsewhere."""
    return any(is_function(code) for code in program.operators.tolist())
