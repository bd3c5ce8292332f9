"""The choice of the model: a table of stages that propose candidates and compare systems.

`STAGES` lists the stages in the order in which they run, each with the condition under which it is due. `select_model`
runs them and writes the name of each to the log. A stage takes a `Choice`, the state of the choice so far, and returns
the next state. There are three kinds of stages:

1. *Shortcuts*: laws by sparse regression are fitted first. If these laws describe the trajectories up to the noise,
   nothing else is proposed.
2. *Candidates*: each stage adds its proposals for each equation to the pool. No stage adds further proposals when the
   pool suffices (`CandidatePool.is_sufficient`): the residuals of a system are noise, and its equations are not longer
   than laws usually are. Then the best system is searched: candidates are exchanged, and local searches look for
   shorter descriptions.
3. *Improvements* of the system found: the stages try candidates that were too long, with one part removed; operators
   that a search does not use at first; the user's guesses; and terms that noise has hidden.

Doubts: each improvement was added for a kind of law that the earlier stages had missed. A search over all candidates by
one criterion would make the improvements unnecessary, at several times the work.
"""

import logging
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Final

from atoll_coordinator.model.selection.alternatives import fit_guesses
from atoll_coordinator.model.selection.joint_search import (
    compare_alternatives,
    exchange_programs,
    recalibrate,
    reduce_all,
    search_locally,
    search_terms,
)
from atoll_coordinator.model.selection.piece_lengths import fit_without_solver_errors, search_in_pieces
from atoll_coordinator.model.selection.pool import CandidatePool, Proposer
from atoll_coordinator.model.selection.proposals import (
    may_use_further_operators,
    propose_all,
    propose_further_sums,
    propose_nearest,
    propose_pairs,
    propose_reduced,
    propose_sums,
)
from atoll_coordinator.model.selection.score import FittedModel
from atoll_coordinator.model.selection.shortcut import (
    add_laws,
    fit_laws_in_short_pieces,
    select_laws,
)
from atoll_coordinator.model.selection.task import ModellingTask, SelectedModel
from atoll_coordinator.model.shooting.fit_result import growth_rate
from atoll_coordinator.settings import SETTINGS
from atoll_core.config import BASE_OPERATORS, FURTHER_OPERATORS
from atoll_core.data.notes import Note
from atoll_core.expression.operators import BY_NAME
from atoll_core.expression.program import Program, structure

_LOG = logging.getLogger(__name__)

_MOST_GROWTH: Final = 40.0
"""Logarithm of the largest growth of errors that is considered; an error of the last digit is then as large as the
state."""


@dataclass(frozen=True, eq=False)
class Choice:
    """The state of the choice of the model between two stages.

    Attributes:
        task: the measurements and candidates.
        pool: the candidates; None before the first stage that proposes candidates.
        selection: the best system so far; None if no system could be simulated yet.
        law_selection: the best system of laws alone; if there is a time limit, it is fitted first.
        is_searched: whether the selection comes from the search among candidates, and not from laws alone.
    """

    task: ModellingTask
    pool: CandidatePool | None = None
    selection: SelectedModel | None = None
    law_selection: SelectedModel | None = None
    is_searched: bool = False

    @property
    def lacks_candidates(self) -> bool:
        """Whether more candidates are needed: the pool is not sufficient, and no system was selected."""
        return self.selection is None and self.pool is not None and not self.pool.is_sufficient

    @property
    def may_improve(self) -> bool:
        """Whether a stage may improve the system: the search has found it, a part of the law may be missing, and time
        is left."""
        return self.is_searched and self.selection is not None and not (self.is_exact or self.is_over)

    @property
    def is_exact(self) -> bool:
        """Whether the residuals of the system found are integration errors."""
        return self.selection is not None and self.selection.comparison.score.is_exact(self.selection.model)

    @property
    def is_over(self) -> bool:
        """Whether no time is left."""
        return self.task.is_over


@dataclass(frozen=True)
class Stage:
    """One stage of the choice: its name in the log, its condition, and the function that returns the next choice."""

    name: str
    is_due: Callable[[Choice], bool]
    run: Callable[[Choice], Choice]


def select_model(task: ModellingTask) -> SelectedModel | None:
    """Return the best system of equations, fitted to the longest possible pieces; None if no system can be fitted."""
    if task.recording.offsets or task.recording.hidden:
        task = replace(task, piece=task.longest)
    choice = Choice(add_laws(task))
    for stage in STAGES:
        if stage.is_due(choice):
            _LOG.info("choosing equations: %s", stage.name)
            choice = stage.run(choice)
    return choice.selection


# ------------------------------------------------------------------------------------------------- shortcuts


def fit_laws(choice: Choice) -> Choice:
    """Select the laws of sparse regression, if a system of these laws describes the trajectories up to the noise."""
    return replace(choice, selection=select_laws(choice.task))


def begin_with_laws(choice: Choice) -> Choice:
    """Fit the laws in short pieces. These laws are the model if the time ends before a shorter description is found."""
    return replace(choice, law_selection=fit_laws_in_short_pieces(choice.task))


# ------------------------------------------------------------------------------------------------ candidates


def propose(proposer: Proposer) -> Callable[[Choice], Choice]:
    """Return the stage that adds the proposals of a proposer to the pool."""

    def run(choice: Choice) -> Choice:
        task = choice.task
        pool = choice.pool
        if pool is None:
            fixed_candidates = {**_law_programs(task), **{name: [program] for name, program in task.known.items()}}
            pool = CandidatePool(task, task.comparison, fixed_candidates)
        pool.add(proposer)
        return replace(choice, pool=pool)

    return run


def _law_programs(task: ModellingTask) -> dict[str, list[Program]]:
    """Return the laws that were found among many variables, by equation.

    The result is empty if all equations have such laws: the system of these laws did not fit, so one of the laws is
    wrong.
    """
    law_programs = {
        name: [law.program for law in task.laws[name] if task.may_be_shown(law.program)]
        for name in task.variables
        if name in task.rate_law_variables and task.laws[name][0].excess <= SETTINGS.inference.excess
    }
    return law_programs if len(law_programs) < len(task.variables) - len(task.known) else {}


def reproduce_rows(choice: Choice) -> Choice:
    """Select a system from which a known solver computes the rows digit by digit, if there is one.

    Two systems are tried: the best one, and the first candidates of each equation. The best one may have terms that
    describe errors of the solver. A wrong system that is close to the law reproduces the rows, too, up to its distance
    from the law. So the residuals must be as small as integration errors, and all candidates are compared on the
    corrected rows. Further candidates are not needed then.
    """
    pool = choice.pool
    assert pool is not None
    assert pool.best is not None
    models = [pool.best]
    firsts = [programs[0] for programs in pool.lists]
    if list(map(structure, firsts)) != list(map(structure, pool.best.programs)):
        models += [model for model in (pool.comparison.fit_model(firsts),) if model is not None]
    for model in models:
        found = SelectedModel(choice.task, pool.comparison, model, pool.lists)
        selection = fit_without_solver_errors(choice.task, found, pool.lists)
        if selection is not None and _is_reproduced(selection):
            return replace(choice, selection=selection)
    return choice


def _is_reproduced(selection: SelectedModel) -> bool:
    """Tell whether rows without solver errors differ from the solution of the system by integration errors only, as
    large as these grow along the longest trajectory."""
    task, rate = selection.task, growth_rate(selection.model.fit)
    duration = task.longest * selection.comparison.estimator.measurements.step
    allowed = SETTINGS.shooting.exact * math.exp(min(max(rate, 0.0) * duration, _MOST_GROWTH))
    return all(smoothing.relative_noise <= allowed for smoothing in task.recording.smoothing)


def search(choice: Choice) -> Choice:
    """Search for the best system among all candidates and their neighbourhood."""
    pool = choice.pool
    assert pool is not None, "candidates were proposed"
    known = None if pool.best is None else pool.best.programs
    selection = search_in_pieces(choice.task.with_comparison(pool.comparison), pool.lists, known)
    return replace(choice, selection=selection, is_searched=True)


def compare_with_laws(choice: Choice) -> Choice:
    """Select the laws that were fitted first, unless the search has found a shorter description.

    With a time limit, the search may have fitted only some members of the fronts. The system of the search and the
    system of laws are fitted to the same pieces. Each equation of the search is then compared with all laws, because it
    may not have been compared with its alternatives.
    """
    law_selection, selection = choice.law_selection, choice.selection
    assert law_selection is not None
    if selection is None:
        return replace(choice, selection=law_selection)
    if law_selection.task.deadline is not None:
        law_selection.task.deadline.begin_last_stage()
    other = law_selection.comparison.fit_model(selection.model.programs)
    if other is None or law_selection.model.nats < other.nats:
        return replace(choice, selection=law_selection)
    for equation, programs in enumerate(law_selection.lists):
        compare_alternatives(selection.comparison, selection.model, equation, programs)
    return choice


# ---------------------------------------------------------------------------------------------- improvements


def improve(change: Callable[[SelectedModel], SelectedModel]) -> Callable[[Choice], Choice]:
    """Return the stage that replaces the selection by the result of `change`."""

    def run(choice: Choice) -> Choice:
        assert choice.selection is not None
        return replace(choice, selection=change(choice.selection))

    return run


def try_reduced_candidates(selection: SelectedModel) -> SelectedModel:
    """Return the selection, or a selection with a shorter description. In the latter, one equation is a long candidate
    from which one part was removed.

    If the residuals of a short equation are noise, longer candidates are not fitted. One of the longer candidates may
    be the law plus one term, for example a x**b - c x**d - 0.003 for the law 0.8 x**0.75 - 1.5 x**3.
    """
    task, comparison, best = selection.task, selection.comparison, selection.model
    lists = [
        [own] if equation in comparison.fixed else propose_reduced(best, comparison, task, equation, candidates)
        for equation, (own, candidates) in enumerate(zip(best.programs, selection.lists, strict=True))
    ]
    if not any(program is not own for own, programs in zip(best.programs, lists, strict=True) for program in programs):
        return selection
    better = exchange_programs(comparison, best, lists, ((SETTINGS.effort.steps, SETTINGS.effort.beam),))
    return selection if better is best else replace(selection, model=reduce_all(comparison, better))


def try_guesses(selection: SelectedModel) -> SelectedModel:
    """Return the selection, or a selection with the user's guesses that has a shorter description. The guesses are
    tried one at a time and all together.

    All guesses are fitted along the trajectories, even if the search has rejected them, since the search compares
    derivatives.
    """
    task, comparison, best = selection.task, selection.comparison, selection.model
    guesses = [task.candidates[name].fitted_guesses for name in task.variables]
    if not any(guesses):
        return selection
    together = [own_guesses[0] if own_guesses else own for own_guesses, own in zip(guesses, best.programs, strict=True)]
    models = [comparison.fit_from(best, together), comparison.fit_model(together)]
    models += [model for index, _ in enumerate(guesses) for model in fit_guesses(selection, index)]
    known = [model for model in models if model is not None and math.isfinite(model.nats)]
    shortest = min(known, key=lambda model: model.nats, default=best)
    if shortest.nats > best.nats - SETTINGS.selection.least_gain:
        return selection
    comparison, model = recalibrate(comparison, reduce_all(comparison, shortest), [best])
    return replace(selection, comparison=comparison, model=model)


def try_other_terms(selection: SelectedModel) -> SelectedModel:
    """Return the selection, or a selection with a shorter description after terms were added or removed, see
    `search_terms`.

    Noise may have hidden a term, or caused an unnecessary term. When a better system is found, the errors of
    measurement are estimated again from its residuals. Without noise the stage does not run: no term is hidden then,
    and an added term could describe errors of coarse integration steps. It does not run for laws that were found among
    many variables from derivatives, because these laws were chosen from all terms.
    """
    task, comparison, best = selection.task, selection.comparison, selection.model
    until, known_structures = comparison.estimator.work + SETTINGS.effort.work, {_structures_of(best)}
    pairs = [() if name in task.known else propose_pairs(task, name) for name in task.variables]
    while not task.is_over:
        other = search_terms(task, comparison, best, selection.lists, pairs, until)
        if _structures_of(other) in known_structures:
            break
        known_structures.add(_structures_of(other))
        if task.is_over:  # no time to compare its alternatives again
            best = other
            break
        comparison, best = recalibrate(comparison, other, [selection.model])
    return selection if best is selection.model else replace(selection, comparison=comparison, model=best)


def _structures_of(model: FittedModel) -> tuple[bytes, ...]:
    return tuple(map(structure, model.programs))


def try_further_operators(selection: SelectedModel) -> SelectedModel:
    """Return the selection, or a selection with a shorter description that has operators which a search does not use at
    first."""
    task, comparison, before = selection.task, selection.comparison, selection.model
    widened = [name for name in task.variables if may_use_further_operators(task, name)]
    if not widened:
        return selection
    selection = replace(selection, widened=widened)
    fixed_candidates = {
        name: [program] for name, program in zip(task.variables, before.programs, strict=True) if name not in widened
    }
    pool = CandidatePool(task, comparison, fixed_candidates, before, is_calibrating=False)
    pool.add(propose_further_sums)
    if not any(pool.lists[task.variables.index(name)] for name in widened):
        return selection
    best = exchange_programs(comparison, pool.best or before, pool.lists)
    if best.nats > before.nats - SETTINGS.selection.least_gain:
        return selection
    best = search_locally(task, comparison, best, [[program] for program in best.programs])
    return replace(selection, model=comparison.fit_from(best, best.programs) or best)


def _is_clean_and_lacks_candidates(choice: Choice) -> bool:
    can_be_simulated = choice.pool is not None and choice.pool.best is not None
    return choice.lacks_candidates and can_be_simulated and choice.task.is_nearly_clean


def _may_be_reduced(choice: Choice) -> bool:
    return choice.may_improve and not (choice.task.recording.groups or choice.task.rate_law_variables)


def _may_hide_terms(choice: Choice) -> bool:
    """Tell whether noise may have hidden a term, or caused an unnecessary term.

    Without noise the earlier stages have missed no term, and an added term could describe errors of coarse integration
    steps.
    """
    if choice.selection is None or choice.is_over or choice.selection.task.is_nearly_clean:
        return False
    return not (choice.task.rate_law_variables or choice.is_exact)


STAGES: Final = (
    Stage("laws by sparse regression, together", lambda choice: not choice.task.recording.groups, fit_laws),
    Stage("laws in short pieces", lambda c: c.selection is None and c.task.is_limited, begin_with_laws),
    Stage("the nearest candidates", lambda choice: choice.selection is None, propose(propose_nearest)),
    Stage("rows computed by a known solver", _is_clean_and_lacks_candidates, reproduce_rows),
    Stage("sums by pursuit", lambda choice: choice.lacks_candidates, propose(propose_sums)),
    Stage("rows computed by a known solver", _is_clean_and_lacks_candidates, reproduce_rows),
    Stage("sums with further operators", _is_clean_and_lacks_candidates, propose(propose_further_sums)),
    Stage("all candidates", lambda choice: choice.lacks_candidates, propose(propose_all)),
    Stage("search among the candidates", lambda choice: choice.selection is None, search),
    Stage("candidates with one part removed", _may_be_reduced, improve(try_reduced_candidates)),
    Stage("further operators", lambda choice: choice.may_improve, improve(try_further_operators)),
    Stage("comparison with the first laws", lambda c: c.law_selection is not None and c.is_over, compare_with_laws),
    Stage("guesses", lambda choice: choice.selection is not None, improve(try_guesses)),
    Stage("terms hidden by noise", _may_hide_terms, improve(try_other_terms)),
)
"""The stages of the choice, in their order."""


def operator_remarks(selection: SelectedModel, shown: Mapping[str, Program]) -> Iterator[str]:
    """Yield a remark for the user. It names the further operators that the `shown` equations have, or tells that no
    further operator was useful."""
    programs = [shown[name] for name in selection.widened if name in shown]
    codes = {code for program in programs for code in program.operators.tolist()}
    taken = [name for name in FURTHER_OPERATORS if BY_NAME[name].code in codes]
    base, further = " ".join(BASE_OPERATORS), ", ".join(FURTHER_OPERATORS)
    if taken:
        yield Note(f"Besides {base}, {further} were tried; with {', '.join(taken)} the description is shorter.")
    elif programs and selection.comparison.score.may_be_improved(selection.model):
        yield Note(
            f"{further} were tried as well, since the residuals with {base} are larger than noise; no equation with "
            "them makes the description shorter."
        )
