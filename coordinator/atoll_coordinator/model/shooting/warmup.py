"""Warm-up of the kernels of trajectory fits: they are compiled once per machine, and later loaded from the cache."""

import os
from typing import Final

import numpy as np

from atoll_coordinator.model.shooting.measurements import TrajectoryMeasurements
from atoll_coordinator.model.shooting.multiple_shooting import MultipleShooting, fit_in_stages
from atoll_coordinator.model.shooting.system import OdeSystem, system_of
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.operators import ADD, CONSTANT, MULTIPLY, VARIABLE
from atoll_core.expression.program import Program

TOLERANCES: Final = (1e-8, 1e-3)
"""One tolerance for each table of coefficients of the explicit method."""

_ROWS: Final = 6


def warm_up() -> list[FloatArray]:
    """Compile or load every kernel of a trajectory fit, by a very small fit with each table; return the simulations.

    Nothing is done for interpreted kernels (``NUMBA_DISABLE_JIT``). The first call on a machine takes about ten
    seconds.
    """
    if os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0"):
        return []
    measurements, system = _small_measurements(), _small_system()
    fits = [fit_in_stages(MultipleShooting(measurements, tolerance), system, (3, None), 2) for tolerance in TOLERANCES]
    return [fit.simulated for fit in fits if fit is not None]


def _small_system() -> OdeSystem:
    """Return dx/dt = -0.4 x + u."""
    codes = [VARIABLE, CONSTANT, MULTIPLY, VARIABLE, ADD]
    columns = np.array([[0, 0, 1, 1, 2], [0, 0, 0, 0, 3]], np.int16)
    program = Program(np.array(codes, np.int8), columns[0], columns[1], np.array([0.0, -0.4, 0.0, 0.0, 0.0]))
    return system_of([program], ("x", "u"), ("x", "u"))


def _small_measurements() -> TrajectoryMeasurements:
    """Return a few rows of one state and one input."""
    times = 0.1 * np.arange(float(_ROWS))
    states, inputs = (1.0 - 0.3 * times)[None], (0.1 + 0.05 * times)[None]
    return TrajectoryMeasurements(
        bounds=np.array([[0, _ROWS]], dtype=np.int64),
        owners=np.zeros(1, dtype=np.int64),
        times=times,
        measured=states,
        weights=np.ones_like(states),
        smoothed=states,
        observed=np.zeros(1, dtype=np.int64),
        inputs=inputs,
        input_slopes=np.full_like(inputs, 0.05),
        scales=states.std(axis=1),
        noise=np.array([0.01]),
        offset=np.zeros(0, dtype=np.int64),
        variables=("x", "u"),
        names=("1",),
    )
