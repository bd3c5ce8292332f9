"""The equation of one variable by regression on its target: the shortest that the front leads to (ADR 0012).

The front stays as the search found it. What is made of it is a program with simple constants where the data cannot
tell the difference, its errors on all rows, and the standard errors of its constants.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from atoll_coordinator.model.criteria import RegressionCriterion
from atoll_coordinator.model.deadline import Deadline
from atoll_coordinator.model.pools import Member, may_be_shown
from atoll_coordinator.model.refinement import Alternative, Refined
from atoll_coordinator.model.regression.covariance import covariance_of, estimate_constants
from atoll_coordinator.model.regression.errors import errors_on
from atoll_coordinator.model.regression.fit import LeastSquares
from atoll_coordinator.model.regression.rounding import Estimates, round_constants
from atoll_coordinator.model.regression.shortening import Candidate, Shortening
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
from atoll_core.expression.writing.shortest import shortest, shortest_over


@dataclass(frozen=True, eq=False)
class WeighedRows:
    """The rows that decide constants, with their `weights` (R,), 1 on average; None: all count alike."""

    problem: Problem
    weights: FloatArray | None = None


def fit_equation(
    problem: Problem, config: JobConfig, front: Sequence[Member], counted: WeighedRows | None = None,
    deadline: Deadline | None = None, *, has_intervals: bool = False,
) -> Refined | None:  # fmt: skip
    """Return the shortest model that can be made of `front`; None when that must stay as it is.

    The rows of `problem`, which the search saw, are counted alike for the errors. Those `counted` decide the constants,
    by their weights; None: the same rows, all alike. With `has_intervals` the errors of the rows are independent, and
    constants have 95 % intervals.
    That is so when the front is empty, and when a member meets the error at which the equation counts as found, but
    nothing shorter does. Pure without a `deadline`, after which nothing new is tried. Takes about a second for a few
    hundred noisy rows, less for exact ones.
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
    spread = _spread(counted.problem, SETTINGS.rows.most)
    least_squares = LeastSquares(spread, _spread_weights(counted.weights, SETTINGS.rows.most), restrictions)
    shortening = Shortening(spread, operators, allowed, least_squares, deadline)
    candidates = shortening.candidates([front[index].program for index in kept], looks_around=not has_converged)
    for candidate in candidates:
        member = kept[candidate.member]
        refined = _finished(problem, counted, candidate, member, config, has_intervals=has_intervals)
        is_member = structure(shortest(front[member].program)) == structure(shortest(candidate.fitted.program))
        refined = replace(refined, origin="front" if is_member else "descent")
        is_admitted = restrictions.are_kept(refined.program)
        if refined.error <= limit and is_admitted and may_be_shown(refined.program, config.space.max_size):
            refined = _as_found(refined, front)
            if not has_intervals:
                return refined
            others = [
                other
                for other in candidates
                if restrictions.are_kept(other.model.program)
                and may_be_shown(other.model.program, config.space.max_size)
            ]
            return replace(refined, alternatives=_alternatives(refined, candidate, others, problem))
    return None


def _alternatives(
    shown: Refined, chosen: Candidate, candidates: Sequence[Candidate], problem: Problem
) -> tuple[Alternative, ...]:
    """Return the equation that is shown and what was compared with it, the shortest descriptions first.

    Each form once. More constants always describe about as well: such candidates are no rivals, unless they describe
    the rows far better. Constants are counted before they are made simple.
    """
    variance = problem.target.standard_deviation**2
    most = len(constant_places(chosen.fitted.program))
    distinct = {form_of(shown.program): chosen}
    for candidate in candidates:
        nats, count = candidate.model.length - chosen.model.length, len(constant_places(candidate.fitted.program))
        if count <= most or nats < -SETTINGS.inference.distinct_nats:
            distinct.setdefault(form_of(candidate.model.program), candidate)

    def r2(mse: float) -> float | None:
        return 1.0 - mse / variance if variance and math.isfinite(mse) else None

    others = [candidate for candidate in distinct.values() if candidate is not chosen][: SETTINGS.effort.beam]
    return (
        Alternative(shown.program, 0.0, r2(shown.mse), is_shown=True, origin=shown.origin),
        *(
            Alternative(one.model.program, one.model.length - chosen.model.length, r2(one.model.mse), origin="descent")
            for one in others
        ),
    )


def _finished(
    problem: Problem, counted: WeighedRows, candidate: Candidate, member: int, config: JobConfig,
    *, has_intervals: bool,
) -> Refined:  # fmt: skip
    """Decide the constants on more rows where there are more; measure errors and standard errors."""
    program = candidate.model.program
    restrictions = restrictions_of(config, problem.target.variable, problem.names)
    bounds, criterion = restrictions.bounds, RegressionCriterion.of(counted.problem.target)
    least_squares = LeastSquares(counted.problem, counted.weights, restrictions)
    if len(counted.problem.target.values) > SETTINGS.rows.most:
        program = round_constants(least_squares.fit(candidate.fitted.program), criterion, least_squares).program
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


def _with_estimates(
    program: Program, criterion: RegressionCriterion, least_squares: LeastSquares
) -> tuple[Program, tuple[SimpleNumber | None, ...], SimpleTogether | None]:
    """Return a program with constants as they are shown, the simple numbers near them, and those shown together."""
    fitted, places = least_squares.fit(program), constant_places(program)
    if not places or not math.isfinite(fitted.mse):
        return program, (None,) * len(places), None
    many = range(len(places)) if len(places) > SETTINGS.effort.beam else ()
    rounding = Estimates(fitted.program.constants[places], covariance_of(fitted, criterion)).rounded(estimates=many)
    made = with_constants(program, dict(zip(places, rounding.values.tolist(), strict=True)))
    bounds = least_squares.restrictions.bounds
    together = rounding.together(range(len(places)))
    return made if bounds is None else bounds.clipped(made), rounding.simple, together


def _as_found(refined: Refined, front: Sequence[Member]) -> Refined:
    """Return `refined` with the errors that the search measured when the front has the very same program."""
    for index, member in enumerate(front):
        if member.program == refined.program:
            return replace(refined, member=index, error=member.error, mse=member.mse, origin="front")
    return refined


def _spread(problem: Problem, most: int) -> Problem:
    """Return the problem on about `most` rows, spread evenly over all, and not in step with a period of theirs."""
    rows = len(problem.target.values)
    if rows <= most:
        return problem
    places = thinned_places(rows, most)
    target = replace(problem.target, values=problem.target.values[places])
    return Problem(problem.names, np.ascontiguousarray(problem.inputs[:, places]), target)


def _spread_weights(weights: FloatArray | None, most: int) -> FloatArray | None:
    """Return the weights of the rows that `_spread` returns, 1 on average."""
    if weights is None:
        return None
    chosen = weights if len(weights) <= most else weights[thinned_places(len(weights), most)]
    return np.asarray(chosen / chosen.mean())
