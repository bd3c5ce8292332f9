"""Making the kernels of sparse regression ready before they are needed: compiled once per machine, else loaded."""

import os

import numpy as np

from atoll_coordinator.model.cholesky import solve_damped
from atoll_coordinator.model.sparse.kernels.elimination import eliminate, sum_error_products
from atoll_coordinator.model.sparse.kernels.errors_in_variables import error_products, measure
from atoll_coordinator.model.sparse.kernels.least_squares import windowed_sums
from atoll_coordinator.model.sparse.kernels.robust import robust_fit


def warm_up() -> None:
    """Compile or load every kernel; interpreted kernels (``NUMBA_DISABLE_JIT``) need nothing."""
    if os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0"):
        return
    values = np.array([[1.0, 2.0, 4.0], [1.0, 1.0, 1.0]])
    windowed_sums(np.zeros(1, np.int64), np.ones((1, 3)), values, np.zeros((2, 1)))
    robust_fit(values, np.array([1.0, 3.0, 7.0]), np.ones(3), 2, np.zeros(2), np.ones(3))
    sum_error_products(
        np.ones((2, 1, 3)), np.ones(1), 0, np.zeros(3), np.zeros(3), sums := np.zeros((2, 2)), cross := np.zeros(2)
    )
    eliminate(
        values, np.array([1.0, 3.0, 7.0]), sums, cross, np.zeros(2, np.int64), np.zeros(3), np.zeros((2, 2)),
        np.zeros(3),
    )  # fmt: skip
    products, cross, first = np.zeros((3, 2, 2)), np.zeros((3, 2)), np.zeros(3, np.int64)
    error_products(first, np.ones((3, 1)), np.ones((3, 1)), np.ones((2, 1, 1)), np.ones(1), 0, products, cross)
    measure(
        np.arange(2), values, np.array([1.0, 3.0, 7.0]), products, cross, np.ones(3), 1.0, np.zeros(2), np.zeros(3),
        np.zeros((2, 2)), np.zeros(2),
    )  # fmt: skip
    solve_damped(np.eye(2), 0.0, np.zeros(2))
