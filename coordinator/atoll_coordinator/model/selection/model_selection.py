"""The model: candidates are proposed in stages and compared, until nothing is left that others could explain.

Laws by sparse regression that stand at the noise level come first, then what searches of targets without noise have
converged to; then fronts, sums by pursuit, all that the search handed on and libraries of terms, each stage only where
the one before leaves something to explain. The best systems of the pool are searched around, in pieces as long as
trajectories can be simulated; then come sums that say about what the best system does, and operators with which no
search begins. Last, where there is noise, each equation gains or loses one term at a time.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial

from atoll_coordinator.model.selection.alternatives import fit_guesses
from atoll_coordinator.model.selection.joint_search import (
    combine,
    compare_rivals,
    exchange,
    recalibrated,
    reduce_all,
    search_locally,
    search_terms,
)
from atoll_coordinator.model.selection.piece_lengths import search_in_pieces
from atoll_coordinator.model.selection.pool import CandidatePool
from atoll_coordinator.model.selection.proposals import (
    may_be_widened,
    propose_all,
    propose_further_sums,
    propose_like,
    propose_nearest,
    propose_pairs,
    propose_reduced,
    propose_sums,
)
from atoll_coordinator.model.selection.score import FittedModel
from atoll_coordinator.model.selection.shortcut import (
    excess_without,
    fit_laws_together,
    laws_in_short_pieces,
    select_by_laws,
    with_laws,
    without,
)
from atoll_coordinator.model.selection.solver_errors import solved_exactly
from atoll_coordinator.model.selection.task import ModellingTask, SelectedModel
from atoll_coordinator.settings import SETTINGS
from atoll_core.config import BASE_OPERATORS, FURTHER_OPERATORS
from atoll_core.data.notes import Note
from atoll_core.expression.operators import BY_NAME
from atoll_core.expression.program import Program, structure


def select_model(task: ModellingTask) -> SelectedModel | None:
    """Return the best system of equations and the longest pieces it can be fitted to, None if it cannot at all."""
    if task.recording.offsets:
        task = replace(task, piece=task.longest)
    task = with_laws(task)
    selection = select_by_laws(task) or select_without_wrong_law(task)
    if selection is None:
        begun = laws_in_short_pieces(task) if task.is_limited else None
        selection = search_in_pieces(*collect_pool(task))
        if selection is not None:
            selection = with_further_operators(with_sums_like(with_reduced_candidates(selection)))
        if begun is not None and task.is_over:
            return with_guesses(_shorter(begun, selection))
    return None if selection is None else with_other_terms(with_guesses(selection))


def _shorter(begun: SelectedModel, selection: SelectedModel | None) -> SelectedModel:
    """Return what a search that time has cut short began with, or what it came to if that is the shorter description.

    The search may have come no further than to some members of the fronts. Both are fitted to the same pieces. What it
    came to is compared with all that it began with, since it may not have come to its rivals.
    """
    if selection is None:
        return begun
    if begun.task.deadline is not None:
        begun.task.deadline.begin_last_stage()
    other = begun.comparison.fit_model(selection.model.programs)
    if other is None or begun.model.nats < other.nats:
        return begun
    for equation, programs in enumerate(begun.lists):
        compare_rivals(selection.comparison, selection.model, equation, programs)
    return selection


def select_without_wrong_law(task: ModellingTask) -> SelectedModel | None:
    """Return the model of all laws but one among many variables, None where no others leave noise alone.

    One wrong law makes the simulations of all states wrong. Each is left out in turn, its state taken as smoothed: the
    one is wrong without which the others leave the least. Its state gets the best of its other candidates if the whole
    system leaves noise alone with it; else it stays without an equation.
    """
    names = [name for name, laws in task.laws.items() if laws and laws[0].is_of_rates]
    if task.recording.groups or len(names) < len(task.variables) or len(names) < 2:
        return None
    excesses = {name: excess_without(task, name) for name in names}
    wrong = min(excesses, key=lambda name: excesses[name])
    if not excesses[wrong] <= SETTINGS.inference.excess:
        return None
    others = select_by_laws(without(task, wrong))
    if others is None:
        return None
    here, lists = collect_pool(replace(task, laws={**task.laws, wrong: ()}))
    whole = fit_laws_together(here, lists) if all(lists) else None
    return whole if whole is not None and whole.is_like_noise else others


def collect_pool(task: ModellingTask) -> tuple[ModellingTask, list[list[Program]]]:
    """Return the candidates of each variable, the best first, and the task that they are to be compared for.

    That is the one without the errors of a solver where candidates tell these. Where the equations of converged
    searches, with laws by regression for the rest, give the trajectories up to errors of integration, there are no
    others; nor where no system can be simulated however short the pieces. Among many variables an equation that has
    laws has no others, unless all have.
    """
    converged = [task.converged(name) for name in task.variables]
    laws = [next((law.program for law in task.laws.get(name, ())), None) for name in task.variables]
    programs = [program or law for program, law in zip(converged, laws, strict=True)]
    whole = [program for program in programs if program is not None]
    if any(converged) and len(whole) == len(programs) and _is_exact(task, whole):
        return task, [[program] for program in whole]
    if task.is_nearly_clean:
        fronts = [
            [task.known[name]] if name in task.known else [member.program for member in reversed(candidates.front)]
            for name, candidates in task.candidates.items()
        ]
        solved = solved_exactly(task, fronts) if all(fronts) else None
        if solved is not None:
            return solved
    given = {**_settled(task), **{name: [program] for name, program in task.known.items()}}
    pool = CandidatePool(task, task.comparison, given)
    pool.add(propose_nearest)
    if pool.best is None and not _can_be_simulated(task, pool.lists):
        return task, pool.lists
    if not pool.suffices:
        pool.add(propose_sums)
    if pool.best is not None and task.is_nearly_clean and not pool.suffices:
        lists = [[own, *programs] for own, programs in zip(pool.best.programs, pool.lists, strict=True)]
        solved = solved_exactly(task, lists)
        if solved is not None:
            return solved
        pool.add(propose_further_sums)
    if not pool.suffices:
        pool.add(propose_all)
    return task.with_comparison(pool.comparison), pool.lists


def _settled(task: ModellingTask) -> dict[str, list[Program]]:
    """Return the laws of the equations that have some among many variables.

    None where all have: together they have not held, and one of them is wrong.
    """
    law_programs = {
        name: [law.program for law in laws if task.may_be_shown(law.program)]
        for name, laws in task.laws.items()
        if laws and laws[0].is_of_rates and laws[0].excess <= SETTINGS.inference.excess
    }
    return law_programs if len(law_programs) < len(task.variables) - len(task.known) else {}


def _can_be_simulated(task: ModellingTask, lists: Sequence[Sequence[Program]]) -> bool:
    """Tell whether a few systems of these candidates have one that can be simulated in the shortest pieces."""
    shortest_pieces = replace(task, piece=min(task.piece, *SETTINGS.shooting.lengths))
    return all(lists) and combine(shortest_pieces.comparison, lists) is not None


def _is_exact(task: ModellingTask, programs: Sequence[Program]) -> bool:
    """Tell whether these equations give the trajectories up to errors of integration."""
    comparison = task.compare(task.compared_measurements, task.variables, has_noise=False)
    model = comparison.fit_model(programs)
    return model is not None and comparison.score.is_exact(model)


def with_reduced_candidates(selection: SelectedModel) -> SelectedModel:
    """Return the selection, or a shorter description by a candidate that was too long, less one of its parts.

    Where a short equation leaves nothing to explain, longer candidates are not fitted; the law may be one of them but
    for a term, such as 0.8 x**0.75 - 1.5 x**3 in a x**b - c x**d - 0.003.
    """
    task, comparison, best = selection.task, selection.comparison, selection.model
    is_of_rates = any(laws and laws[0].is_of_rates for laws in task.laws.values())
    if task.recording.groups or task.solver is not None or task.is_over or is_of_rates or not selection.lists:
        return selection
    lists = [
        [own] if equation in comparison.fixed else propose_reduced(best, comparison, task, equation, candidates)
        for equation, (own, candidates) in enumerate(zip(best.programs, selection.lists, strict=True))
    ]
    if not any(program is not own for own, programs in zip(best.programs, lists, strict=True) for program in programs):
        return selection
    better = exchange(comparison, best, lists, ((SETTINGS.effort.steps, SETTINGS.effort.beam),))
    return selection if better is best else replace(selection, model=reduce_all(comparison, better))


def with_sums_like(selection: SelectedModel) -> SelectedModel:
    """Return the selection, or a shorter description by sums that say about what its equations do.

    Their constants are those of the curves of the selection, from which it takes more than a few steps to the best.
    """
    task, comparison, before = selection.task, selection.comparison, selection.model
    if task.recording.groups or task.solver is not None or task.is_over or not comparison.score.has_room(before):
        return selection
    known = [[task.known[name]] if name in task.known else None for name in task.variables]
    calls = [partial(propose_like, before, comparison, task, name) for name in task.variables if name not in task.known]
    proposed = iter(task.spread.branches(calls))
    lists = [[before.programs[index]] if given else next(proposed) for index, given in enumerate(known)]
    best = exchange(comparison, before, lists, ((SETTINGS.effort.steps, SETTINGS.effort.beam),))
    if best is before:
        return selection
    best = reduce_all(comparison, best)
    return replace(selection, model=comparison.fit_beside(best, best.programs) or best)


def with_guesses(selection: SelectedModel) -> SelectedModel:
    """Return the selection, or a shorter description by the user's guesses, one at a time or all together.

    They are fitted along the trajectories whatever became of them in the search, which judges by derivatives.
    """
    task, comparison, best = selection.task, selection.comparison, selection.model
    guesses = [task.candidates[name].fitted_guesses for name in task.variables]
    if not any(guesses):
        return selection
    together = [given[0] if given else own for given, own in zip(guesses, best.programs, strict=True)]
    models = [comparison.fit_beside(best, together), comparison.fit_model(together)]
    models += [model for index, _ in enumerate(guesses) for model in fit_guesses(selection, index)]
    known = [model for model in models if model is not None and math.isfinite(model.nats)]
    shortest = min(known, key=lambda model: model.nats, default=best)
    if shortest.nats > best.nats - SETTINGS.selection.least_gain:
        return selection
    comparison, model = recalibrated(comparison, reduce_all(comparison, shortest), [best])
    return replace(selection, comparison=comparison, model=model)


def with_other_terms(selection: SelectedModel) -> SelectedModel:
    """Return the selection, or a shorter description by terms that noise has hidden or made up, see `search_terms`.

    The errors of measurement are taken anew from what each better system leaves. Without noise the stages before have
    missed none, and a term could describe what coarse steps of the integration err by; laws by derivatives among many
    variables can do without none, and have been chosen from all terms.
    """
    task, comparison, best = selection.task, selection.comparison, selection.model
    is_of_rates = any(laws and laws[0].is_of_rates for laws in task.laws.values())
    if task.is_nearly_clean or task.solver is not None or is_of_rates or comparison.score.is_exact(best):
        return selection
    until, seen = comparison.estimator.work + SETTINGS.effort.work, {_structures(best)}
    pairs = [() if name in task.known else propose_pairs(task, name) for name in task.variables]
    while not task.is_over:
        other = search_terms(task, comparison, best, selection.lists, pairs, until)
        if _structures(other) in seen:
            break
        seen.add(_structures(other))
        if task.is_over:  # its rivals could not be compared again
            best = other
            break
        comparison, best = recalibrated(comparison, other, [selection.model])
    return selection if best is selection.model else replace(selection, comparison=comparison, model=best)


def _structures(model: FittedModel) -> tuple[bytes, ...]:
    return tuple(map(structure, model.programs))


def with_further_operators(selection: SelectedModel) -> SelectedModel:
    """Return the selection, or a shorter description that has operators with which no search began."""
    task, comparison, before = selection.task, selection.comparison, selection.model
    widened = [name for name in task.variables if may_be_widened(task, name)]
    if not widened or task.is_over or task.solver is not None:
        return selection
    selection = replace(selection, widened=widened)
    given = {
        name: [program] for name, program in zip(task.variables, before.programs, strict=True) if name not in widened
    }
    pool = CandidatePool(task, comparison, given, before, is_calibrating=False)
    pool.add(propose_further_sums)
    if not any(pool.lists[task.variables.index(name)] for name in widened):
        return selection
    best = exchange(comparison, pool.best or before, pool.lists)
    if best.nats > before.nats - SETTINGS.selection.least_gain:
        return selection
    best = search_locally(task, comparison, best, [[program] for program in best.programs])
    return replace(selection, model=comparison.fit_beside(best, best.programs) or best)


def operator_remarks(selection: SelectedModel, shown: Mapping[str, Program]) -> Iterator[str]:
    """Yield a sentence where equations as `shown`, by variable, have further operators, or none of these has helped."""
    programs = [shown[name] for name in selection.widened if name in shown]
    codes = {code for program in programs for code in program.operators.tolist()}
    taken = [name for name in FURTHER_OPERATORS if BY_NAME[name].code in codes]
    begun, further = " ".join(BASE_OPERATORS), ", ".join(FURTHER_OPERATORS)
    if taken:
        yield Note(f"Beside {begun}, {further} were tried; with {', '.join(taken)} the description is shorter.")
    elif programs and selection.comparison.score.has_room(selection.model):
        yield Note(
            f"{further} were tried as well, since {begun} leave more than noise; no equation with them makes the "
            "description shorter."
        )
