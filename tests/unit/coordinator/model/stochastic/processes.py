"""Processes whose steps are known exactly, sampled from their transition densities."""

import numpy as np

from atoll_coordinator.data.increments import Steps
from atoll_coordinator.model.stochastic.likelihood import ProcessModel
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.text.parsing import from_infix


def ornstein_uhlenbeck(rows: int, step: float, seed: int, noise: float = 0.0) -> FloatArray:
    """Return dx = -x dt + 0.5 dW at so many rows, with errors of measurement."""
    random = np.random.default_rng(seed)
    decay, spread = np.exp(-step), 0.5 * np.sqrt((1.0 - np.exp(-2.0 * step)) / 2.0)
    states = [0.0]
    for shock in random.standard_normal(rows - 1):
        states.append(decay * states[-1] + spread * shock)
    return np.array(states) + noise * random.standard_normal(rows)


def steps_of(states: FloatArray, step: float) -> Steps:
    """Return the steps of one trajectory of states (S, R)."""
    count = states.shape[1] - 1
    increments = np.ascontiguousarray(np.diff(states, axis=1))
    return Steps(np.ascontiguousarray(states[:, :-1]), np.full(count, step), increments, np.arange(count) > 0)


def model_of(drift: str, diffusion: str, noise: float = 0.0) -> ProcessModel:
    """Return the model of one state x."""
    return ProcessModel((from_infix(drift, ["x"]),), (from_infix(diffusion, ["x"]),), ((0, 0),), (noise,))
