"""The best system of all candidates: programs are exchanged, then similar systems with shorter descriptions are
searched (ADR 0021).

How it works. `find_starting_system` fits a few combinations of the best candidates. `exchange_programs` then tries the
candidates of each equation in turn, with all other equations unchanged, until no exchange shortens the description.
`search_locally` changes equations at single nodes, restarts from other candidates, and removes unnecessary parts.
`search_terms` adds or removes single terms along the trajectories. Between these steps, the error model is estimated
again from the residuals of the best system. All work is limited by counts, not by the clock.

Doubts. If two equations must change together, an exchange of one equation at a time does not find the system. The
search ends early if its budget is used up.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import combinations, product

import numpy as np

from atoll_coordinator.model.description_length import is_function
from atoll_coordinator.model.selection.comparison import STAGES, ModelComparison
from atoll_coordinator.model.selection.local_search import LocalSearch
from atoll_coordinator.model.selection.score import FittedModel
from atoll_coordinator.model.selection.task import ModellingTask, SelectedModel
from atoll_coordinator.model.structure.moves.extensions import extensions, further_terms, leaps
from atoll_coordinator.model.structure.moves.neighbours import neighbours
from atoll_coordinator.settings import SETTINGS, Rounds
from atoll_core.expression.program import Program, structure
from atoll_core.expression.writing.expansion import expand_program


def fit_jointly(
    task: ModellingTask, lists: Sequence[Sequence[Program]], start: Sequence[Program] | None = None, *,
    are_laws: bool = False, known: Sequence[Program] | None = None,
) -> SelectedModel | None:  # fmt: skip
    """Return the best system of these candidates; None if no system can be simulated.

    Args:
        task: the measurements and candidates.
        lists: candidates of each variable, the best first.
        start: programs of the first system; None: the best of a few combinations.
        are_laws: whether all candidates are laws. Then no further terms are searched, because such a term could
            describe errors of coarse integration steps.
        known: a system that was found before; it is the first system if it is better than the few combinations.
    """
    comparison = task.comparison
    best = find_starting_system(comparison, lists, known=known) if start is None else comparison.fit_model(start)
    if best is None:
        return None
    if not are_laws:
        comparison, best = _treat_as_noise_free(task, comparison, best)
    comparison, best = comparison.calibrate(best)
    comparison, best = comparison.calibrate(exchange_programs(comparison, best, lists))
    return SelectedModel(task, comparison, best, lists)


def search_jointly(
    task: ModellingTask,
    lists: Sequence[Sequence[Program]],
    start: Sequence[Program] | None = None,
    is_hopeless: Callable[[SelectedModel], bool] = lambda _: False,
    known: Sequence[Program] | None = None,
) -> SelectedModel | None:
    """Return the best system of these candidates and their neighbourhood, see `fit_jointly`.

    If `is_hopeless` returns True for the best system of the candidates, the neighbourhood of this system is not
    searched.
    """
    selection = fit_jointly(task, lists, start, known=known)
    if selection is None:
        return None
    comparison, best = selection.comparison, selection.model
    if comparison.score.is_exact(best):
        best = reduce_all(comparison, best)
    elif not is_hopeless(selection):
        best = search_locally(task, comparison, best, lists)
    return replace(selection, model=comparison.fit_from(best, best.programs) or best)


def _treat_as_noise_free(
    task: ModellingTask, comparison: ModelComparison, best: FittedModel
) -> tuple[ModelComparison, FittedModel]:
    """Return comparison and system for noise-free data, if the residuals show that there is no noise. If not, both are
    returned unchanged.

    With few rows, or few rows in a period, a smoother treats fast motion as noise. The tolerance of the integration is
    proportional to the noise. So in this case the tolerance would be so large that unnecessary terms would describe the
    integration errors.
    """
    limit = SETTINGS.selection.least_noise * comparison.estimator.measurements.observed_scales
    if task.is_nearly_clean or np.any(best.fit.squares > limit**2):
        return comparison, best
    precise = task.make_comparison(comparison.estimator.measurements, task.variables, has_noise=False)
    model = precise.fit_from(best, best.programs)
    return (comparison, best) if model is None else (precise, model)


def find_starting_system(
    comparison: ModelComparison, lists: Sequence[Sequence[Program]], fitted: set[bytes] | None = None, *,
    known: Sequence[Program] | None = None,
) -> FittedModel | None:  # fmt: skip
    """Return the best of a few systems made of the first programs of the lists; None if no system can be simulated.

    All systems are fitted with few steps first, and only the best of them with more steps. If rows are nearly without
    noise, short segments suffice for the first fits. Noise hides the differences between systems in short segments. If
    none of the best can be fitted with more steps, all systems are.
    Systems whose key is in `fitted` are not fitted again; the keys of the other systems are added to it. A `known`
    system is always fitted with more steps.
    """
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
    if fitted is not None:
        keys = [b"".join(program.to_bytes() for program in system) for system in systems]
        systems = [system for system, key in zip(systems, keys, strict=True) if key not in fitted]
        fitted.update(keys)
    effort, finalists = SETTINGS.effort, list[Sequence[Program]](systems)
    if len(systems) > effort.rounds[1][1]:
        noise = comparison.estimator.measurements.relative_noise
        is_clean = comparison.score.errors is None and noise.max() < SETTINGS.selection.least_noise
        steps, lengths = (effort.steps, STAGES[:1]) if is_clean else (effort.brief_steps, STAGES)
        finalists = [model.programs for model in comparison.fit_all(systems, steps, lengths)[: effort.rounds[1][1]]]
    if known is not None and list(known) not in map(list, finalists):
        finalists = [*finalists, known]
    models = comparison.fit_all(finalists)
    if len(finalists) < len(systems) and not models:  # the best ones cannot be simulated any further
        models = comparison.fit_all(systems)
    if systems and not models and comparison.estimator.deadline.is_over:
        return comparison.fit_model(first)  # without a step, since the time is over
    return models[0] if models else None


def exchange_programs(
    comparison: ModelComparison, best: FittedModel, lists: Sequence[Sequence[Program]],
    rounds: Rounds = SETTINGS.effort.rounds,
) -> FittedModel:  # fmt: skip
    """Return the best system found by exchanging the program of one variable at a time.

    If the residuals are integration errors, only shorter programs are tried. Candidates are narrowed down in `rounds`.
    Workers fit the candidates for all equations at the same time, with the present best system. After an exchange in
    one equation, the results for the later equations are dropped.
    """
    until = comparison.estimator.work + SETTINGS.effort.work
    if comparison.score.is_exact(best):
        lengths = [comparison.score.length(program) for program in best.programs]
        lists = [
            [program for program in programs if comparison.score.length(program) < length] or [own]
            for programs, length, own in zip(lists, lengths, best.programs, strict=True)
        ]
    candidates: Sequence[Sequence[Program]] = lists
    while True:
        before, promising_lists = best, _promising_programs(comparison, best, candidates)
        prefetched = comparison.prefetch_models(before, promising_lists, rounds)
        for equation in range(len(candidates)):
            ahead = prefetched.get(equation) if best is before else None
            if ahead is not None and comparison.estimator.work + ahead.work < until:
                models = comparison.accept_prefetched(equation, ahead)
            else:
                promising_lists = (
                    promising_lists if best is before else _promising_programs(comparison, best, candidates)
                )
                models = comparison.narrow_down(best, equation, promising_lists.get(equation, ()), rounds, until)
            if models and models[0].nats < best.nats - SETTINGS.selection.least_gain:
                best = models[0]
        is_settled = best.nats > before.nats - SETTINGS.selection.least_gain
        if is_settled and comparison.estimator.work < until and not comparison.score.is_exact(best):
            best = _exchange_two(comparison, best)
        if best.nats > before.nats - SETTINGS.selection.least_gain or comparison.estimator.work >= until:
            return best
        candidates = [programs[: SETTINGS.effort.kept] for programs in lists]


def _exchange_two(comparison: ModelComparison, best: FittedModel) -> FittedModel:
    """Return the best system, or a system with a shorter description in which two equations are exchanged at the same
    time.

    If noise hides the difference between alternatives, the best equation of one state depends on the equation of
    another state. Then no single exchange may shorten the description: for example, with 21 rows of hares and lynxes,
    the description with the best alternative of each equation was 2 nats shorter. Pairs of alternatives are sorted by
    the nats that their two single exchanges cost together; the first pairs are fitted.
    """
    alternatives: list[list[tuple[float, Program]]] = [[] for _ in best.programs]
    own_forms = [structure(program) for program in best.programs]
    for (equation, form), model in comparison.fitted_models.items():
        excess, is_free = model.nats - best.nats, equation not in comparison.fixed
        if is_free and form != own_forms[equation] and excess < SETTINGS.inference.distinct_nats:
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


def _promising_programs(
    comparison: ModelComparison, best: FittedModel, lists: Sequence[Sequence[Program]]
) -> dict[int, list[Program]]:
    """Return, by equation, the programs that may shorten the description. Equations without such programs are not in
    the result."""
    room = comparison.score.possible_gain(best)
    lengths = [comparison.score.length_limit(best, equation, room) for equation in range(len(lists))]
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

    If the residuals of the system are noise, long programs are not tried: no decrease of the misfit could compensate
    their length.
    """
    room = comparison.score.possible_gain(best)
    has_room = comparison.score.may_be_improved(best)

    def around(equation: int, program: Program) -> Iterator[Program]:
        name = task.variables[equation]
        operators, columns = task.operators(name), task.columns(name)
        longer = extensions(program, task.sizes_for(name), operators) if has_room else ()
        yield from promising(program, (*longer, *neighbours(program, columns, operators)))

    def beyond(equation: int, program: Program) -> Iterator[Program]:
        return promising(program, leaps(program, task.operators(task.variables[equation])))

    def promising(program: Program, others: Iterable[Program]) -> Iterator[Program]:
        most = comparison.score.length(program) + room
        length_limit = (candidate for candidate in others if comparison.score.length(candidate) < most)
        return filter(task.may_be_shown, length_limit)

    descent = LocalSearch(comparison, around, comparison.estimator.work + SETTINGS.effort.work, beyond)
    equations = [index for index, _ in enumerate(lists) if index not in comparison.fixed]
    best = descent.improve(best, equations)
    for equation in equations if has_room else ():
        best = _restart(comparison, descent, best, equation, lists[equation])
    best = exchange_programs(comparison, best, lists)
    return reduce_all(comparison, best)


def search_terms(
    task: ModellingTask, comparison: ModelComparison, best: FittedModel, lists: Sequence[Sequence[Program]],
    pairs: Sequence[Sequence[Program]], until: int,
) -> FittedModel:  # fmt: skip
    """Return the end of a descent from the best system; each step adds or removes one term of one equation.

    Each changed system is fitted along the trajectories, starting from the fit of the current system. The descent ends
    when the estimator's work reaches `until`. All terms are tried, even if the residuals are small: other constants
    partly compensate for a missing term, so noise may hide the remaining pattern. The equation is also tried as an
    expanded sum: in this form each term, or its coefficient, can be removed. Two programs cannot be reached by adding
    one term, so descents also start from these programs. The first is the best candidate in `lists` without functions;
    it is used if the equation has functions. The second is the best sum of two terms in `pairs`.
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
        if lists and _has_functions(end.programs[equation]):
            end = _restart(comparison, descent, end, equation, lists[equation])
        end = _restart(comparison, descent, end, equation, pairs[equation])
    return end if end is best else reduce_all(comparison, end)


def recalibrate(
    comparison: ModelComparison, best: FittedModel, others: Sequence[FittedModel]
) -> tuple[ModelComparison, FittedModel]:
    """Return a comparison whose error model is estimated from the residuals of the best system, and this system.

    The closest alternatives and the equations of `others` are compared again.
    """
    known_models = sorted(comparison.fitted_models.items(), key=lambda item: item[1].nats)
    comparison, best = comparison.calibrate(comparison.fit_from(best, best.programs) or best)
    for equation, own in enumerate(best.programs):
        if equation in comparison.fixed:
            continue
        programs = [other.programs[equation] for other in others]
        programs += [model.programs[equation] for (changed, _), model in known_models if changed == equation]
        distinct = {structure(program): program for program in reversed(programs)}
        distinct.pop(structure(own), None)
        nearest = list(reversed(distinct.values()))[: SETTINGS.effort.kept]
        compare_alternatives(comparison, best, equation, nearest)
    return comparison, best


def compare_alternatives(
    comparison: ModelComparison, best: FittedModel, equation: int, programs: Sequence[Program]
) -> None:  # fmt: skip
    """Fit programs in the place of one equation, and remember the best.

    The unnecessary constants of the first few programs are removed: an alternative that has more constants than the
    equation usually does not count.
    """
    effort = SETTINGS.effort
    rounds = (effort.rounds[0], (effort.brief_steps, effort.beam))
    descent = LocalSearch(comparison, lambda *_: iter(()), comparison.estimator.work)
    for alternative in comparison.narrow_down(best, equation, programs, rounds)[: effort.rounds[1][1]]:
        pruned = descent.prune(alternative, equation)
        comparison.fitted_models[equation, structure(pruned.programs[equation])] = pruned


def reduce_all(comparison: ModelComparison, best: FittedModel) -> FittedModel:
    """Return a system without the unnecessary parts of its equations."""
    last = LocalSearch(comparison, lambda *_: iter(()), comparison.estimator.work + SETTINGS.effort.work)
    for equation in range(len(best.programs)):
        if equation not in comparison.fixed:
            best = last.reduce(best, equation)
    return best


def _restart(
    comparison: ModelComparison, descent: LocalSearch, best: FittedModel, equation: int, programs: Sequence[Program]
) -> FittedModel:
    """Return the best result of descents that begin with other programs for one equation. All other equations begin
    unchanged."""
    effort = SETTINGS.effort
    rounds = (effort.rounds[0], (effort.brief_steps, effort.beam))
    others = comparison.narrow_down(best, equation, programs[: effort.kept], rounds)
    by_kind = {_has_functions(model.programs[equation]): model for model in reversed(others)}
    for start in sorted(by_kind.values(), key=lambda model: model.nats):
        if descent.is_exhausted:
            break
        end = descent.improve(start, [equation])
        if end.nats < best.nats - SETTINGS.selection.least_gain:
            best = descent.improve(
                end, [*(index for index in range(len(best.programs)) if index not in comparison.fixed)]
            )
    return best


def _has_functions(program: Program) -> bool:
    """Tell whether a program has functions, such as a sine; descents with and without functions end at different
    systems."""
    return any(is_function(code) for code in program.operators.tolist())
