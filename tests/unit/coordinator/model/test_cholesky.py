"""Cholesky's factors of small matrices."""

import numpy as np
import pytest

from atoll_coordinator.model.cholesky import factorize, substitute


@pytest.mark.slow
def test_the_solution_solves_the_system() -> None:
    matrix, side = np.array([[2.0, 1e-4], [1e-4, 1e-6]]), np.array([1.0, -1.0])
    factor, scale, solution = matrix.copy(), np.zeros(2), side.copy()
    assert factorize(factor, 2, scale, 0.0)
    substitute(factor, 2, scale, solution)
    assert matrix @ solution == pytest.approx(side)


def test_damping_raises_the_unit_diagonal() -> None:
    matrix, scale, solution = np.array([[4.0, 0.0], [0.0, 9.0]]), np.zeros(2), np.array([4.0, 9.0])
    assert factorize(matrix, 2, scale, 1.0)
    substitute(matrix, 2, scale, solution)
    assert solution == pytest.approx([0.5, 0.5])


def test_systems_that_are_not_positive_are_refused() -> None:
    assert not factorize(np.array([[1.0, 2.0], [2.0, 1.0]]), 2, np.zeros(2), 0.0)
