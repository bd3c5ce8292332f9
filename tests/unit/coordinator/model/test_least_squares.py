"""The driver of fits by damped steps, and the linear equations of a step."""

import math

import numpy as np
import pytest

from atoll_coordinator.model.least_squares import coefficients_of, inverse, minimize, solver

START = np.array([-1.2, 1.0])


def cost(at):
    """Rosenbrock's function: half the sum of squares of what `left` returns."""
    return 0.5 * float((left(at) ** 2).sum())


def left(at):
    return np.array([10.0 * (at[1] - at[0] ** 2), 1.0 - at[0]])


def fitted(start=START, most=math.inf, settled=1e-20, steps=60, is_over=lambda *_: False):
    """Return where steps from `start` end, and how many were tried."""
    tried = []

    def linearise(at):
        jacobian = np.array([[-20.0 * at[0], 10.0], [-1.0, 0.0]])
        reach = np.full(2, -math.inf), np.array([most - at[0], math.inf])
        return solver(jacobian.T @ jacobian, jacobian.T @ left(at), reach)

    def move(at, step):
        tried.append(at + step)
        return at + step, cost(at) - cost(at + step)

    return minimize(start, linearise, move, lambda _: settled, steps, is_over), len(tried)


def test_steps_lead_along_a_curved_valley_to_the_least_cost():
    assert fitted()[0] == pytest.approx([1.0, 1.0])


def test_a_bound_holds_and_the_other_number_fits_beside_it():
    end, _ = fitted(most=0.5)
    assert end == pytest.approx([0.5, 0.25])


def test_a_step_that_promises_nothing_is_not_tried():
    end, tried = fitted(settled=1.001 * cost(START))
    assert (end == START).all()
    assert tried == 0


def test_the_fit_ends_when_it_is_told_to_which_is_asked_once_at_a_point():
    points = []

    def is_over(point, promise, taken):
        points.append(tuple(point))
        return taken >= 3

    _, tried = fitted(is_over=is_over)
    assert tried >= 3
    assert len(set(points)) == len(points) > 1


def test_steps_that_never_lower_the_cost_and_equations_without_solution_leave_the_point():
    one = np.ones((1, 1))
    assert minimize(0.0, lambda _: solver(one, np.ones(1)), lambda at, _: (at, -1.0), lambda _: 0.0) == 0.0
    assert minimize(0.0, lambda _: solver(-one, np.full(1, math.nan)), lambda at, _: (at, 1.0), lambda _: 0.0) == 0.0


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
