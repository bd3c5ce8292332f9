"""States of a known law along noisy rows: initial states of overlapping windows are fitted, constants are kept.

A chaotic trajectory is not described by one initial state, so the rows are covered by windows. A state is taken from
the window in which it is farthest from the ends, because there it is determined by rows on both sides. Letters: N rows,
D states.
"""

from typing import Final

import numpy as np

from atoll.api.model import Model
from atoll.experiments.fits import equations_of, measured_of
from atoll_coordinator.model.shooting.measurements import measurements_of
from atoll_coordinator.model.shooting.multiple_shooting import MultipleShooting, fit_in_stages
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray
from atoll_core.errors import AtollError
from benchmarks.contests.protocol import STATES, STEP
from benchmarks.harness.jobs import table_of_columns

WINDOW: Final = 60
_TOLERANCE: Final = 1e-8


def states_along(model: Model, rows: FloatArray, window: int = WINDOW) -> FloatArray:
    """Return the states (N, D) under the law of a model along measured `rows` (N, D)."""
    length = min(window, len(rows))
    firsts = sorted({*range(0, len(rows) - length, length // 2), len(rows) - length})
    fitted = _fit_windows(model, np.concatenate([rows[first : first + length] for first in firsts]), length)
    states, depth = np.array(rows), np.full(len(rows), -1)
    own = np.minimum(np.arange(length), np.arange(length)[::-1])
    for first, part in zip(firsts, fitted, strict=True):
        own_rows = slice(first, first + length)
        is_deeper = own > depth[own_rows]
        states[own_rows][is_deeper] = part[is_deeper]
        depth[own_rows] = np.maximum(depth[own_rows], own)
    return states


def _fit_windows(model: Model, rows: FloatArray, length: int) -> FloatArray:
    """Return the states (windows, length, D) of windows whose rows are stacked in `rows`."""
    times = np.asarray(STEP * np.arange(len(rows)), dtype=np.float64)
    columns = {"t": times, **dict(zip(STATES, rows.T, strict=True))}
    table = table_of_columns(columns, "windows", range(0, len(rows), length))
    data = measured_of(model.result, table)
    measurements = measurements_of(data.recording, data.modelled, piece=length)
    system = equations_of(model.result).system(measurements, 1).with_fixed_constants()
    order = [data.recording.states.index(name) for name in STATES]
    fitted = []
    for window in range(len(rows) // length):
        estimator = MultipleShooting(measurements.part([window]), _TOLERANCE)
        fit = fit_in_stages(estimator, system, (*SETTINGS.shooting.lengths[:2], None), SETTINGS.effort.steps)
        if fit is None:
            raise AtollError("the law cannot be simulated along the rows; give shorter windows")
        fitted.append(fit.simulated[order].T)
    return np.array(fitted)
