"""From a front to the shortest model: its members polished, reduced, made simple, and what lies one step beside.

The search compares individuals by their error on some rows; here whole descriptions are compared, on all rows. Members
far from the shortest are left out. The constants of each of the others, and of what its reductions lead to, are
rounded. Then the programs one step from the smallest of the nearly shortest models are tried (a larger one may have
begun to describe the noise), and those one step from the shortest as long as that makes it shorter; not when its errors
are at the limit, where nothing but its size could be better. The work is bounded by a number of point evaluations, not
by the clock, unless there is a deadline.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from atoll_coordinator.model.criteria import RegressionCriterion, program_length
from atoll_coordinator.model.deadline import Deadline
from atoll_coordinator.model.regression.covariance import covariance_of, description_length, standard_errors
from atoll_coordinator.model.regression.fit import Fitted, LeastSquares
from atoll_coordinator.model.regression.rounding import decisions, fitted_length, simple_numbers
from atoll_coordinator.model.structure.moves.neighbours import neighbours
from atoll_coordinator.model.structure.moves.reductions import reductions
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import Problem
from atoll_core.expression.program import Program, constant_places, structure, with_constants
from atoll_core.expression.writing.shortest import collected, shortest

_MARGIN: Final = 2.0 * SETTINGS.inference.distinct_nats
"""Neighbours are rounded whose description, constants as fitted, is longer than the best by at most so many nats (odds
of 400), and the smallest model that is not longer by more has its neighbours tried, too."""


@dataclass(frozen=True, eq=False)
class Model:
    """A program as it would be shown: its length in nats and its mean squared error."""

    program: Program
    length: float
    mse: float


@dataclass(frozen=True, eq=False)
class Candidate:
    """A fitted program, the front member that it came from, and the model it became."""

    member: int
    fitted: Fitted
    model: Model

    @property
    def rank(self) -> tuple[float, int, bytes]:
        """What the shortest model has the least of."""
        return (self.model.length, len(self.model.program), self.model.program.to_bytes())


class Shortening:
    """Shortens the front of one problem. Remembers what it has fitted, by structure."""

    def __init__(
        self,
        problem: Problem,
        operators: Collection[int],
        variables: Collection[int] | None = None,
        least_squares: LeastSquares | None = None,
        deadline: Deadline | None = None,
        *,
        has_simple_numbers: bool = True,
    ) -> None:
        """`operators` (codes) and `variables` (indices, all unless given) are what new programs may bring in.

        `least_squares` fits to the rows of `problem`; None: all alike. Without `has_simple_numbers`, constants stay as
        they are fitted.
        """
        self._has_simple_numbers = has_simple_numbers
        self.criterion: Final = RegressionCriterion.of(problem.target)
        self.least_squares: Final = least_squares or LeastSquares(problem)
        self._variables = range(len(problem.names)) if variables is None else variables
        self._operators = operators
        self._deadline = deadline or Deadline()
        self._fits: dict[bytes, tuple[Fitted, float]] = {}
        self._ends: dict[bytes, Fitted] = {}

    def candidates(self, front: Sequence[Program], looks_around: bool = True) -> list[Candidate]:
        """Return what the members of `front` became, the shortest first; nothing when none has a finite error.

        Without `looks_around`, programs beside the members are not tried.
        """
        candidates: dict[bytes, Candidate] = {}
        for member, fitted in self._members(front):
            self._take_in(candidates, member, (fitted, self._reduced(fitted)))
        if not candidates or not looks_around:
            return sorted(candidates.values(), key=lambda candidate: candidate.rank)
        best = min(candidates.values(), key=lambda candidate: candidate.rank)
        simple = min(candidates.values(), key=lambda candidate: self._simplicity(candidate, best))
        if simple is not best and not self._is_exact(best):
            self._take_in(candidates, simple.member, self._around(simple))
            best = min(candidates.values(), key=lambda candidate: candidate.rank)
        while not self._is_exact(best) and not self._is_exhausted():
            self._take_in(candidates, best.member, self._around(best))
            following = min(candidates.values(), key=lambda candidate: candidate.rank)
            if following is best:
                break
            best = following
        return sorted(candidates.values(), key=lambda candidate: candidate.rank)

    def _is_exact(self, candidate: Candidate) -> bool:
        return candidate.fitted.mse <= self.criterion.least_variance

    def _simplicity(self, candidate: Candidate, best: Candidate) -> tuple[bool, int, tuple[float, int, bytes]]:
        """Return what the smallest program has the least of whose model is nearly as short as the best."""
        is_far = candidate.model.length > best.model.length + _MARGIN
        return is_far, len(candidate.model.program), candidate.rank

    def _members(self, front: Sequence[Program]) -> list[tuple[int, Fitted]]:
        """Return the members worth the effort, polished, by rising length; of equal structures the first."""
        fits = {structure(program): (index, program) for index, program in reversed([*enumerate(map(shortest, front))])}
        polished = [(index, self._fitted(program)) for index, program in fits.values()]
        priced = sorted(
            ((description_length(fitted, self.criterion), index, fitted) for index, fitted in polished),
            key=lambda priced_fit: priced_fit[:2],
        )
        return [(index, fitted) for _, index, fitted in priced[: SETTINGS.effort.beam]]

    def _take_in(self, candidates: dict[bytes, Candidate], member: int, fits: Sequence[Fitted]) -> None:
        for fitted in fits:
            key = structure(fitted.program)
            if key not in candidates:
                candidates[key] = Candidate(member, fitted, self._model(fitted))

    def _model(self, fitted: Fitted) -> Model:
        if self._has_simple_numbers:
            return round_constants(fitted, self.criterion, self.least_squares)
        return Model(fitted.program, description_length(fitted, self.criterion), fitted.mse)

    def _fitted(self, program: Program, enough: float = 0.0) -> Fitted:
        """Return `program` fitted; less well when it is not going to come near the mean squared error `enough`."""
        key = structure(program)
        known = self._fits.get(key)
        if known is None or (known[0].mse > known[1] > 0.0 and not 0.0 < enough <= known[1]):
            known = (
                self.least_squares.fit(program, enough=enough),
                enough,
            )
            self._fits[key] = known
        return known[0]

    def _tried(self, program: Program, length: float) -> tuple[float, Fitted]:
        """Return `program` fitted and its length, which is of interest when it is less than `length`."""
        fitted = self._fitted(program, self.criterion.mse_of(length - program_length(program)))
        return description_length(fitted, self.criterion), fitted

    def _reduced(self, fitted: Fitted) -> Fitted:
        """Follow the reductions, each time the one that leaves the shortest description, until none is shorter."""
        path: list[bytes] = []
        while structure(fitted.program) not in self._ends:
            path.append(structure(fitted.program))
            following = self._best_reduction(fitted)
            if following is None:
                self._ends[path[-1]] = fitted
            else:
                fitted = following
        end = self._ends[structure(fitted.program)]
        self._ends |= dict.fromkeys(path, end)
        return end

    def _best_reduction(self, fitted: Fitted) -> Fitted | None:
        best, least = None, description_length(fitted, self.criterion)
        for program in reductions(fitted.program):
            if self._is_exhausted():
                break
            length, reduced = self._tried(program, least)
            if length < least:
                best, least = reduced, length
        return best

    def _around(self, best: Candidate) -> list[Fitted]:
        """Return the most promising programs one step from `best`, each also reduced.

        Of those with equal errors, which say the same in other words, the shortest is taken; but of those that say the
        same as `best`, the shortest for each collection of operators, since their constants may be simpler.
        """
        most = description_length(best.fitted, self.criterion) + _MARGIN
        fits: dict[tuple[str, bytes], tuple[float, Fitted]] = {}
        for program in neighbours(best.fitted.program, self._variables, self._operators):
            if self._is_exhausted():
                break
            length, fitted = self._tried(program, most)
            meaning = (f"{fitted.mse:.6g}", b"")
            if meaning[0] == f"{best.fitted.mse:.6g}":
                meaning = (meaning[0], np.sort(fitted.program.operators).tobytes())
            if length < most and (meaning not in fits or length < fits[meaning][0]):
                fits[meaning] = (length, fitted)
        nearest = sorted(fits.values(), key=lambda pair: (pair[0], structure(pair[1].program)))[: SETTINGS.effort.beam]
        return [fitted for _, neighbour in nearest for fitted in (neighbour, self._reduced(neighbour))]

    def _is_exhausted(self) -> bool:
        return self._deadline.is_over or self.least_squares.evaluations > SETTINGS.regression.most_evaluations


def round_constants(fitted: Fitted, criterion: RegressionCriterion, least_squares: LeastSquares) -> Model:
    """Return the shortest model that comes from `fitted` by making constants simple; itself when none is shorter.

    Equations are compared by these models: simple numbers speak for an equation before any of them is singled out.
    """
    best = Model(fitted.program, description_length(fitted, criterion), fitted.mse)
    places = constant_places(fitted.program)
    if not 0 < len(places) <= SETTINGS.effort.beam or not math.isfinite(best.length):
        return best
    candidates = decisions(fitted.program.constants[places], covariance_of(fitted, criterion))
    probable = sorted((decision for decision in candidates if decision.numbers), key=lambda decision: -decision.nats)
    for decision in probable[: SETTINGS.effort.beam]:
        model = _measured(fitted.program, places, dict(decision.numbers), criterion, least_squares)
        if model.length <= best.length:
            best = model
    return best


def _measured(
    program: Program,
    places: Sequence[int],
    decided: Mapping[int, float],
    criterion: RegressionCriterion,
    least_squares: LeastSquares,
) -> Model:
    """Return the model with simple numbers for decided constants, the others fitted and neutral ones left out."""
    values = {places[index]: number for index, number in decided.items()}
    prices = {number: min(simple_numbers(number, 0.0).values(), default=0.0) for number in values.values()}
    refitted = least_squares.fit(with_constants(program, values), [*values])
    if not math.isfinite(refitted.mse):
        return Model(refitted.program, math.inf, math.inf)
    freed = refitted.program.constants[[place for place in places if place not in values]].tolist()
    prices |= dict(zip(freed, map(fitted_length, freed, standard_errors(refitted, criterion)), strict=True))
    shown = collected(refitted.program)
    mse = least_squares.mse(shown)
    known = {abs(number): price for number, price in prices.items()}
    numbers = sum(
        known[number] if number in known else min(simple_numbers(number, 0.0).values(), default=0.0)
        for number in set(np.abs(shown.constants[constant_places(shown)]).tolist())
    )
    return Model(shown, criterion.length(mse, shown, numbers), mse)
