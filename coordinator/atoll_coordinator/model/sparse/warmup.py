"""Warm-up of the kernels of sparse regression: they are compiled once per machine, and later loaded from the cache."""

import os

import numpy as np

from atoll_coordinator.model.cholesky import solve_damped
from atoll_coordinator.model.sparse.kernels.elimination import eliminate, sum_error_products, windowed_sums
from atoll_core.data.dataset import FloatArray


def warm_up() -> list[FloatArray]:
    """Compile or load every kernel, and return what they computed; nothing with ``NUMBA_DISABLE_JIT``."""
    if os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0"):
        return []
    values = np.array([[1.0, 2.0, 4.0], [1.0, 1.0, 1.0]])
    windowed_sums(np.zeros(1, np.int64), np.ones((1, 3)), values, windows := np.zeros((2, 1)))
    sum_error_products(
        np.ones((2, 1, 3)), np.ones(1), 0, np.zeros(3), np.zeros(3), sums := np.zeros((2, 2)), cross := np.zeros(2)
    )
    eliminate(
        values, np.array([1.0, 3.0, 7.0]), sums, cross, 2, np.zeros(2, np.int64), squares := np.zeros(3),
        found := np.zeros((2, 2)), np.zeros(3),
    )  # fmt: skip
    solve_damped(np.array([[2.0, 1.0], [1.0, 3.0]]), 0.0, solution := np.array([1.0, 5.0]))
    return [windows, sums, cross, squares, found, solution]
