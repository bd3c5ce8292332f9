"""Standard errors and intervals of constants: they hold the truth as often as they say, with few rows as well."""

import math

import numpy as np
import pytest

from atoll_coordinator.model.description_length import RegressionCriterion
from atoll_coordinator.model.regression.equation import estimate_constants
from atoll_coordinator.model.regression.fit import LeastSquares
from atoll_core.data.dataset import Problem, Target
from atoll_core.expression.simplification import simplify_program
from atoll_core.expression.text.parsing import from_infix

NAMES = ("x", "y", "z")
TRUTH = {"x": 1.5, "y": -0.7, "z": 1.0, "": 2.0}
"""The factor of z is not written."""
PROGRAM = simplify_program(from_infix("1.5*x - 0.7*y + z + 2.0", NAMES))


def known(rows: int, seed: int, *, has_intervals: bool = True):
    """Return what is known of the constants of the true equation, fitted to labels with errors of deviation one."""
    draw = np.random.default_rng(seed)
    inputs = draw.normal(size=(3, rows))
    labels = 1.5 * inputs[0] - 0.7 * inputs[1] + inputs[2] + 2.0 + draw.normal(size=rows)
    sought = Problem(NAMES, inputs, Target("label", "label", labels, 0.0, float(np.std(labels))))
    criterion = RegressionCriterion.of(sought.target)
    return sought, estimate_constants(PROGRAM, LeastSquares(sought), criterion, has_intervals=has_intervals)


@pytest.mark.slow
def test_intervals_hold_the_truth_nineteen_times_in_twenty():
    """Four constants, ten rows, 1,000 draws; the margin is four standard errors of the binomial share."""
    draws = 1000
    margin = 4.0 * math.sqrt(0.95 * 0.05 / draws)
    hits = np.zeros(4)
    for seed in range(draws):
        _, estimate = known(10, seed)
        constants = [*estimate.written, *(coefficient.constant for coefficient in estimate.unit_coefficients)]
        hits += [low <= constant.value <= high for constant in constants for low, high in [constant.interval]]
    assert hits / draws == pytest.approx(0.95, abs=margin)


def test_constants_and_unit_coefficients_have_the_standard_errors_of_a_joint_linear_fit():
    known_problem, estimate = known(12, 3)
    (unit,) = estimate.unit_coefficients
    design = np.stack([*known_problem.inputs, np.ones(12)]).T
    solution, (squares,), *_ = np.linalg.lstsq(design, known_problem.target.values, rcond=None)
    errors = np.sqrt(np.diag(np.linalg.inv(design.T @ design)) * squares / (12 - 4))
    expected = dict(zip(TRUTH, zip(solution, errors, strict=True), strict=True))
    written = {1.5: "x", 0.7: "y", -0.7: "y", 2.0: ""}
    for constant in estimate.written:
        value, error = expected[written[constant.value]]
        assert (abs(constant.fitted), constant.std_error) == pytest.approx((abs(value), error), rel=1e-5)
    assert (unit.constant.fitted, unit.constant.std_error) == pytest.approx(expected["z"], rel=1e-5)


@pytest.mark.parametrize("rows", [3, 4])
def test_as_many_constants_as_rows_have_no_intervals(rows):
    for constant in known(rows, 0)[1].written:
        assert (constant.std_error, constant.interval, constant.identifiable) == (None, None, False)


def test_without_independent_errors_there_are_no_intervals():
    for constant in known(20, 0, has_intervals=False)[1].written:
        assert constant.std_error > 0.0
        assert (constant.interval, constant.identifiable) == (None, True)


def test_an_equation_without_a_finite_value_has_no_errors():
    known_problem, _ = known(10, 0)
    program = simplify_program(from_infix("2.0*log(x)", NAMES))
    (constant,) = estimate_constants(
        program, LeastSquares(known_problem), RegressionCriterion.of(known_problem.target), has_intervals=True
    ).written
    assert (constant.value, constant.interval, constant.identifiable) == (2.0, None, False)
