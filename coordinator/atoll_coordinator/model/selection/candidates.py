"""Candidates for one variable's equation: where they come from, and which are the best.

They are ranked by the variable's trajectories alone, the other states as smoothed.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from atoll_coordinator.data.prior_knowledge import guessed_programs, known_programs
from atoll_coordinator.model.refinement import Member, Origin, Pools, decode_members
from atoll_coordinator.model.regression.fit import LeastSquares
from atoll_coordinator.model.selection.comparison import ModelComparison
from atoll_coordinator.model.selection.elimination import eliminated
from atoll_coordinator.model.structure.term_libraries import Term
from atoll_coordinator.settings import SETTINGS
from atoll_core.config import JobConfig
from atoll_core.data.dataset import Dataset, Problem
from atoll_core.expression.program import Program, structure
from atoll_core.expression.writing.shortest import collected, shortened, shortest


@dataclass(frozen=True, eq=False)
class CandidateSet:
    """The programs that one variable's equation may be made of, by where they come from.

    `front` and `runners_up` are what the search handed on, `guesses` what it began with; a `known` equation is given.
    """

    front: tuple[Member, ...] = ()
    runners_up: tuple[Program, ...] = ()
    guesses: tuple[Program, ...] = ()
    known: Program | None = None

    @property
    def programs(self) -> list[Program]:
        """All programs but a known one: front, runners-up, guesses."""
        return [*(member.program for member in self.front), *self.runners_up, *self.guesses]

    @property
    def nearest(self) -> list[Program]:
        """The front, guesses, and the smallest of the runners-up, two for each member of the front."""
        return [*(member.program for member in self.front), *self.guesses, *self.runners_up[: 2 * len(self.front)]]

    def origins(self, compared: Sequence[Program]) -> dict[bytes, Origin]:
        """Return by structure where programs come from, the first origin counts; `compared` are all candidates.

        A program of none of these structures was made of them by leaving out, adding or changing parts.
        """
        programs: dict[Origin, Sequence[Program]] = {
            "front": [member.program for member in self.front],
            "runner-up": self.runners_up,
            "guess": self.guesses,
            "library": compared if len(compared) > 1 else (),
        }
        origins: dict[bytes, Origin] = {}
        for origin, members in programs.items():
            for program in members:
                origins.setdefault(form(program), origin)
        return origins

    def member_of(self, program: Program) -> int | None:
        """Return the index of the front member of this structure, None without one; a known equation is member 0."""
        if self.known is not None:
            return 0
        key = form(program)
        same = (index for index, member in enumerate(self.front) if form(member.program) == key)
        return next(same, None)


def form(program: Program) -> bytes:
    """Return what programs of one form have in common, whatever their constants are."""
    return structure(collected(program))


def collect_candidates(dataset: Dataset, config: JobConfig, pools: Pools) -> dict[str, CandidateSet]:
    """Return the candidates of each variable that was searched or is known, in the dataset's order, decoded."""
    known, guesses = known_programs(dataset, config), guessed_programs(dataset, config)
    inputs = len(dataset.names)
    return {
        name: CandidateSet(known=known[name])
        if name in known
        else CandidateSet(
            decode_members(pools[name].front, inputs),
            tuple(member.program for member in decode_members(pools[name].runners_up, inputs)),
            tuple(guesses.get(name, ())),
        )
        for name in dataset.variables
        if name in pools or name in known
    }


def ranked(
    comparison: ModelComparison, problem: Problem, programs: Sequence[Program], libraries: Iterable[list[Term]]
) -> list[Program]:
    """Return what becomes of `programs` and of `libraries` of terms, the most promising first.

    Those that do badly with the other states as smoothed come last, in their old order: with the right equations for
    these they may do well.

    Args:
        comparison: for this variable alone.
        problem: by which constants are fitted first.
        programs: candidates; of equal structures the first counts.
        libraries: terms that are left out one after another.
    """
    least_squares = LeastSquares(problem, restrictions=comparison.restrictions(0))
    unique = {structure(program): program for program in reversed([shortened(candidate) for candidate in programs])}
    deadline = comparison.estimator.deadline
    is_pooled = comparison.groups is None  # else constants are fitted group by group
    polished = [
        least_squares.fit(program, steps=SETTINGS.effort.steps if is_pooled and not deadline.is_over else 0)
        for program in reversed(unique.values())
    ]
    started = [fitted.program for fitted in polished if np.isfinite(fitted.mse)]
    steps, (short, longer, _) = SETTINGS.effort.brief_steps, SETTINGS.shooting.lengths
    models = comparison.fit_all(lambda program: comparison.fit_model([program], steps, (short,)), started)
    models = models[: SETTINGS.effort.kept]
    for terms in libraries:
        if comparison.estimator.work < SETTINGS.effort.work:
            models += eliminated(comparison, problem, terms)
    chosen = {structure(model.programs[0]): model.programs[0] for model in models}
    refitted = comparison.fit_all(lambda program: comparison.fit_model([program], steps, (longer,)), chosen.values())
    best = [model.programs[0] for model in comparison.distinct(refitted, 0)]
    first = SETTINGS.effort.kept
    best = [*map(shortest, best[:first]), *best[first:]]
    known = {structure(program) for program in best}
    return [*best, *(program for program in started if structure(program) not in known)]
