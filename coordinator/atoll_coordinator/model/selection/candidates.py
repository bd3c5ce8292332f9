"""Candidates for one variable's equation, the best first: its trajectories alone, the other states as smoothed."""

from collections.abc import Iterable, Sequence

import numpy as np

from atoll.data.dataset import Problem
from atoll.expression.program import Program, structure
from atoll_coordinator.model.regression.fit import Polisher
from atoll_coordinator.model.selection.comparison import Contest, distinct
from atoll_coordinator.model.selection.elimination import eliminated
from atoll_coordinator.model.settings import SETTINGS
from atoll_coordinator.model.structure.algebra import tidied
from atoll_coordinator.model.structure.term_libraries import Term


def ranked(
    contest: Contest, problem: Problem, programs: Sequence[Program], libraries: Iterable[list[Term]]
) -> list[Program]:
    """Return what becomes of `programs` and of `libraries` of terms, the most promising first.

    Those that do badly with the other states as smoothed come last, in their old order: with the right equations for
    these they may do well.

    Args:
        contest: for this variable alone.
        problem: by which constants are fitted first.
        programs: candidates; of equal structures the first counts.
        libraries: terms that are left out one after another.
    """
    polisher = Polisher(problem)
    unique = {structure(program): program for program in reversed([tidied(each) for each in programs])}
    polished = [
        polisher.fit(program, steps=SETTINGS.selection.regression_steps) for program in reversed(unique.values())
    ]
    started = [each.program for each in polished if np.isfinite(each.mse)]
    found = contest.map(lambda program: contest.stand([program], 4, (SETTINGS.selection.short_segment,)), started)[
        : SETTINGS.selection.kept_candidates
    ]
    for terms in libraries:
        if contest.shooter.work < SETTINGS.selection.library_work:
            found += eliminated(contest, problem, terms)
    chosen = {structure(each.programs[0]): each.programs[0] for each in found}
    longer = contest.map(
        lambda program: contest.stand([program], 6, (SETTINGS.selection.longer_segment,)), chosen.values()
    )
    best = [each.programs[0] for each in distinct(longer)]
    known = {structure(program) for program in best}
    return [*best, *(program for program in started if structure(program) not in known)]
