"""Constants fitted to all rows, and their standard errors."""

import math

import numpy as np
import pytest

from atoll_coordinator.model.description_length import RegressionCriterion, program_length
from atoll_coordinator.model.pools import decode_members
from atoll_coordinator.model.regression.equation import (
    WeightedRows,
    estimate_constants,
    estimate_errors,
    refine_equation,
)
from atoll_coordinator.model.regression.fit import LeastSquares
from atoll_core.config import JobConfig, PriorConfig, SpaceConfig
from atoll_core.data.dataset import Problem, Target
from atoll_core.expression.program import constant_places
from atoll_core.expression.restrictions import NONE, EquationBounds, Restrictions, parse_bound
from atoll_core.expression.text.parsing import from_infix
from tests.unit.coordinator.model.fitting import entry, parsed, problem


def truth(x, y):
    return 3.0 * x - x * y / (1.0 + 0.5 * x * x)


def standard_errors(fitted, criterion):
    return estimate_errors(fitted, criterion, NONE).standard_errors.tolist()


def constants(program):
    return program.constants[constant_places(program)].tolist()


def test_exact_data_give_exact_constants():
    fitted = LeastSquares(problem(truth)).fit(parsed("2.0*x - 1.5*x*y/(1.0 + 0.9*x*x)"))
    assert fitted.mse < 1e-28
    assert constants(fitted.program)[0] == pytest.approx(3.0, rel=1e-13)


def test_a_linear_fit_is_that_of_the_normal_equations():
    sought = problem(lambda x, y: 3.0 * x - 2.0 * y, noise=0.1)
    fitted = LeastSquares(sought).fit(parsed("0.1*x + 9.0*y"))
    expected, *_ = np.linalg.lstsq(sought.inputs.T, sought.target.values, rcond=None)
    assert constants(fitted.program) == pytest.approx(expected.tolist(), rel=1e-6)
    rows = len(sought.target.values)
    variance = np.linalg.inv(sought.inputs @ sought.inputs.T) * fitted.mse * rows / (rows - 2)
    errors = standard_errors(fitted, RegressionCriterion.of(sought.target))
    assert errors == pytest.approx(np.sqrt(np.diag(variance)).tolist(), rel=1e-6)


def test_the_variance_of_few_errors_is_over_what_constants_leave_of_them():
    """Of five rows a line leaves three: errors would be 23 % too small over all rows."""
    from scipy import stats

    rows = np.arange(5.0)[None]
    target = Target("y", "y", 2.0 * rows[0] + 1.0 + np.array([0.1, -0.2, 0.05, 0.2, -0.1]), 0.0, 1.0)
    sought = Problem(("x",), rows, target)
    fitted = LeastSquares(sought).fit(from_infix("1.5*x + 0.5", ("x",)))
    expected = stats.linregress(rows[0], target.values)
    errors = standard_errors(fitted, RegressionCriterion.of(target))
    assert sorted(errors) == pytest.approx(sorted([expected.stderr, expected.intercept_stderr]), rel=1e-6)


def test_what_is_fixed_stays():
    program = parsed("2.9*x - 1.5*y")
    first, second = constant_places(program)
    fitted = LeastSquares(problem(lambda x, y: 3.0 * x - 2.0 * y)).fit(program, fixed=[first])
    assert fitted.program.constants[first] == 2.9
    assert fitted.program.constants[second] != 1.5
    assert fitted.normal.shape == (1, 1)


def test_a_hopeless_fit_is_given_up_early():
    patient, hasty = LeastSquares(problem(truth, 0.1)), LeastSquares(problem(truth, 0.1))
    start = parsed("0.1*cos(3.0*x + 0.5*y) + 2.5*sin(4.0*x*y)")
    patient.fit(start)
    hasty.fit(start, enough=1e-9)
    assert hasty.evaluations < patient.evaluations


def test_a_program_without_a_finite_value_stays_and_has_infinite_error():
    fitted = LeastSquares(problem(truth)).fit(parsed("2.0*log(y)"))
    assert fitted.mse == math.inf
    assert RegressionCriterion.of(problem(truth).target).length(fitted.mse, fitted.program) == math.inf


def test_constants_that_the_data_cannot_tell_apart_have_large_errors():
    sought = problem(lambda x, y: 6.0 * x, noise=0.1)
    errors = standard_errors(
        LeastSquares(sought).fit(parsed("(2.0*(3.0*sin(x)))")), RegressionCriterion.of(sought.target)
    )
    assert min(errors) == math.inf


def test_the_misfit_is_flat_below_the_floor_and_inverts_above():
    criterion = RegressionCriterion(100, 0.01)
    assert criterion.misfit(0.04) == pytest.approx(50.0 * math.log(0.04))
    assert criterion.misfit(0.0) == pytest.approx(50.0 * (math.log(0.01) - 1.0))
    assert criterion.mse_of(criterion.misfit(0.04)) == pytest.approx(0.04)
    assert criterion.misfit(math.inf) == math.inf


def test_a_further_use_of_a_node_costs_less_than_a_node():
    assert program_length(parsed("x")) < program_length(parsed("x*x")) < program_length(parsed("x*y"))


def test_rows_count_by_their_weights():
    """A line through the origin: the weighted least squares slope, and its normal equation."""
    weights = np.array([4.0, 1.0, 0.25])
    x, y = np.array([1.0, 2.0, 3.0]), np.array([2.0, 5.0, 1.0])
    problem = Problem(("x",), x[None], Target("y", "y", y, 0.0, 1.0))
    fitted = LeastSquares(problem, weights).fit(from_infix("1.5*x", ("x",)))
    slope = float((weights * x * y).sum() / (weights * x * x).sum())
    assert fitted.program.constants[fitted.program.operators == 1] == pytest.approx([slope])
    assert fitted.mse == pytest.approx(float((weights * (slope * x - y) ** 2).mean()))
    assert fitted.normal == pytest.approx(np.array([[(weights * x * x).sum()]]))
    assert LeastSquares(problem, weights).mse(fitted.program) == pytest.approx(fitted.mse)


def bounded(*texts):
    bounds = EquationBounds(tuple(parse_bound(text, ("x", "y")) for text in texts))
    return Restrictions(bounds)


def test_constants_are_fitted_within_bounds_as_well_as_these_allow():
    sought = problem(lambda x, y: 3.0 * x - 2.0 * y, noise=0.1)
    fitted = LeastSquares(sought, restrictions=bounded("x < 2.5")).fit(parsed("0.1*x + 9.0*y"))
    expected, *_ = np.linalg.lstsq(sought.inputs[1:].T, sought.target.values - 2.5 * sought.inputs[0], rcond=None)
    assert constants(fitted.program) == pytest.approx([2.5, float(expected[0])], rel=1e-6)


def test_a_constant_on_its_bound_has_a_one_sided_interval():
    sought = problem(lambda x, y: 3.0 * x - 2.0 * y, noise=0.1)
    least_squares = LeastSquares(sought, restrictions=bounded("x < 2.5", "y < 0"))
    program = least_squares.fit(parsed("0.1*x - 9.0*y")).program
    on_bound, free = estimate_constants(
        program, least_squares, RegressionCriterion.of(sought.target), has_intervals=True
    ).written
    assert (on_bound.value, on_bound.std_error, on_bound.at_bound) == (2.5, None, True)
    assert on_bound.interval[1] == 2.5
    assert on_bound.interval[0] < 2.5
    assert free.std_error > 0.0
    assert not free.at_bound


def test_what_may_not_stand_has_no_finite_error():
    least_squares = LeastSquares(problem(truth), restrictions=Restrictions(required=frozenset({1})))
    assert least_squares.fit(parsed("2*x")).mse == math.inf
    assert least_squares.fit(parsed("2*x*y")).mse < math.inf


@pytest.mark.slow
def test_an_equation_of_given_targets_keeps_its_bounds():
    sought = problem(lambda x, y: 3.0 * x - 2.0 * y, noise=0.05)
    config = JobConfig(space=SpaceConfig(operators=("+", "-", "*")), prior=PriorConfig(bounds={"label": ("x < 2.5",)}))
    members = decode_members((entry("2.5*x - 1.5*y", sought),), 2)
    fitted = refine_equation(sought, config, members, has_intervals=True)
    bounds = bounded("x < 2.5").bounds
    assert bounds.are_kept(fitted.program)
    assert not bounds.are_kept(
        refine_equation(sought, JobConfig(space=config.space), members, has_intervals=True).program
    )


def test_rows_that_are_compared_are_not_in_step_with_a_period():
    """Of 6,000 rows with three to a period, every third one would be the same point."""
    phases = np.tile([1.0, 2.0, 4.0], 2000)
    problem = Problem(("x",), phases[None], Target("y", "y", 3.0 * phases, 0.0, 1.0))
    spread = WeightedRows(problem, phases).subsample(2000)
    sought = spread.problem
    assert set(sought.inputs[0]) == {1.0, 2.0, 4.0}
    assert sought.target.values.tolist() == (3.0 * sought.inputs[0]).tolist()
    np.testing.assert_allclose(spread.weights, sought.inputs[0] / sought.inputs[0].mean())
