"""The equation of one variable by regression on its target: the shortest description among programs similar to the
front (ADR 0012).

`refine_equation` decides in two stages. *Shortening* (`shortening`): members of the front are reduced and varied, and
all programs are compared by their description length on the rows. *Finishing* (`_finish_equation`): constants of the
shortest program become simple numbers if the data support these numbers (`constants.rounding`, as for trajectories).
Then the standard errors of the constants and the errors of the program on all rows are computed. The front itself is
not changed.

Doubtful: the search for shorter programs is local and limited by a number of evaluations. It compares programs on a
subsample of large tables. The standard errors assume independent errors with equal variances, or with variances
inversely proportional to the weights.
"""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from atoll_coordinator.model.constants.rounding import Estimates, FittedEquations
from atoll_coordinator.model.constants.standard_errors import (
    ConstantErrors,
    EquationConstants,
    describe_constants,
    make_explicit_if_free,
)
from atoll_coordinator.model.deadline import Deadline
from atoll_coordinator.model.description_length import RegressionCriterion
from atoll_coordinator.model.pools import FrontMember, may_be_shown
from atoll_coordinator.model.refinement import Alternative, Refined
from atoll_coordinator.model.regression.errors import measure_errors
from atoll_coordinator.model.regression.fit import FittedProgram, LeastSquares
from atoll_coordinator.model.regression.shortening import MeasuredProgram, Shortening
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
class WeightedRows:
    """The rows to which constants are fitted, and their `weights` (R,). The mean of the weights is 1; None: all weights
    are equal."""

    problem: Problem
    weights: FloatArray | None = None

    def subsample(self, most: int) -> "WeightedRows":
        """Return about `most` rows, spread over all rows. The choice has no period, so a period of the data does not
        matter."""
        problem, weights = self.problem, self.weights
        if len(problem.target.values) > most:
            places = thinned_places(len(problem.target.values), most)
            target = replace(problem.target, values=problem.target.values[places])
            problem = Problem(problem.names, np.ascontiguousarray(problem.inputs[:, places]), target)
            weights = None if weights is None else weights[places]
        return WeightedRows(problem, None if weights is None else weights / weights.mean())


def make_target_shortening(
    least_squares: LeastSquares, criterion: RegressionCriterion, operators: Collection[int], variables: Collection[int],
    deadline: Deadline | None = None,
) -> Shortening:  # fmt: skip
    """Return the shortening of fronts by fits to the rows of a target.

    New programs may contain only these `operators` (codes) and `variables` (indices). The work is limited by a number
    of point evaluations, and by time only if there is a deadline.
    """

    def measure(program: Program, most: float) -> MeasuredProgram:
        enough = criterion.mse_of(most - criterion.length_of_program(program))
        fitted = least_squares.fit(program, enough=enough)
        misfit = criterion.misfit(fitted.mse)
        return MeasuredProgram(fitted.program, misfit, misfit + criterion.length_of_program(fitted.program))

    def is_over() -> bool:
        is_late = deadline is not None and deadline.is_over
        return is_late or least_squares.evaluations > SETTINGS.effort.evaluations

    return Shortening(
        measure, is_over, lambda program: neighbours(program, variables, operators),
        criterion.misfit(criterion.least_variance),
    )  # fmt: skip


def refine_equation(
    problem: Problem, config: JobConfig, front: Sequence[FrontMember], counted: WeightedRows | None = None,
    deadline: Deadline | None = None, *, has_intervals: bool = False,
) -> Refined | None:  # fmt: skip
    """Return the equation with the shortest description among programs similar to the `front`; None if no equation
    replaces the shown member of the front.

    There are two such cases: the front is empty, or a member has reached the target error, but no candidate that may be
    shown has reached it. After the `deadline` no new program is tried. Without a deadline, equal arguments give equal
    results. Takes about a second for a few hundred noisy rows, less for exact rows.

    Args:
        problem: the rows of the search; the errors of the equation are measured on these rows, with equal weights.
        config: the configuration of the job.
        front: members of the front.
        counted: the rows to which constants are fitted; None: the rows of `problem`, with equal weights.
        deadline: see above.
        has_intervals: whether the errors of the rows are independent, so that constants have 95 % intervals.
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
    restrictions = restrictions_of(config, variable, problem.names, problem.inputs)
    counted = WeightedRows(problem) if counted is None else counted
    spread = counted.subsample(SETTINGS.rows.most)
    least_squares = LeastSquares(spread.problem, spread.weights, restrictions)
    criterion = RegressionCriterion.of(spread.problem.target)
    shortening = make_target_shortening(least_squares, criterion, operators, allowed, deadline)
    start_programs = [shortest(front[index].program) for index in kept]
    candidates = shortening.find_candidates(start_programs, tries_neighbours=not has_converged)
    all_rows = LeastSquares(counted.problem, counted.weights, restrictions)

    def is_allowed(program: Program) -> bool:
        return restrictions.are_kept(program) and may_be_shown(program, config.space.max_size)

    for candidate, place in candidates:
        refined = _finish_equation(problem, counted, candidate, config, all_rows, has_intervals=has_intervals)
        is_member = structure(start_programs[place]) == structure(shortest(candidate.program))
        refined = replace(refined, member=kept[place], origin="front" if is_member else "descent")
        if refined.error <= limit and is_allowed(refined.program):
            for index, same in enumerate(front):  # a member: use the errors of the search
                if same.program == refined.program:
                    refined = replace(refined, member=index, error=same.error, mse=same.mse, origin="front")
                    break
            if not has_intervals:
                return refined
            others = [other for other, _ in candidates if is_allowed(other.program)]
            return replace(refined, alternatives=_describe_alternatives(refined, candidate, others, all_rows))
    return None


def _describe_alternatives(
    shown: Refined, chosen: MeasuredProgram, candidates: Sequence[MeasuredProgram], rows: LeastSquares
) -> tuple[Alternative, ...]:
    """Return the equation that is shown and its alternatives, the shortest description first; each form occurs once.

    An equation with more constants always fits about as well, so it counts as an alternative only if its description is
    far shorter. Constants are counted before some of them are replaced by simple numbers.
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


def _finish_equation(
    problem: Problem, counted: WeightedRows, candidate: MeasuredProgram, config: JobConfig,
    least_squares: LeastSquares, *, has_intervals: bool,
) -> Refined:  # fmt: skip
    """Return a candidate as a finished equation: its constants are fitted to all `counted` rows and rounded, and its
    errors are computed."""
    restrictions, criterion = least_squares.restrictions, RegressionCriterion.of(counted.problem.target)
    bounds = restrictions.bounds
    fitted = least_squares.fit(candidate.program)
    program = fitted.program
    if math.isfinite(fitted.mse):
        least = criterion.misfit(fitted.mse)
        (program,) = _attach_estimates(fitted, criterion, restrictions).accept_simple_numbers(
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
        rounded = _attach_estimates(fitted, criterion, restrictions).round_equations()
        (program,), (simple,), (together,) = rounded.programs, rounded.simple, rounded.together
    error, mse = measure_errors(problem, program, config.evolution.loss)
    known = estimate_constants(program, least_squares, criterion, has_intervals=has_intervals).with_simple_numbers(
        simple or ()
    )
    return Refined(None, program, error, mse, known.written, known.unit_coefficients, simple_together=together)


def _attach_estimates(
    fitted: FittedProgram, criterion: RegressionCriterion, restrictions: Restrictions
) -> FittedEquations:
    """Return a fitted equation with the estimates of its constants, for rounding."""
    errors = estimate_errors(fitted, criterion, restrictions)
    return FittedEquations([fitted.program], Estimates(errors.values, errors.finite_covariance), [restrictions])


def estimate_errors(
    fitted: FittedProgram, criterion: RegressionCriterion, restrictions: Restrictions, *, has_intervals: bool = True
) -> ConstantErrors:
    """Return the errors of fitted constants.

    There are n rows and K constants. The variance of the residuals is the sum of squared residuals divided by n - K (at
    least 1); if the square of the target's uncertainty is larger, this square is used. If n is not larger than K, no
    constant is determined.
    """
    values = fitted.program.constants[constant_places(fitted.program)]
    freedom = criterion.rows - len(values)
    if not math.isfinite(fitted.mse):
        unknown = np.ones(len(values), np.bool_)
        return ConstantErrors(values, np.eye(len(values)), unknown, freedom, has_intervals=has_intervals)
    errors = ConstantErrors.from_fit(
        values, fitted.normal, freedom, criterion.variance(fitted.mse * criterion.rows / max(freedom, 1)),
        restrictions.ranges(fitted.program), -fitted.gradient, has_intervals=has_intervals,
    )  # fmt: skip
    return errors if freedom > 0 else replace(errors, undetermined=np.ones_like(errors.undetermined))


def estimate_constants(
    program: Program, least_squares: LeastSquares, criterion: RegressionCriterion, *, has_intervals: bool
) -> EquationConstants:
    """Return the fitted constants of `program` with standard errors. With n rows and K constants, these errors are
    infinite if n <= K.

    Factors of one that are not written are also fitted.

    Args:
        program: the equation as it is shown.
        least_squares: fits the program to the rows.
        criterion: has the number n of these rows and the least variance of their errors.
        has_intervals: whether the errors are independent. Only then are 95 % intervals computed (Student's t with n - K
            degrees of freedom), and constants that the data do not determine are recognised.
    """
    restrictions = least_squares.restrictions
    explicit = make_explicit_if_free(program, restrictions, is_given=False)
    fitted = least_squares.fit(explicit.program)
    if not math.isfinite(fitted.mse):
        explicit, fitted = as_written(program), least_squares.fit(program)
    errors = estimate_errors(fitted, criterion, restrictions, has_intervals=has_intervals)
    return describe_constants((), [explicit], [program], errors)[0]
