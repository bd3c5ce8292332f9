"""Small tables for the tests of this folder."""

import numpy as np

from atoll_coordinator.data.roles.roles import assign_roles
from atoll_coordinator.data.trajectories.measurements import take_measurements
from atoll_core.data.table import Table


def table_of(columns, starts=(0,), skipped=()):
    """Return a table of the given columns, as read from line 2 of a.csv on."""
    values = np.array([np.asarray(column, dtype=np.float64) for column in columns.values()])
    rows = np.arange(values.shape[1], dtype=np.int64)
    return Table(tuple(columns), ("",) * len(columns), values, starts, ("a.csv",), 0 * rows, rows + 2, skipped)


def oscillator(rows=60, step=0.1, start=0.0):
    """Return time and the two states of a harmonic oscillator of unit frequency."""
    times = start + step * np.arange(rows)
    phases = step * np.arange(rows)
    return {"t": times, "x": np.cos(phases), "y": -np.sin(phases)}


def measurements_of(table, config):
    """Return the measurements that a table holds under these options."""
    return take_measurements(table, *assign_roles(table, config))
