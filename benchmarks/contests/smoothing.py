"""States of a known law along noisy rows: initial states of overlapping windows are fitted, constants are kept.

A chaotic trajectory is not described by one initial state, so the rows are covered by windows. A state is taken from
the window in which it is farthest from the ends, because there it is determined by rows on both sides. A fit of a
window may end at a wrong local minimum: then its residuals exceed the noise. Rows that no window describes are covered
by windows of half the length, and at last keep their measured values. Letters: N rows, D states, W windows.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.special import chdtri

from atoll.api.model import Model
from atoll.experiments.fits import equations_of, measured_of
from atoll_coordinator.model.shooting.measurements import measurements_of
from atoll_coordinator.model.shooting.multiple_shooting import MultipleShooting, fit_in_stages
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from benchmarks.contests.protocol import STATES, STEP
from benchmarks.harness.jobs import table_of_columns

WINDOW: Final = 120
_SHORTEST: Final = 15
_TOLERANCE: Final = 1e-8
_LEAST: Final = 1e-300
_LEVEL: Final = 0.001
"""Probability with which the residuals of a window under the right law count as too large."""


def states_along(model: Model, rows: FloatArray, window: int = WINDOW) -> FloatArray:
    """Return the states (N, D) under the law of a model along measured `rows` (N, D)."""
    states, depth = np.array(rows), np.full(len(rows), -1)
    length, noise = min(window, len(rows)), None
    while length >= min(_SHORTEST, len(rows)) and (depth < 0).any():
        firsts = [first for first in _firsts(len(rows), length) if (depth[first : first + length] < 0).any()]
        fitted = _fit_windows(model, rows, firsts, length)
        residuals = fitted - np.stack([rows[first : first + length] for first in firsts])
        means = np.mean(residuals**2, axis=1)
        noise = np.maximum(np.nanmedian(means, axis=0), _LEAST) if noise is None else noise
        numbers = (length - 1) * len(STATES)
        is_right = np.sum(means / noise, axis=1) * length <= chdtri(numbers, _LEVEL)
        _take_deepest(states, depth, [first for first, right in zip(firsts, is_right, strict=True) if right],
                      fitted[is_right])  # fmt: skip
        length //= 2
    return states


def _firsts(rows: int, length: int) -> list[int]:
    """Return the first rows of windows that overlap by half of their length."""
    return sorted({*range(0, rows - length, max(length // 2, 1)), rows - length})


def _take_deepest(states: FloatArray, depth: npt.NDArray[np.int64], firsts: Sequence[int], fitted: FloatArray) -> None:
    """Copy fitted windows to the rows that lie farther from their ends than from the ends of earlier windows."""
    for first, window in zip(firsts, fitted, strict=True):
        places = np.arange(len(window))
        own = np.minimum(places, places[::-1])
        taken = places[own > depth[first : first + len(window)]]
        states[first + taken], depth[first + taken] = window[taken], own[taken]


def _fit_windows(model: Model, rows: FloatArray, firsts: Sequence[int], length: int) -> FloatArray:
    """Return the states (W, length, D) of windows; NaN where the law cannot be simulated."""
    stacked = np.concatenate([rows[first : first + length] for first in firsts])
    times = np.asarray(STEP * np.arange(len(stacked)), dtype=np.float64)
    columns = {"t": times, **dict(zip(STATES, stacked.T, strict=True))}
    table = table_of_columns(columns, "windows", range(0, len(stacked), length))
    data = measured_of(model.result, table)
    measurements = measurements_of(data.recording, data.modelled, piece=length)
    system = equations_of(model.result).system(measurements, 1).with_fixed_constants()
    order = [data.recording.states.index(name) for name in STATES]
    fitted = np.full((len(firsts), length, len(STATES)), np.nan)
    for window in range(len(firsts)):
        estimator = MultipleShooting(measurements.part([window]), _TOLERANCE)
        fit = fit_in_stages(estimator, system, (*SETTINGS.shooting.lengths[:2], None), SETTINGS.effort.steps)
        if fit is not None:
            fitted[window] = fit.simulated[order].T
    return fitted
