"""Paths of processes whose noise is known, and their steps."""

from collections.abc import Sequence

import numpy as np

from atoll_coordinator.data.increments import Steps
from atoll_core.data.dataset import FloatArray


def steps_of(states: FloatArray, step: float) -> Steps:
    """Return the steps of one trajectory (S, R) with even steps."""
    return uneven_steps_of(states, step * np.arange(states.shape[1]))


def uneven_steps_of(states: FloatArray, times: FloatArray, breaks: Sequence[int] = ()) -> Steps:
    """Return the steps of states (S, R) at `times` (R,); no step leads to the rows `breaks`, with which one begins."""
    kept = np.delete(np.arange(len(times) - 1), [row - 1 for row in breaks])
    follows = (np.arange(len(times) - 1) > 0)[kept]
    follows[np.flatnonzero(np.isin(kept, breaks))] = False
    moved = np.diff(states, axis=1)
    return Steps(
        np.ascontiguousarray(states[:, kept]), np.diff(times)[kept], np.ascontiguousarray(moved[:, kept]), follows
    )


def circling(rows: int, seed: int, correlation: float) -> FloatArray:
    """Return two states that turn about each other, with noise of variance 0.04 per time, sampled each 0.05."""
    random, step = np.random.default_rng(seed), 0.05
    normal = random.standard_normal((2, rows))
    normal[1] = correlation * normal[0] + np.sqrt(1.0 - correlation**2) * normal[1]
    states = [np.array([1.0, 0.0])]
    for row in range(rows - 1):
        x, y = states[-1]
        states.append(states[-1] + step * np.array([y - 0.1 * x, -x - 0.1 * y]) + 0.2 * np.sqrt(step) * normal[:, row])
    return np.array(states).T
