"""The equation of one variable by regression on its target: the shortest that the front leads to (ADR 0012).

*Shortening.* See `shortening`; lengths are of all rows. *Finishing.* Constants of the shortest program become simple
numbers where the data single them out, as along trajectories (`constants.rounding`); they get standard errors, and the
program its errors on all rows. The front stays as the search found it.
"""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from atoll_coordinator.model.constants.rounding import Estimates, FittedEquations
from atoll_coordinator.model.constants.standard_errors import (
    ConstantErrors,
    Known,
    describe_constants,
    explicit_coefficients,
)
from atoll_coordinator.model.deadline import Deadline
from atoll_coordinator.model.description_length import RegressionCriterion
from atoll_coordinator.model.pools import Member, may_be_shown
from atoll_coordinator.model.refinement import Alternative, Refined
from atoll_coordinator.model.regression.errors import errors_on
from atoll_coordinator.model.regression.fit import Fitted, LeastSquares
from atoll_coordinator.model.regression.shortening import Measured, Shortening
from atoll_coordinator.model.structure.moves.neighbours import neighbours
from atoll_coordinator.model.thinning import thinned_places
from atoll_coordinator.settings import SETTINGS
from atoll_core.config import JobConfig
from atoll_core.data.dataset import FloatArray, Problem
from atoll_core.expression.operators import BY_NAME
from atoll_core.expression.program import Program, constant_places, structure
from atoll_core.expression.restrictions import Restrictions, restrictions_of
from atoll_core.expression.unit_coefficients import as_written, make_coefficients_explicit, write_factors
from atoll_core.expression.writing.expansion import form_of
from atoll_core.expression.writing.shortest import shortest, shortest_over


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


def target_shortening(
    least_squares: LeastSquares, criterion: RegressionCriterion, operators: Collection[int], variables: Collection[int],
    deadline: Deadline | None = None,
) -> Shortening:  # fmt: skip
    """Return the shortening of fronts by fits to the rows of a target.

    `operators` (codes) and `variables` (indices) are what new programs may bring in. The work is bounded by a number of
    point evaluations, not by the clock, unless there is a deadline.
    """

    def measure(program: Program, most: float) -> Measured:
        enough = criterion.mse_of(most - criterion.length_of_program(program))
        fitted = least_squares.fit(program, enough=enough)
        misfit = criterion.misfit(fitted.mse)
        return Measured(fitted.program, misfit, misfit + criterion.length_of_program(fitted.program))

    def is_over() -> bool:
        is_late = deadline is not None and deadline.is_over
        return is_late or least_squares.evaluations > SETTINGS.effort.evaluations

    return Shortening(
        measure, is_over, lambda program: neighbours(program, variables, operators),
        criterion.misfit(criterion.least_variance),
    )  # fmt: skip


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
    criterion = RegressionCriterion.of(spread.problem.target)
    shortening = target_shortening(least_squares, criterion, operators, allowed, deadline)
    begun = [shortest(front[index].program) for index in kept]
    candidates = shortening.candidates(begun, looks_around=not has_converged)
    all_rows = LeastSquares(counted.problem, counted.weights, restrictions)

    def may_stand(program: Program) -> bool:
        return restrictions.are_kept(program) and may_be_shown(program, config.space.max_size)

    for candidate, place in candidates:
        refined = _finished(problem, counted, candidate, config, all_rows, has_intervals=has_intervals)
        is_member = structure(begun[place]) == structure(shortest(candidate.program))
        refined = replace(refined, member=kept[place], origin="front" if is_member else "descent")
        if refined.error <= limit and may_stand(refined.program):
            for index, same in enumerate(front):  # the very same program has the errors that the search measured
                if same.program == refined.program:
                    refined = replace(refined, member=index, error=same.error, mse=same.mse, origin="front")
                    break
            if not has_intervals:
                return refined
            others = [other for other, _ in candidates if may_stand(other.program)]
            return replace(refined, alternatives=_alternatives(refined, candidate, others, all_rows))
    return None


def _alternatives(
    shown: Refined, chosen: Measured, candidates: Sequence[Measured], rows: LeastSquares
) -> tuple[Alternative, ...]:
    """Return the equation that is shown and its alternatives, the shortest descriptions first.

    Each form once. More constants always describe about as well: such candidates are no alternatives, unless they
    describe the rows far better. Constants are counted before some become simple.
    """
    most = len(constant_places(chosen.program))
    distinct = {form_of(shown.program): chosen}
    for candidate in candidates:
        nats, count = candidate.length - chosen.length, len(constant_places(candidate.program))
        if count <= most or nats < -SETTINGS.inference.distinct_nats:
            distinct.setdefault(form_of(candidate.program), candidate)
    others = [candidate for candidate in distinct.values() if candidate is not chosen][: SETTINGS.effort.beam]
    return (
        Alternative(shown.program, 0.0, rows.r2(shown.program), is_shown=True, origin=shown.origin),
        *(
            Alternative(one.program, one.length - chosen.length, rows.r2(one.program), origin="descent")
            for one in others
        ),
    )


def _finished(
    problem: Problem, counted: WeighedRows, candidate: Measured, config: JobConfig, least_squares: LeastSquares, *,
    has_intervals: bool,
) -> Refined:  # fmt: skip
    """Decide the constants on all rows that count; measure errors and standard errors."""
    restrictions, criterion = least_squares.restrictions, RegressionCriterion.of(counted.problem.target)
    bounds = restrictions.bounds
    fitted = least_squares.fit(candidate.program)
    program = fitted.program
    if math.isfinite(fitted.mse):
        least = criterion.misfit(fitted.mse)
        (program,) = _equations(fitted, criterion, restrictions).simplified(
            lambda programs: criterion.misfit(least_squares.mse(programs[0])) - least
        )
    short = shortest_over(program, counted.problem.inputs) if bounds is None else bounds.written(program) or program
    if may_be_shown(short, config.space.max_size):
        program = short
    refuted = estimate_constants(program, least_squares, criterion, has_intervals=has_intervals).refuted_factors
    if refuted:
        explicit = make_coefficients_explicit(program)
        written = write_factors(explicit, least_squares.fit(explicit.program).program, refuted)
        program = written if may_be_shown(written, config.space.max_size) else program
    fitted, simple, together = least_squares.fit(program), None, None
    if math.isfinite(fitted.mse):
        rounded = _equations(fitted, criterion, restrictions).rounded()
        (program,), (simple,), (together,) = rounded.programs, rounded.simple, rounded.together
    error, mse = errors_on(problem, program, config.evolution.loss)
    known = estimate_constants(program, least_squares, criterion, has_intervals=has_intervals).with_simple(simple or ())
    return Refined(None, program, error, mse, known.written, known.unit_coefficients, simple_together=together)


def _equations(fitted: Fitted, criterion: RegressionCriterion, restrictions: Restrictions) -> FittedEquations:
    """Return a fitted equation with the estimates of its constants, for rounding."""
    errors = estimate_errors(fitted, criterion, restrictions)
    return FittedEquations([fitted.program], Estimates(errors.values, errors.bounded), [restrictions])


def estimate_errors(
    fitted: Fitted, criterion: RegressionCriterion, restrictions: Restrictions, *, has_intervals: bool = True
) -> ConstantErrors:
    """Return the errors of fitted constants.

    The variance of the residuals is the sum of their squares over n - K, which is 1 at least, or the square of the
    target's uncertainty if that is larger. Without more rows n than constants K, no constant is determined.
    """
    values = fitted.program.constants[constant_places(fitted.program)]
    freedom = criterion.rows - len(values)
    if not math.isfinite(fitted.mse):
        unknown = np.ones(len(values), np.bool_)
        return ConstantErrors(values, np.eye(len(values)), unknown, freedom, has_intervals=has_intervals)
    errors = ConstantErrors.of_fit(
        values, fitted.normal, freedom, criterion.variance(fitted.mse * criterion.rows / max(freedom, 1)),
        restrictions.ranges(fitted.program), -fitted.gradient, has_intervals=has_intervals,
    )  # fmt: skip
    return errors if freedom > 0 else replace(errors, open=np.ones_like(errors.open))


def estimate_constants(
    program: Program, least_squares: LeastSquares, criterion: RegressionCriterion, *, has_intervals: bool
) -> Known:
    """Return the constants of `program` as they are fitted, with standard errors; infinite ones where n <= K.

    Factors of one that are not written are fitted as well.

    Args:
        program: the equation as it is shown.
        least_squares: fits it to the rows that decide its constants.
        criterion: has the number n of these rows and the least variance of their errors.
        has_intervals: whether the errors are independent, so that there are 95 % intervals (Student's t with n - K
            degrees of freedom) and constants that the data do not determine are recognised.
    """
    restrictions = least_squares.restrictions
    explicit = explicit_coefficients(program, restrictions, is_given=False)
    fitted = least_squares.fit(explicit.program)
    if not math.isfinite(fitted.mse):
        explicit, fitted = as_written(program), least_squares.fit(program)
    errors = estimate_errors(fitted, criterion, restrictions, has_intervals=has_intervals)
    return describe_constants((), [explicit], [program], errors)[0]
