"""The equation of one variable by regression on its target: the shortest that the front leads to (ADR 0012).

*Shortening.* The search compares individuals by their error on some rows; here whole descriptions are compared, on all
rows. Members of the front that are far from the shortest are left out; the others are reduced. Then the programs one
step from the smallest of the nearly shortest descriptions are tried (a larger one may have begun to describe the
noise), then programs one step from the shortest as long as the description gets shorter; not when its errors are at the
limit, where only its size could be better. The work is bounded by a number of point evaluations, not by the clock,
unless there is a deadline. *Finishing.* Constants of the shortest program become simple numbers where the data single
them out, by the same rules as for systems along trajectories (`rounding`); they get standard errors, and the program
its errors on all rows. The front stays as the search found it.
"""

import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from atoll_coordinator.model.criteria import RegressionCriterion
from atoll_coordinator.model.deadline import Deadline
from atoll_coordinator.model.pools import Member, may_be_shown
from atoll_coordinator.model.refinement import Alternative, Refined
from atoll_coordinator.model.regression.covariance import covariance_of, estimate_constants
from atoll_coordinator.model.regression.errors import errors_on
from atoll_coordinator.model.regression.fit import Fitted, LeastSquares
from atoll_coordinator.model.regression.rounding import Estimates, allowed_growth, find_simple
from atoll_coordinator.model.structure.moves.neighbours import neighbours
from atoll_coordinator.model.structure.moves.reductions import reductions
from atoll_coordinator.model.thinning import thinned_places
from atoll_coordinator.result.equations import SimpleNumber, SimpleTogether
from atoll_coordinator.settings import SETTINGS
from atoll_core.config import JobConfig
from atoll_core.data.dataset import FloatArray, Problem
from atoll_core.expression.operators import BY_NAME
from atoll_core.expression.program import Program, constant_places, structure, with_constants
from atoll_core.expression.restrictions import restrictions_of
from atoll_core.expression.unit_coefficients import make_coefficients_explicit, write_factors
from atoll_core.expression.writing.expansion import form_of
from atoll_core.expression.writing.shortest import collected, shortest, shortest_over

_MARGIN: Final = 2.0 * SETTINGS.inference.distinct_nats
"""Neighbours are candidates whose description is longer than the best by at most this many nats (odds of 400), and the
neighbours of the smallest program within this limit are tried, too."""


@dataclass(frozen=True, eq=False)
class WeighedRows:
    """The rows that decide constants, with their `weights` (R,), 1 on average; None: all count alike."""

    problem: Problem
    weights: FloatArray | None = None

    def spread(self, most: int) -> "WeighedRows":
        """Return about `most` rows, spread evenly over all, and not in step with a period of theirs."""
        problem, weights = self.problem, self.weights
        if len(problem.target.values) > most:
            places = thinned_places(len(problem.target.values), most)
            target = replace(problem.target, values=problem.target.values[places])
            problem = Problem(problem.names, np.ascontiguousarray(problem.inputs[:, places]), target)
            weights = None if weights is None else weights[places]
        return WeighedRows(problem, None if weights is None else weights / weights.mean())


@dataclass(frozen=True, eq=False)
class FrontCandidate:
    """A fitted program, its description length in nats, and the number of the front member that it came from."""

    member: int
    fitted: Fitted
    length: float

    @property
    def rank(self) -> tuple[float, int, bytes]:
        """Smaller for better candidates: shorter descriptions, then smaller programs."""
        return (self.length, len(self.fitted.program), self.fitted.program.to_bytes())


class Shortening:
    """Shortens the front of one problem. Remembers its fits, by structure."""

    def __init__(
        self, problem: Problem, operators: Collection[int], variables: Collection[int] | None = None,
        least_squares: LeastSquares | None = None, deadline: Deadline | None = None,
    ) -> None:  # fmt: skip
        """`operators` (codes) and `variables` (indices, all unless given) are what new programs may bring in.

        `least_squares` fits to the rows of `problem`; None: all alike.
        """
        self.criterion: Final = RegressionCriterion.of(problem.target)
        self.least_squares: Final = least_squares or LeastSquares(problem)
        self._variables = range(len(problem.names)) if variables is None else variables
        self._operators = operators
        self._deadline = deadline or Deadline()
        self._fits: dict[bytes, tuple[Fitted, float]] = {}
        self._ends: dict[bytes, Fitted] = {}

    def candidates(self, front: Sequence[Program], looks_around: bool = True) -> list[FrontCandidate]:
        """Return the programs that `front` leads to, the shortest first; nothing when none has a finite error.

        Without `looks_around`, neighbours of the members are not tried.
        """
        candidates: dict[bytes, FrontCandidate] = {}

        def take_in(member: int, fits: Iterable[Fitted]) -> None:
            for fitted in fits:
                candidates.setdefault(structure(fitted.program), FrontCandidate(member, fitted, self._length(fitted)))

        def shortest_candidate() -> FrontCandidate:
            return min(candidates.values(), key=lambda candidate: candidate.rank)

        for member, fitted in self._members(front):
            take_in(member, (fitted, self._reduced(fitted)))
        if candidates and looks_around:
            best = shortest_candidate()
            near = [candidate for candidate in candidates.values() if candidate.length <= best.length + _MARGIN]
            simple = min(near or [best], key=lambda candidate: (len(candidate.fitted.program), candidate.rank))
            if simple is not best and not self._is_exact(best):
                take_in(simple.member, self._around(simple))
                best = shortest_candidate()
            while not self._is_exact(best) and not self._is_exhausted():
                take_in(best.member, self._around(best))
                following = shortest_candidate()
                if following is best:
                    break
                best = following
        return sorted(candidates.values(), key=lambda candidate: candidate.rank)

    def _is_exact(self, candidate: FrontCandidate) -> bool:
        return candidate.fitted.mse <= self.criterion.least_variance

    def _length(self, fitted: Fitted) -> float:
        return self.criterion.length(fitted.mse, fitted.program)

    def _members(self, front: Sequence[Program]) -> list[tuple[int, Fitted]]:
        """Return the members worth the effort, polished, by rising length; of equal structures the first."""
        fits = {structure(program): (index, program) for index, program in reversed([*enumerate(map(shortest, front))])}
        polished = [(index, self._fitted(program)) for index, program in fits.values()]
        return sorted(polished, key=lambda entry: (self._length(entry[1]), entry[0]))[: SETTINGS.effort.beam]

    def _fitted(self, program: Program, enough: float = 0.0) -> Fitted:
        """Return `program` fitted; less well when it will not come near the mean squared error `enough`."""
        key = structure(program)
        known = self._fits.get(key)
        if known is None or (known[0].mse > known[1] > 0.0 and not 0.0 < enough <= known[1]):
            known = self._fits[key] = self.least_squares.fit(program, enough=enough), enough
        return known[0]

    def _tried(self, program: Program, length: float) -> tuple[float, Fitted]:
        """Return `program` fitted and its length, which is of interest when it is less than `length`."""
        fitted = self._fitted(program, self.criterion.mse_of(length - self.criterion.length_of_program(program)))
        return self._length(fitted), fitted

    def _reduced(self, fitted: Fitted) -> Fitted:
        """Follow the reductions, each time the one of the shortest description, until none is shorter."""
        path: list[bytes] = []
        while structure(fitted.program) not in self._ends:
            path.append(structure(fitted.program))
            best, least = None, self._length(fitted)
            for program in reductions(fitted.program):
                if self._is_exhausted():
                    break
                length, reduced = self._tried(program, least)
                if length < least:
                    best, least = reduced, length
            if best is None:
                self._ends[path[-1]] = fitted
            else:
                fitted = best
        end = self._ends[structure(fitted.program)]
        self._ends |= dict.fromkeys(path, end)
        return end

    def _around(self, best: FrontCandidate) -> list[Fitted]:
        """Return the most promising programs one step from `best`, each also reduced.

        Of programs with equal errors, which are equal functions, the shortest is kept; of programs equal to `best`, the
        shortest for each collection of operators, since their constants may be simpler.
        """
        most = best.length + _MARGIN
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


def fit_equation(
    problem: Problem, config: JobConfig, front: Sequence[Member], counted: WeighedRows | None = None,
    deadline: Deadline | None = None, *, has_intervals: bool = False,
) -> Refined | None:  # fmt: skip
    """Return the shortest model that can be made of `front`; None when the front must stay as it is.

    That is so when the front is empty, and when a member meets the error at which the equation counts as found, but
    nothing shorter does. Pure without a `deadline`, after which nothing new is tried. Takes about a second for a few
    hundred noisy rows, less for exact ones.

    Args:
        problem: its rows, which the search saw, are counted alike for the errors.
        config: of the job.
        front: members of the front.
        counted: the rows that decide the constants; None: the same rows, all alike.
        deadline: see above.
        has_intervals: the errors of the rows are independent, and constants have 95 % intervals.
    """
    limit = problem.target.convergence_error(config.budget.target_error)
    has_converged = any(member.error <= limit for member in front)
    if has_converged:
        kept = [index for index, member in enumerate(front) if member.error <= limit]
    else:
        kept, limit = [*range(len(front))], math.inf
    variable = problem.target.variable
    operators = frozenset(BY_NAME[name].code for name in config.space.operators_for(variable))
    allowed = config.space.columns_for(variable, problem.names)
    restrictions = restrictions_of(config, variable, problem.names)
    counted = WeighedRows(problem) if counted is None else counted
    spread = counted.spread(SETTINGS.rows.most)
    least_squares = LeastSquares(spread.problem, spread.weights, restrictions)
    shortening = Shortening(spread.problem, operators, allowed, least_squares, deadline)
    candidates = shortening.candidates([front[index].program for index in kept], looks_around=not has_converged)
    all_rows = LeastSquares(counted.problem, counted.weights, restrictions)

    def may_stand(program: Program) -> bool:
        return restrictions.are_kept(program) and may_be_shown(program, config.space.max_size)

    for candidate in candidates:
        member = kept[candidate.member]
        refined = _finished(problem, counted, candidate, member, config, all_rows, has_intervals=has_intervals)
        is_member = structure(shortest(front[member].program)) == structure(shortest(candidate.fitted.program))
        refined = replace(refined, origin="front" if is_member else "descent")
        if refined.error <= limit and may_stand(refined.program):
            for index, same in enumerate(front):  # the very same program has the errors that the search measured
                if same.program == refined.program:
                    refined = replace(refined, member=index, error=same.error, mse=same.mse, origin="front")
                    break
            if not has_intervals:
                return refined
            others = [other for other in candidates if may_stand(other.fitted.program)]
            return replace(refined, alternatives=_alternatives(refined, candidate, others, problem))
    return None


def _alternatives(
    shown: Refined, chosen: FrontCandidate, candidates: Sequence[FrontCandidate], problem: Problem
) -> tuple[Alternative, ...]:
    """Return the equation that is shown and its alternatives, the shortest descriptions first.

    Each form once. More constants always describe about as well: such candidates are no alternatives, unless they
    describe the rows far better. Constants are counted before some become simple.
    """
    variance = problem.target.standard_deviation**2
    most = len(constant_places(chosen.fitted.program))
    distinct = {form_of(shown.program): chosen}
    for candidate in candidates:
        nats, count = candidate.length - chosen.length, len(constant_places(candidate.fitted.program))
        if count <= most or nats < -SETTINGS.inference.distinct_nats:
            distinct.setdefault(form_of(candidate.fitted.program), candidate)

    def r2(mse: float) -> float | None:
        return 1.0 - mse / variance if variance and math.isfinite(mse) else None

    others = [candidate for candidate in distinct.values() if candidate is not chosen][: SETTINGS.effort.beam]
    return (
        Alternative(shown.program, 0.0, r2(shown.mse), is_shown=True, origin=shown.origin),
        *(
            Alternative(one.fitted.program, one.length - chosen.length, r2(one.fitted.mse), origin="descent")
            for one in others
        ),
    )


def _finished(  # noqa: PLR0913, whose constants, by which rows, as what
    problem: Problem, counted: WeighedRows, candidate: FrontCandidate, member: int, config: JobConfig,
    least_squares: LeastSquares, *, has_intervals: bool,
) -> Refined:  # fmt: skip
    """Decide the constants on all rows that count; measure errors and standard errors."""
    bounds, criterion = least_squares.restrictions.bounds, RegressionCriterion.of(counted.problem.target)
    program = _with_simple_numbers(candidate.fitted.program, criterion, least_squares)
    short = shortest_over(program, counted.problem.inputs) if bounds is None else bounds.written(program) or program
    if may_be_shown(short, config.space.max_size):
        program = short
    refuted = estimate_constants(program, least_squares, criterion, has_intervals=has_intervals).refuted_factors
    if refuted:
        explicit = make_coefficients_explicit(program)
        written = write_factors(explicit, least_squares.fit(explicit.program).program, refuted)
        program = written if may_be_shown(written, config.space.max_size) else program
    program, simple, together = _with_estimates(program, criterion, least_squares)
    error, mse = errors_on(problem, program, config.evolution.loss)
    known = estimate_constants(program, least_squares, criterion, has_intervals=has_intervals)
    known = known.with_simple(simple)
    return Refined(member, program, error, mse, known.written, known.unit_coefficients, simple_together=together)


def _with_simple_numbers(program: Program, criterion: RegressionCriterion, least_squares: LeastSquares) -> Program:
    """Return a program with simple constants where the rows single them out, others fitted, neutral ones left out.

    As it is fitted where there are too many constants, or where simple ones fit less well than they should.
    """
    fitted = least_squares.fit(program)
    places = constant_places(fitted.program)
    if not 0 < len(places) <= SETTINGS.effort.beam or not math.isfinite(fitted.mse):
        return fitted.program
    means, spread = fitted.program.constants[places], covariance_of(fitted, criterion)
    numbers = find_simple(means, spread)
    decided = {places[index]: number for index, number in numbers.items()}
    if not decided:
        return fitted.program
    rounded = least_squares.fit(with_constants(fitted.program, decided), [*decided])
    growth = criterion.misfit(rounded.mse) - criterion.misfit(fitted.mse)
    return collected(rounded.program) if growth <= allowed_growth(means, spread, numbers) else fitted.program


def _with_estimates(
    program: Program, criterion: RegressionCriterion, least_squares: LeastSquares
) -> tuple[Program, tuple[SimpleNumber | None, ...], SimpleTogether | None]:
    """Return a program with constants as they are shown, the simple numbers near them, and their joint odds."""
    fitted, places = least_squares.fit(program), constant_places(program)
    if not places or not math.isfinite(fitted.mse):
        return program, (None,) * len(places), None
    many = range(len(places)) if len(places) > SETTINGS.effort.beam else ()
    rounding = Estimates(fitted.program.constants[places], covariance_of(fitted, criterion)).rounded(estimates=many)
    shown = with_constants(program, dict(zip(places, rounding.values.tolist(), strict=True)))
    bounds = least_squares.restrictions.bounds
    together = rounding.together(range(len(places)))
    return shown if bounds is None else bounds.clipped(shown), rounding.simple, together
