"""A reaction whose flux leaves one state and enters another, measured: what the tests of windows begin with."""

import functools

import numpy as np
from scipy.integrate import solve_ivp

from atoll_coordinator.data.prepare import prepare
from atoll_core.config import PRESETS
from atoll_core.data.table import Table

NAMES = ("a", "b")


def field(_, state):
    a, b = state
    flux = 3.0 * a / (0.4 + a)
    return [1.0 - flux, flux - b]


@functools.cache
def prepared(noise=0.01, runs=16, rows=31, step=0.1):
    """Return what preparing runs from random beginnings gives; noise is a share of each state's deviation."""
    generator = np.random.default_rng(2)
    times = step * np.arange(rows)
    options = {"t_eval": times, "rtol": 1e-9, "atol": 1e-9}
    parts = [solve_ivp(field, (0.0, times[-1]), generator.uniform(0.0, 3.0, 2), **options).y for _ in range(runs)]
    values = np.concatenate(parts, axis=1)
    values = values + noise * values.std(axis=1, keepdims=True) * generator.normal(size=values.shape)
    columns = np.ascontiguousarray(np.vstack([np.tile(times, runs), values]))
    zero = np.zeros(columns.shape[1], np.int64)
    starts = tuple(rows * index for index in range(runs))
    table = Table(("t", *NAMES), ("",) * 3, columns, starts, ("made",), zero, zero + 1)
    return prepare(table, PRESETS["default"])
