"""Least squares and backward elimination against numpy."""

import numpy as np
import pytest

from atoll_coordinator.model.sparse.elimination import eliminated
from atoll_coordinator.model.sparse.kernels.least_squares import windowed_sums


def run(columns, side, errors=None):
    path = eliminated(columns, side, errors)
    return path.order, path.squares, path.coefficients


def by_numpy(columns, side):
    """Yield what is kept, its coefficients and the sum of squares left, the least needed column gone at each step."""
    kept = list(range(len(columns)))
    while kept:
        matrix = columns[kept].T
        solution, *_ = np.linalg.lstsq(matrix, side, rcond=None)
        yield list(kept), solution, float(((side - matrix @ solution) ** 2).sum())
        variances = np.diag(np.linalg.inv(matrix.T @ matrix))
        kept.pop(int(np.argmin(solution**2 / variances)))


def test_steps_are_those_of_least_squares():
    generator = np.random.default_rng(1)
    columns = generator.normal(size=(5, 40)) * np.array([1.0, 1e3, 1e-3, 1.0, 10.0])[:, None]
    side = 2.0 * columns[0] - 0.3 * columns[3] + 0.1 * generator.normal(size=40)
    order, squares, solved_side = run(columns, side)
    for step, (kept, solution, left) in enumerate(by_numpy(columns, side)):
        assert sorted(order[step:]) == kept
        assert solved_side[step, kept] == pytest.approx(solution, rel=1e-9)
        assert squares[step] == pytest.approx(left, rel=1e-9)
    assert squares[-1] == pytest.approx(float(side @ side))
    assert set(order[-2:]) == {0, 3}


def test_a_column_that_is_a_sum_of_others_goes_first():
    generator = np.random.default_rng(2)
    columns = generator.normal(size=(3, 30))
    columns = np.vstack([columns, columns[0] + columns[1]])
    side = columns[0] + columns[2]
    order, squares, _ = run(columns, side)
    assert order[0] == 3
    assert squares[:3] == pytest.approx(0.0, abs=1e-20)


def test_sums_begin_at_the_first_row_of_a_window():
    sums = np.zeros((2, 2))
    values = np.array([[1.0, 2.0, 3.0, 4.0], [0.0, 0.0, 1.0, 0.0]])
    windowed_sums(np.array([0, 2]), np.array([[1.0, 10.0], [1.0, 1.0]]), values, sums)
    assert sums.tolist() == [[21.0, 7.0], [0.0, 1.0]]


def test_coefficients_are_those_of_the_true_columns_where_errors_of_columns_are_as_large():
    """Means of 40 draws; least squares gives 0.5 and 0.5."""
    generator = np.random.default_rng(3)
    true = np.vstack([generator.normal(size=(2, 4000)), np.zeros((1, 4000))])
    true[1] += 2.0 * true[0]
    found = []
    for _ in range(40):
        columns = true + generator.normal(size=true.shape)
        side = 3.0 * true[0] - true[1] + 0.1 * generator.normal(size=4000)
        order, _, solved = run(columns, side, (4000.0 * np.eye(3), np.zeros(3)))
        assert order[0] == 2
        found.append(solved[1])
    assert np.mean(found, axis=0) == pytest.approx([3.0, -1.0, 0.0], abs=0.15)
