"""Bounds on constants in fits of trajectories: kept, and as good as they allow."""

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from atoll_coordinator.model.constants.standard_errors import describe_constants
from atoll_coordinator.model.inference.final_model import estimate_errors
from atoll_coordinator.model.selection.comparison import Constraints
from atoll_core.expression.restrictions import EquationBounds, Restrictions, parse_bound
from atoll_core.expression.unit_coefficients import as_written
from tests.unit.coordinator.model.shooting.made import DECAY, LOTKA, LOTKA_TEXT, compare, measurements

TIMES = 0.1 * np.arange(30.0)


def bounded(known, *texts, equation=0, required=()):
    bounds = EquationBounds(tuple(parse_bound(text, known.names) for text in texts)) if texts else None
    return Constraints({equation: Restrictions(bounds, frozenset(required))})


def decay(*texts, noise=0.01):
    return compare(DECAY, measurements(DECAY, ([2.0],), TIMES, noise=noise), constraints=bounded(DECAY, *texts))


def test_a_bound_that_excludes_the_best_constant_is_met_with_equality():
    model = decay("-0.3 < x < 0").fit_model([DECAY.parsed("-0.7*x")])
    (value,) = model.fit.system.values
    assert value == -0.3
    free = decay().fit_model([DECAY.parsed("-0.7*x")])
    assert free.fit.system.values[0] == pytest.approx(-0.5, abs=0.02)
    assert model.misfit > free.misfit + 10.0


def test_the_other_numbers_are_the_best_beside_the_bound():
    comparison = decay("-0.3 < x < 0")
    model = comparison.fit_model([DECAY.parsed("-0.7*x")])
    measured = comparison.estimator.measurements.measured[0]
    curve = np.exp(-0.3 * (TIMES - TIMES[0]))
    best = minimize_scalar(lambda start: float(((measured - start * curve) ** 2).sum()))
    assert model.fit.starts[0, 0] == pytest.approx(best.x, rel=1e-4)


def test_a_bound_that_the_data_keep_changes_no_constant():
    assert decay("-3 < x < 0").fit_model([DECAY.parsed("-0.7*x")]).fit.system.values == pytest.approx(
        decay().fit_model([DECAY.parsed("-0.7*x")]).fit.system.values, rel=1e-6
    )


def test_bounds_are_about_coefficients_also_of_products_of_sums():
    comparison = compare(
        LOTKA, measurements(LOTKA, ([1.0, 3.0], [4.0, 1.0]), TIMES, noise=0.02),
        constraints=bounded(LOTKA, "x*y > -1.5"),
    )  # fmt: skip
    model = comparison.fit_model([LOTKA.parsed("x*(2.5 - 1.8*y - x)"), LOTKA.parsed(LOTKA_TEXT[1])])
    assert LOTKA.text(model.programs[0]).endswith("*x - x**2 - 1.5*x*y")
    (governed,) = comparison.restrictions(0).bounds.governed(model.programs[0])
    assert (governed.values, governed.is_active) == ((-1.5,), True)


def test_programs_without_a_required_variable_are_not_fitted():
    comparison = compare(
        LOTKA, measurements(LOTKA, ([1.0, 3.0],), TIMES, noise=0.02), constraints=bounded(LOTKA, required=(1,))
    )
    other = LOTKA.parsed(LOTKA_TEXT[1])
    assert comparison.fit_model([LOTKA.parsed("2*x - x*x"), other]) is None
    assert comparison.fit_model([LOTKA.parsed("2*x - x*y"), other]) is not None


def test_a_constant_on_its_bound_has_a_one_sided_interval():
    comparison = decay("x > -0.4995", noise=0.01)
    model = comparison.fit_model([DECAY.parsed("-0.3*x")])
    errors = estimate_errors(comparison, model)
    ((constant,),) = (
        known.written for known in describe_constants((), [as_written(model.programs[0])], model.programs, errors)
    )
    free = decay().fit_model([DECAY.parsed("-0.7*x")])
    error = float(np.sqrt(estimate_errors(decay(), free).covariance[0, 0]))
    assert constant.at_bound
    assert constant.std_error is None
    assert constant.interval[0] == -0.4995
    assert 0.0 < constant.interval[1] - constant.interval[0] < 1.96 * error * 1.2


def test_intervals_end_at_bounds_that_are_not_met():
    comparison = decay("-0.5002 < x < -0.4", noise=0.02)
    model = comparison.fit_model([DECAY.parsed("-0.45*x")])
    ((constant,),) = (
        known.written
        for known in describe_constants(
            (), [as_written(model.programs[0])], model.programs, estimate_errors(comparison, model)
        )
    )
    assert constant.bounds == (-0.5002, -0.4)
    assert constant.interval[0] >= -0.5002
