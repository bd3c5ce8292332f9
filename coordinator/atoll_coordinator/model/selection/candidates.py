"""Candidates for one variable's equation: their origins and their ranking.

How it works. Programs come from the front and the runners-up of the search, from the user's guesses, and from libraries
of terms. Each program is simplified, and its constants are fitted to the derivatives. The program is then fitted to the
trajectories of its variable alone. In these fits the smoothed values of all other states are inputs.

Doubts. With smoothed inputs a right equation can be ranked low. So programs that fit badly are not dropped, but kept at
the end of the list.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import compress
from typing import Final

import numpy as np

from atoll_coordinator.data.prior_knowledge import guessed_programs, known_programs
from atoll_coordinator.model.batches import BatchFunction
from atoll_coordinator.model.pools import FrontMember, Origin, Pools, decode_members
from atoll_coordinator.model.regression.fit import LeastSquares
from atoll_coordinator.model.selection.comparison import ModelComparison
from atoll_coordinator.model.selection.score import FittedModel
from atoll_coordinator.settings import SETTINGS
from atoll_core.config import JobConfig
from atoll_core.data.dataset import Dataset, Problem
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.program import Program, constant_places, structure
from atoll_core.expression.restrictions import Restrictions
from atoll_core.expression.writing.shortest import collected, shortened, shortest


@dataclass(frozen=True, eq=False)
class CandidateSet:
    """The candidate programs for one variable's equation, by origin.

    `front` and `runners_up` are the programs that the search has passed to refining. `guesses` are the user's programs,
    with which the search begins. `known` is an equation that the user has fixed. `simulated` is a program with which
    the whole system was simulated before, since hidden states need a course: refining begins with it.
    """

    front: tuple[FrontMember, ...] = ()
    runners_up: tuple[Program, ...] = ()
    guesses: tuple[Program, ...] = ()
    known: Program | None = None
    simulated: Program | None = None

    @property
    def programs(self) -> list[Program]:
        """All programs except a known equation: front, runners-up, guesses."""
        return [*(member.program for member in self.front), *self.runners_up, *self.guesses]

    @cached_property
    def fitted_guesses(self) -> tuple[Program, ...]:
        """The guesses in their shortest form, which has no redundant constants."""
        return tuple(map(shortest, self.guesses))

    @property
    def nearest(self) -> list[Program]:
        """The front, the guesses, and the smallest runners-up (twice as many as the front has members)."""
        return [*(member.program for member in self.front), *self.guesses, *self.runners_up[: 2 * len(self.front)]]

    def origins(self, compared: Sequence[Program]) -> dict[bytes, Origin]:
        """Return the origin of each structure; `compared` are all candidates. If several programs have this structure,
        the first origin counts: a guess that is also on the front has the origin "guess". If a structure is not in the
        result, its program was derived from these programs by removing, adding or changing parts.
        """
        programs: dict[Origin, Sequence[Program]] = {
            "guess": self.guesses,
            "front": [member.program for member in self.front],
            "runner-up": self.runners_up,
            "library": compared if len(compared) > 1 else (),
        }
        origins: dict[bytes, Origin] = {structure(guess): "guess" for guess in self.fitted_guesses}
        for origin, members in programs.items():
            for program in members:
                origins.setdefault(form_key(program), origin)
        return origins

    def member_of(self, program: Program) -> int | None:
        """Return the index of the front member that has this structure; None if no member has it. A known equation is
        member 0."""
        if self.known is not None:
            return 0
        key = form_key(program)
        same = (index for index, member in enumerate(self.front) if form_key(member.program) == key)
        return next(same, None)


def form_key(program: Program) -> bytes:
    """Return a key of a program: its structure as a sum of products, without the values of its constants."""
    return structure(collected(program))


def collect_candidates(dataset: Dataset, config: JobConfig, pools: Pools) -> dict[str, CandidateSet]:
    """Return the decoded candidates of each variable with a search or a known equation, in the order of the dataset."""
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


_Rows = tuple[Problem, Restrictions]
"""The data to which constants of candidates are fitted first."""
_Start = tuple[Program, int]
"""A candidate, and the most steps of its first fit."""


def _least_squares(rows: _Rows) -> LeastSquares:
    return LeastSquares(rows[0], restrictions=rows[1])


def _fit_start(least_squares: LeastSquares, start: _Start) -> tuple[Program, ...]:
    """Return a tuple with the fitted program. It is empty if the program is not finite on all rows."""
    fitted = least_squares.fit(start[0], steps=start[1])
    return (fitted.program,) if math.isfinite(fitted.mse) else ()


_STARTS_OF_A_BATCH: Final = 16
"""Most candidates of a batch whose constants are fitted to rows: each takes a millisecond or two."""
_STARTS: Final[BatchFunction[LeastSquares, _Start, tuple[Program, ...]]] = BatchFunction(
    "starts", _Rows, _Start, tuple[Program, ...], _fit_start, _least_squares
)


def _rewrite(comparison: ModelComparison, programs: Sequence[Program], *, is_shortest: bool) -> Iterator[Program]:
    """Yield programs in a short form, or in the shortest form. If the time is over, the program is not changed."""
    rewritten = comparison.spread.map(_WRITINGS, lambda: is_shortest, programs, _WRITINGS_OF_A_BATCH[is_shortest])
    yield from (program if brief is None else brief for program, brief in zip(programs, rewritten, strict=True))


_WRITINGS_OF_A_BATCH: Final = (32, 4)
"""Most programs of a batch, for short and for shortest forms: a short form takes about a millisecond; the shortest form
takes about ten milliseconds, and a hundred milliseconds for some programs."""
_WRITINGS: Final[BatchFunction[bool, Program, Program]] = BatchFunction(
    "writings", bool, Program, Program,
    lambda is_shortest, program: shortest(program) if is_shortest else shortened(program),
)  # fmt: skip


class RankedCandidates:
    """Candidates for the equation of one variable, ranked by its trajectories alone."""

    def __init__(self, comparison: ModelComparison, problem: Problem, whole: ModelComparison | None = None) -> None:
        """Prepare a ranking by two fits: constants are first fitted to the rows of `problem`; then `comparison` fits
        the equation of this variable alone.

        `whole`, the comparison of whole systems, decides which programs are too long.
        """
        self._whole = whole or comparison
        self._comparison = comparison
        self._problem = problem
        self._known: set[bytes] = set()
        self._models: list[FittedModel] = []
        self._started: list[Program] = []
        self._shortest: dict[bytes, Program] = {}

    def add(self, programs: Iterable[Program], most: float = math.inf) -> None:
        """Fit and rank the `programs` that are shorter than `most` nats. If several have the same structure, only the
        first is ranked."""
        comparison, effort = self._comparison, SETTINGS.effort
        new: dict[bytes, Program] = {}
        for program in self._shorten(programs, most):
            if program is not None and structure(program) not in self._known:
                new.setdefault(structure(program), program)
        self._known |= new.keys()
        rows = self._problem, comparison.restrictions(0)
        # With groups, constants are fitted later, to the rows of each group.
        is_fitted = comparison.groups is None and not comparison.estimator.deadline.is_over
        starts = [(program, effort.steps if is_fitted else 0) for program in new.values()]
        fitted = comparison.spread.map(_STARTS, lambda: _least_squares(rows), starts, _STARTS_OF_A_BATCH, lambda: rows)
        started = [program for programs in fitted for program in programs or ()]
        if not comparison.is_complete:
            self._started = sorted([*self._started, *started], key=self._nats_on_rows)[: effort.kept]
            return
        steps, (short, longer, _) = effort.brief_steps, SETTINGS.shooting.lengths
        models = comparison.fit_all([(program,) for program in started], steps, (short,))
        models = models[: effort.kept]
        chosen = {structure(model.programs[0]): model.programs[0] for model in models}
        models = comparison.fit_all([(program,) for program in chosen.values()], steps, (longer,))
        self._models = comparison.distinct_models(sorted([*self._models, *models], key=lambda model: model.nats), 0)
        self._started += started

    def _nats_on_rows(self, program: Program) -> float:
        """Return the length of the description of the target by a program. It ranks programs of an equation that has
        an unknown part of another equation, too, so that it cannot be simulated alone."""
        target = self._problem.target
        residuals = values_of(program, self._problem.inputs) - target.values
        square = max(math.fsum((residuals * residuals).tolist()) / len(residuals), np.finfo(np.float64).tiny)
        return 0.5 * len(residuals) * math.log(square) + self._whole.score.length(program)

    def _shorten(self, programs: Iterable[Program], most: float) -> list[Program | None]:
        """Return programs in a short form; None for programs of `most` nats or more. Often the price of the constants
        alone exceeds this limit."""
        all_programs, price = list(programs), self._whole.score.constant_nats
        are_few = [price * len(constant_places(program)) < most for program in all_programs]
        written = iter(_rewrite(self._comparison, list(compress(all_programs, are_few)), is_shortest=False))
        briefs = [next(written) if is_few else None for is_few in are_few]
        return [None if brief is None or not self._whole.score.length(brief) < most else brief for brief in briefs]

    @property
    def programs(self) -> list[Program]:
        """All ranked programs, the most promising first.

        Programs that fit badly with smoothed values of the other states come last, in the order of addition. They may
        fit well together with the right equations for these states.
        """
        best, first = [model.programs[0] for model in self._models], SETTINGS.effort.beam
        new = [program for program in best[:first] if program.to_bytes() not in self._shortest]
        for program, brief in zip(new, _rewrite(self._comparison, new, is_shortest=True), strict=True):
            self._shortest[program.to_bytes()] = brief
        best = [*(self._shortest[program.to_bytes()] for program in best[:first]), *best[first:]]
        known = {structure(program) for program in best}
        return [*best, *(program for program in self._started if structure(program) not in known)]
