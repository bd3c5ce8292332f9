"""Warm-up of the kernels of sparse regression: they are compiled once per machine, and later loaded from the cache."""

import os

import numpy as np

from atoll_coordinator.model.cholesky import solve_damped
from atoll_coordinator.model.sparse.kernels.elimination import (
    eliminate,
    explained_shares,
    find_shortest_with_each,
    spread_window_weights,
    sum_error_products,
    windowed_sums,
)


def warm_up() -> None:
    """Compile or load every kernel. Nothing is done for interpreted kernels (``NUMBA_DISABLE_JIT``)."""
    if os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0"):
        return
    values = np.array([[1.0, 2.0, 4.0], [1.0, 1.0, 1.0]])
    windowed_sums(np.zeros(1, np.int64), np.ones((1, 3)), values, np.zeros((2, 1)))
    spread_window_weights(np.zeros(1, np.int64), np.ones((1, 3)), np.ones((1, 3)), np.ones(1), np.zeros(3), np.zeros(3))
    sum_error_products(
        np.ones((2, 1, 3)), np.ones(1), 0, np.zeros(3), np.zeros(3), sums := np.zeros((2, 2)), cross := np.zeros(2)
    )
    eliminate(
        values, np.array([1.0, 3.0, 7.0]), sums, cross, 2, np.zeros(2, np.int64), np.zeros(3), np.zeros((2, 2)),
        np.zeros(3),
    )  # fmt: skip
    columns, side, first = (
        np.array([[1.0, 2.0, 4.0], [1.0, 1.0, 1.0]]),
        np.array([1.0, 3.0, 7.0]),
        np.zeros(1, np.int64),
    )
    find_shortest_with_each(columns, side, sums, cross, first, first + 1, np.ones(2), 3.0, 1.0, np.zeros(1))
    explained_shares(
        columns, columns, np.arange(3), np.ones((3, 1)), np.ones((1, 3)), columns, first + 2, 0.0, np.zeros((1, 2, 2))
    )
    solve_damped(np.eye(2), 0.0, np.zeros(2))
