"""What it takes to write a structure down, and what the lengths of descriptions are."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from atoll_coordinator.model.description_length import (
    SMALLEST_UNCERTAINTY,
    RegressionCriterion,
    TrajectoryMisfit,
    constant_nats_of,
    least_term_length,
    program_length,
    structure_length,
    system_length,
)
from atoll_coordinator.model.structure.moves.extensions import extensions
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import Target
from atoll_core.expression.program import with_constants
from atoll_core.expression.text.parsing import from_infix
from tests.unit.coordinator.model.fitting import parsed


def nats(text):
    return structure_length(from_infix(text, ("x", "y")))


@pytest.mark.parametrize(
    ("plain", "dear"),
    [
        ("x", "sin(x)"),
        ("x*y", "x/y"),
        ("x/y", "exp(x)*y"),
        ("sin(x)", "sin(sin(x))"),
        ("sin(x) + sin(y)", "sin(x + sin(y))"),
        ("cos(x)*sin(y)", "cos(x*sin(y))"),
        ("x*x", "exp(x)"),
        ("x*x", "x**1.5"),
        ("x", "x + y"),
        ("2.0*x", "2.0*x + 3.0"),
        ("x*y + 2.0*x", "x*y + 2.0*x + 2.0*y"),
    ],
)
def test_what_is_rarer_in_equations_of_motion_costs_more(plain, dear):
    assert nats(plain) < nats(dear)


def test_a_function_inside_a_function_costs_more_than_both_apart():
    assert nats("sin(cos(x))") > nats("sin(x)") + nats("cos(x)") - nats("x")
    assert nats("sin(2.0*cos(x) + y)") - nats("2.0*cos(x) + y") > nats("sin(x)") - nats("x")


def test_what_is_no_transcendental_function_may_stand_anywhere():
    assert nats("sin(x*x)") - nats("x*x") == pytest.approx(nats("sin(x)") - nats("x"))
    assert nats("sin(-x)") == nats("sin(x)")


def test_a_square_costs_about_as_much_as_the_product():
    assert abs(nats("x**2") - nats("x*x")) <= 1.5


def test_using_a_part_again_is_cheaper_than_writing_it_twice():
    shared = nats("(x + 2.0*y)*(x + 2.0*y)")
    assert shared < nats("(x + 2.0*y)*(x + 3.0*y)")
    assert shared > nats("x + 2.0*y")


@settings(max_examples=30, deadline=None)
@given(value=st.floats(-1e6, 1e6))
def test_the_values_of_constants_do_not_count(value):
    program = parsed("3.5*x + sin(2.5*y)")
    places = [index for index, code in enumerate(program.operators.tolist()) if code == 1]
    assert structure_length(with_constants(program, dict.fromkeys(places, value))) == structure_length(program)


@pytest.mark.parametrize("text", ["x", "3.0*x - 2.0*x*y", "sin(x)/y"])
def test_every_extension_that_is_one_costs_more(text):
    program = parsed(text)
    for extended in extensions(program, [1.0, 1.0], range(2, 17)):
        if len(extended) > len(program):  # sin(x)/y over sin(x) is shorter
            assert structure_length(extended) > structure_length(program)


def misfit(low=0.81, high=1.21, counts=300.0, pieces=20.0, below=20.0, least=0.0, measured=300.0):
    return TrajectoryMisfit(*(np.array([value]) for value in (low, high, least, counts, pieces, below, measured)))


def test_fitted_numbers_take_away_from_the_rows_and_not_from_the_few_numbers_that_systematic_errors_have():
    """Without noise ten numbers count of sixty rows, and a law may have nine."""
    clean = misfit(low=1.0, high=1.0, counts=10.0, pieces=10.0, below=10.0, measured=60.0)
    assert clean.with_fitted(9.0).total(np.array([1e-6])) == clean.total(np.array([1e-6]))
    few = misfit(low=1.0, high=1.0, counts=10.0, pieces=10.0, below=10.0, measured=10.0)
    assert few.with_fitted(9.0).total(np.array([1e-6])) > 0.2 * few.total(np.array([1e-6]))


def test_near_the_independent_errors_every_row_counts():
    criterion = misfit()
    gain = criterion.total(np.array([1.1])) - criterion.total(np.array([0.9]))
    assert gain == pytest.approx(150.0 * np.log(1.1 / 0.9))
    assert criterion.effective_rows(np.array([1.0])) == pytest.approx([300.0])


def test_far_above_only_pieces_count():
    criterion = misfit()
    gain = criterion.total(np.array([1e6])) - criterion.total(np.array([1e4]))
    assert gain == pytest.approx(10.0 * np.log(100.0), rel=1e-3)
    assert criterion.effective_rows(np.array([1e6])) == pytest.approx([20.0], rel=1e-3)


@given(square=st.floats(1e-6, 1e6), low=st.floats(0.1, 1.0), pieces=st.floats(1.0, 300.0))
def test_the_misfit_rises_without_jumps_at_the_rate_of_the_rows_that_decide(square, low, pieces):
    criterion, step = misfit(low=low, pieces=pieces, below=pieces), 1e-5
    before, after = criterion.total(np.array([square])), criterion.total(np.array([square * (1.0 + step)]))
    rows = criterion.effective_rows(np.array([square]))[0]
    assert pieces - 1e-6 <= rows <= 300.0 + 1e-6
    assert after - before == pytest.approx(0.5 * rows * step, rel=0.1, abs=1e-6)


def test_below_the_errors_of_the_integration_nothing_counts():
    criterion = misfit(low=1.0, high=1.0, counts=20.0, below=2.0, least=1e-16)
    assert criterion.total(np.array([1e-20])) == criterion.total(np.array([1e-16]))
    assert criterion.total(np.array([1.0])) - criterion.total(np.array([1e-16])) == pytest.approx(np.log(1e16))


def test_lengths_of_structures_are_sums_over_nodes_and_further_uses():
    common, prices = SETTINGS.criterion.common, SETTINGS.criterion
    assert nats("x") == pytest.approx(common)
    assert nats("x + y") == pytest.approx(3 * common)
    assert nats("x + x*y") == pytest.approx(5 * common)  # four nodes, x twice
    assert nats("x/y") == pytest.approx(2 * common + prices.quotient)
    assert nats("sin(cos(x))") == pytest.approx(common + 2 * prices.function + prices.nested)


def test_algebra_on_a_function_does_not_pay_for_nesting():
    common, function = SETTINGS.criterion.common, SETTINGS.criterion.function
    assert nats("x + sin(y)") == pytest.approx(3 * common + function)
    assert nats("x + y*sin(y)") == pytest.approx(5 * common + function)  # y twice


def test_a_program_costs_its_nodes_and_each_further_use():
    assert program_length(parsed("x + y")) == pytest.approx(3 * math.log(8.0))
    assert program_length(parsed("x + x*y")) == pytest.approx(4 * math.log(8.0) + SETTINGS.criterion.common)
    criterion = RegressionCriterion(100, 0.04)
    expected = criterion.misfit(0.09) + 5 * math.log(8.0) + constant_nats_of(100)
    assert criterion.length(0.09, parsed("x + 2.5*y")) == pytest.approx(expected)


def test_the_misfit_of_a_regression_is_that_of_gaussian_errors_of_the_least_variance_or_more():
    criterion = RegressionCriterion(100, 0.04)
    assert criterion.misfit(0.09) == pytest.approx(50.0 * math.log(0.09))
    assert criterion.misfit(0.01) == pytest.approx(50.0 * (math.log(0.04) + 0.25 - 1.0))
    assert criterion.misfit(math.inf) == math.inf
    assert criterion.mse_of(criterion.misfit(0.09)) == pytest.approx(0.09)
    assert criterion.mse_of(criterion.misfit(0.01)) == pytest.approx(0.08)
    assert RegressionCriterion(1, 1e-290).mse_of(1e3) == pytest.approx(math.exp(700.0))


def test_the_least_variance_is_that_of_the_target_and_never_zero():
    def least(uncertainty, deviation):
        return RegressionCriterion.of(Target("x", "dx/dt", np.zeros(7), uncertainty, deviation)).least_variance

    assert least(0.1, 5.0) == pytest.approx(0.25)
    assert least(0.0, 5.0) == pytest.approx((5.0 * SMALLEST_UNCERTAINTY) ** 2, abs=0.0)
    assert least(0.0, 1e-149) == 1e-290
    assert RegressionCriterion.of(Target("x", "dx/dt", np.zeros(7), 0.1, 5.0)).rows == 7


def test_a_system_costs_its_misfit_its_structures_and_its_constants():
    programs = [parsed("x"), parsed("x + y")]
    structures = sum(map(structure_length, programs))
    assert system_length(10.0, programs, 3, 2.5) == pytest.approx(10.0 + structures + 7.5)
    assert constant_nats_of(100.0) == pytest.approx(0.5 * math.log(100.0))
    assert constant_nats_of(0.5) == constant_nats_of(2.0) == pytest.approx(0.5 * math.log(2.0))
    added = structure_length(parsed("x + 2.0*y")) - structure_length(parsed("x"))
    assert least_term_length(2.5) == pytest.approx(added + 2.5)
