"""Estimates as they are shown: which simple numbers the data single out, and in how many digits the others."""

import math

import numpy as np
import pytest

from atoll_coordinator.model.constants.rounding import (
    Decision,
    Estimates,
    FittedEquations,
    continuum_density,
    search_decisions,
    simple_numbers,
)
from atoll_coordinator.settings import SETTINGS
from atoll_core.expression.restrictions import NONE, Restrictions
from atoll_core.expression.shapes import read_shapes
from atoll_core.expression.text.infix import to_infix
from atoll_core.expression.text.parsing import from_infix

ODDS = math.exp(SETTINGS.inference.distinct_nats)


def shown(value, error):
    estimates = Estimates(np.array([value]), np.array([[error * error]]))
    return float(estimates.round_values()[0]), estimates.simple[0]


def test_an_estimate_is_not_shown_as_a_prettier_number_within_its_error():
    value, simple = shown(0.526, 0.037)
    assert value == 0.526
    assert (simple.value, simple.odds < ODDS) == (0.5, True)
    assert simple.standard_errors == pytest.approx(0.026 / 0.037)


@pytest.mark.parametrize(
    ("value", "error", "expected"),
    [
        (1.09999999998, 1e-10, 1.1),
        (3.0012, 0.003, 3.0),
        (28.00001, 2e-5, 28.0),
        (0.33334, 1e-4, 1.0 / 3.0),
        (-2.66667, 1e-5, -8.0 / 3.0),
        (1.5707963, 1e-7, math.pi / 2.0),
        (2.0e6, 300.0, 2e6),
        (0.1, 0.0, 0.1),
    ],
)
def test_a_number_that_the_data_single_out_is_shown(value, error, expected):
    numbers, simple = shown(value, error)
    assert numbers == simple.value == expected
    assert simple.odds >= ODDS


@pytest.mark.parametrize(
    ("value", "error", "expected"),
    [
        (0.79314, 0.0031, 0.7931),
        (-123.456, 1.7, -123.5),
        (1.23456e-7, 2.5e-9, 1.235e-7),
        (98765.4, 430.0, 98770.0),
        (1.7, 52.0, 1.7),
        (math.pi * 1.3, 0.0, math.pi * 1.3),
    ],
)
def test_an_estimate_keeps_two_digits_of_its_error(value, error, expected):
    assert shown(value, error)[0] == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("factor", [1e-9, 1e-3, 1e3, 1e9])
def test_a_change_of_unit_changes_no_decision_between_decimals(factor):
    """Only fractions and whole numbers, of which another unit has more or fewer, make a difference."""
    value, error = 7.0, 0.001
    here, there = shown(value, error)[1], shown(value * factor, error * factor)[1]
    assert there.value == pytest.approx(here.value * factor)
    assert (here.odds >= ODDS) == (there.odds >= ODDS)


def test_constants_that_are_determined_together_are_singled_out_together():
    """Neither is known to a tenth alone, but their difference to a millionth."""
    covariance = 0.05**2 * np.ones((2, 2)) + np.diag([0.0, 1e-12])
    moved = Estimates(np.array([2.03, 3.03]), covariance).round_values() - np.array([2.03, 3.03])
    assert moved[1] == pytest.approx(moved[0], abs=1e-6)


def test_the_last_of_correlated_estimates_keeps_the_digits_that_it_needs():
    covariance = 0.05**2 * np.ones((2, 2)) + np.diag([0.0, 1e-10])
    means = np.array([2.0314159, 3.0271828])
    rounded = Estimates(means, covariance).round_values(estimates=(0, 1))
    away = rounded - means
    assert str(rounded[0]) == "2.031"
    assert 0.5 * away @ np.linalg.solve(covariance, away) < 0.01


def test_one_constant_stays_an_estimate_while_another_becomes_simple():
    estimates = Estimates(np.array([2.000001, 3.000001]), np.diag([1e-12, 1e-12]))
    assert estimates.round_values(estimates=(1,)).tolist() == [2.0, 3.000001]
    assert estimates.simple[1].value == 3.0


def test_the_probability_of_any_number_is_that_of_the_simple_ones_of_its_decade():
    for decade in (-2, 0, 1):
        points = np.exp(np.linspace(math.log(10.0**decade), math.log(10.0 ** (decade + 1)), 200)[:-1])
        widths = np.diff(np.append(points, 10.0 ** (decade + 1)))
        continuum = sum(continuum_density(float(point)) * width for point, width in zip(points, widths, strict=True))
        near = [simple_numbers(float(value), 0.001 * value) for value in points]
        few = {number: length for rounded in near for number, length in rounded.items()}
        few = {number: length for number, length in few.items() if 10.0**decade <= number < 10.0 ** (decade + 1)}
        simple = sum(math.exp(-length) for length in few.values())
        assert continuum == pytest.approx(simple, rel=0.25)


def test_simple_numbers_speak_for_each_other_and_estimates_against_one_that_is_alone():
    """Any share of simple constants is as likely before the data: of 0.5 alone the odds are those of the data."""
    others = [(4.0003, 5e-4), (1.0002, 3e-4), (3.001, 2e-3)], [(4.1357, 5e-4), (1.0283, 3e-4), (3.0713, 2e-3)]
    odds = []
    for beside in ([], *others):
        means, errors = np.array([(0.5003, 0.008), *beside]).T
        odds.append(Estimates(means, np.diag(errors**2)).simple[0].odds)
    alone, among_simple, among_estimates = odds
    assert among_simple > 1.5 * alone
    assert among_estimates < 0.5 * alone


def test_a_constant_is_simple_as_a_factor_of_another():
    """0.9 (1/9 + f) is 0.1 + 0.9 f; 1/9 by itself is no simple number."""
    rounded = Estimates(np.array([0.9001, 0.11112]), np.diag([2e-4, 5e-5]) ** 2).round_values()
    assert rounded.tolist() == pytest.approx([0.9, 1.0 / 9.0], rel=1e-12)
    assert Estimates(np.array([0.11112]), np.array([[5e-5**2]])).round_values()[0] == 0.11112


def test_simple_numbers_are_judged_together_where_each_alone_stays_an_estimate():
    means, errors = np.array([0.9004, 0.1114]), np.array([8e-4, 4e-4])
    covariance = np.outer(errors, errors) * np.array([[1.0, -0.6], [-0.6, 1.0]])
    rounding = Estimates(means, covariance)
    assert rounding.simple[1].odds < ODDS
    rounded = rounding.joint_simple_numbers([0, 1])
    assert rounded.constants == (0, 1)
    assert rounded.values == pytest.approx((0.9, 1.0 / 9.0))
    assert 1.0 < rounded.odds <= min(simple.odds for simple in rounding.simple)
    away = means - rounded.values
    assert rounded.chi_square == pytest.approx(away @ np.linalg.solve(covariance, away))
    assert rounding.joint_simple_numbers([1]) is None


def test_the_places_of_simple_numbers_are_those_in_the_equation():
    rounding = Estimates(np.array([3.7281, 2.00001, 5.00001]), np.diag([1e-4, 1e-5, 1e-5]) ** 2)
    rounded = rounding.joint_simple_numbers([2, 0, 1])
    assert rounded.constants == (0, 2)
    assert rounded.values == (5.0, 2.0)
    assert rounded.odds > ODDS


@pytest.mark.slow
def test_simple_numbers_are_rarely_false_where_all_constants_have_random_digits():
    """A number is shown with odds of 20 and more: if that is right, of random digits in less than one case of 20."""
    random, false = np.random.default_rng(7), 0
    for _ in range(40):
        truth = np.exp(random.uniform(-2.0, 2.0, 3))
        errors = truth * 10.0 ** random.uniform(-3.0, -1.0, 3)
        covariance = np.corrcoef(random.normal(size=(3, 8))) * np.outer(errors, errors)
        estimates = Estimates(random.multivariate_normal(truth, covariance), covariance)
        shown = zip(estimates.round_values(), estimates.simple, strict=True)
        false += sum(near is not None and near.value == value for value, near in shown)
    assert false <= 6


def test_constants_that_only_their_sum_is_known_of_are_no_division_by_zero():
    assert np.isfinite(Estimates(np.array([1.0, 2.0, 3.0]), 0.01 * np.ones((3, 3))).round_values()).all()


@pytest.mark.parametrize("mean", [math.inf, -math.inf])
def test_no_number_is_near_an_estimate_that_overflows(mean):
    with np.errstate(all="ignore"):  # as in the processes that refine
        considered = search_decisions(Decision.start(np.array([2.0, mean]), np.diag([1e-6, 1.0])))
    assert {index for decision in considered for index, _ in decision.numbers} == {0}


def test_decisions_that_go_on_are_those_of_most_nats_whatever_their_order():
    """A pair of constants is decided in two orders; one of them stays, and the others moved as they are conditioned."""
    covariance = 0.02**2 * np.array([[1.0, 0.5, 0.0], [0.5, 1.0, 0.5], [0.0, 0.5, 1.0]])
    means = np.array([2.01, 3.01, 0.7])
    considered = search_decisions(Decision.start(means, covariance))
    assert len({decision.numbers for decision in considered}) == len(considered)
    for decision in considered:
        fixed, left = [index for index, _ in decision.numbers], list(decision.undecided)
        moved = np.array([value for _, value in decision.numbers]) - means[fixed]
        inverse = np.linalg.inv(covariance[np.ix_(fixed, fixed)])
        expected = means[left] + covariance[np.ix_(left, fixed)] @ inverse @ moved
        assert decision.means == pytest.approx(expected)


@pytest.mark.parametrize(("is_shaped", "expected"), [(False, "3.0 - x"), (True, "3.0012 - x")])
def test_rounding_that_leaves_a_demanded_shape_is_not_accepted(is_shaped, expected):
    """The equation is positive up to x = 3.0011 with the estimate, and not with the simple number."""
    positive = Restrictions(shapes=read_shapes(["positive"], ["x"], ""), points=np.linspace(2.99, 3.0011, 20)[None])
    program = from_infix("3.0012 - x", ["x"])
    equations = FittedEquations(
        [program], Estimates(np.array([3.0012]), np.array([[9e-6]])), [positive if is_shaped else NONE]
    )
    assert to_infix(equations.round_equations().programs[0], ["x"]) == expected
    assert to_infix(equations.accept_simple_numbers(lambda _: 0.0)[0], ["x"]) == expected
