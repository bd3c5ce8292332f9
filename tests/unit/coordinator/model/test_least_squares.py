"""The driver of fits by damped steps, and the linear equations of a step."""

import math

import numpy as np
import pytest

from atoll_coordinator.model.least_squares import Descent, Fitter, coefficients_of, inverse, minimize, solver

START = np.array([-1.2, 1.0])


class Valley(Fitter):
    """Rosenbrock's function: half the sum of squares of `residuals`. Its steps are written down."""

    def __init__(self, start=START, most=math.inf, settled=1e-20):
        self.start, self.most, self.least, self.tried = start, most, settled, []

    @staticmethod
    def residuals(at):
        return np.array([10.0 * (at[1] - at[0] ** 2), 1.0 - at[0]])

    def cost(self, at):
        return 0.5 * float((self.residuals(at) ** 2).sum())

    def init(self):
        return self.start

    def equations(self, at):
        jacobian = np.array([[-20.0 * at[0], 10.0], [-1.0, 0.0]])
        reach = np.full(2, -math.inf), np.array([self.most - at[0], math.inf])
        return solver(jacobian.T @ jacobian, jacobian.T @ self.residuals(at), reach)

    def step(self, at, step):
        self.tried.append(at + step)
        return at + step, self.cost(at) - self.cost(at + step)

    def least_gain(self, at):
        return self.least

    def result(self, at):
        return at


def test_steps_lead_along_a_curved_valley_to_the_least_cost():
    assert minimize(Valley(), 60) == pytest.approx([1.0, 1.0])


def test_a_bound_holds_and_the_other_number_fits_beside_it():
    assert minimize(Valley(most=0.5), 60) == pytest.approx([0.5, 0.25])


def test_a_step_that_promises_nothing_is_not_tried():
    valley = Valley(settled=1.001 * Valley().cost(START))
    assert (minimize(valley) == START).all()
    assert not valley.tried


def test_the_fit_ends_when_it_is_done_which_is_asked_once_at_a_point():
    points = []

    class Ending(Valley):
        def done(self, at, promise, taken):
            points.append(tuple(at))
            return taken >= 3

    valley = Ending()
    minimize(valley, 60)
    assert len(valley.tried) >= 3
    assert len(set(points)) == len(points) > 1


def test_a_fit_without_a_first_point_has_the_result_of_none():
    assert minimize(Valley(start=None)) is None


def test_steps_that_never_lower_the_cost_and_equations_without_solution_leave_the_point():
    one = np.ones((1, 1))
    assert minimize(Descent(0.0, lambda _: solver(one, np.ones(1)), lambda at, _: (at, -1.0), lambda _: 0.0)) == 0.0
    unsolvable = Descent(0.0, lambda _: solver(-one, np.full(1, math.nan)), lambda at, _: (at, 1.0), lambda _: 0.0)
    assert minimize(unsolvable) == 0.0


def test_a_number_of_which_the_cost_does_not_depend_stays():
    step, promise = solver(np.diag([4.0, 0.0]), np.array([2.0, 0.0]))(1.0)
    assert step == pytest.approx([-0.25, 0.0])
    assert promise == pytest.approx(0.25)


def test_coefficients_do_not_depend_on_the_units_of_columns():
    columns, target = np.array([[1.0, 2.0, 3.0], [1.0, 1.0, 1.0]]), np.array([1.0, 3.0, 5.0])
    assert coefficients_of(columns, target) == pytest.approx([2.0, -1.0])
    assert coefficients_of(columns * [[1e9], [1e-9]], target) == pytest.approx([2e-9, -1e9])
    assert coefficients_of(np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]]), target) == pytest.approx([0.0, 3.0])


def test_an_inverse_is_that_of_any_units_and_huge_where_a_ridge_alone_decides():
    matrix, units = np.array([[2.0, 1.0], [1.0, 3.0]]), np.array([1e8, 1e-8])
    assert inverse(matrix * np.outer(units, units)) == pytest.approx(np.linalg.inv(matrix) / np.outer(units, units))
    assert inverse(np.ones((2, 2))) == pytest.approx(np.full((2, 2), 0.25))
    assert inverse(np.ones((2, 2)), ridge=1e-12)[0, 0] > 1e11
