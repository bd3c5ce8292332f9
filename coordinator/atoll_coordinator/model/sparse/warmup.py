"""Warm-up of the kernels of sparse regression: they are compiled once per machine, and later loaded from the cache."""

import os

import numpy as np

from atoll_coordinator.model.cholesky import solve_damped
from atoll_coordinator.model.sparse.kernels.elimination import (
    eliminate,
    explained_shares,
    find_shortest_with_each,
    scalar_products,
    spread_window_weights,
    sum_error_products,
    sum_products,
    windowed_sums,
)
from atoll_core.data.dataset import FloatArray


def warm_up() -> list[FloatArray]:
    """Compile or load every kernel, and return what they computed; nothing with ``NUMBA_DISABLE_JIT``."""
    if os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0"):
        return []
    values, side = np.array([[1.0, 2.0, 4.0], [1.0, 1.0, 1.0]]), np.array([1.0, 3.0, 7.0])
    first, ones = np.zeros(1, np.int64), np.ones((1, 3))
    windowed_sums(first, ones, values, windows := np.zeros((2, 1)))
    scalar_products(side, values, dots := np.zeros(2))
    sum_products(np.ascontiguousarray(values.T), side, products := np.zeros((2, 2)))
    spread_window_weights(first, ones, ones, np.ones(1), weights := np.zeros(3), halves := np.zeros(3))
    sum_error_products(
        np.ones((2, 1, 3)), np.ones(1), 0, np.zeros(3), np.zeros(3), sums := np.zeros((2, 2)), cross := np.zeros(2)
    )
    eliminate(
        values, side, sums, cross, 2, np.zeros(2, np.int64), squares := np.zeros(3), found := np.zeros((2, 2)),
        np.zeros(3),
    )  # fmt: skip
    find_shortest_with_each(values, side, sums, cross, first, first + 1, np.ones(2), 3.0, 1.0, nats := np.zeros(1))
    explained_shares(
        values, values, np.arange(3), np.ones((3, 1)), ones, 0.1 * values, first + 2, 0.0, shares := np.zeros((1, 2, 2))
    )
    solve_damped(np.array([[2.0, 1.0], [1.0, 3.0]]), 0.0, solution := np.array([1.0, 5.0]))
    return [windows, dots, products, weights, halves, sums, cross, squares, found, nats, shares, solution]
