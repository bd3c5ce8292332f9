"""Times of a table without a time column, whose rows are a step apart. Pure."""

from dataclasses import replace

import numpy as np

from atoll_coordinator.data.roles.column_options import strip_units
from atoll_coordinator.data.roles.time_column import TIME_NAMES, find_time_column
from atoll_coordinator.data.roles.trajectory_column import find_trajectory_column
from atoll_core.config import DataConfig
from atoll_core.data.table import Table
from atoll_core.errors import Field, UsageError


def with_times(table: Table, config: DataConfig) -> Table:
    """Return the table with times, from 0 along each trajectory, where options give the `step` between rows.

    Raises UsageError where the table has a time.
    """
    config = strip_units(config, table.names)
    if config.step is None:
        return table
    known = find_time_column(table.names, config)
    if known in table.names:
        message = "%s %s gives the time between rows, but %s has a time column, '%s'; leave it out"
        raise UsageError(message, Field("step"), f"{config.step:g}", table.files[0], known)
    name = known or next(name for name in TIME_NAMES if name not in table.names)
    trajectory = find_trajectory_column(table.names, config)
    begins = np.zeros(table.rows, dtype=bool)
    begins[[start for start in table.starts if start < table.rows]] = True
    if trajectory in table.names:
        begins[1:] |= np.diff(table.column(trajectory)) != 0.0
    rows = np.arange(table.rows)
    places = rows - np.maximum.accumulate(np.where(begins, rows, 0))
    return replace(
        table,
        names=(name, *table.names),
        units=("", *table.units),
        columns=np.ascontiguousarray(np.vstack([config.step * places, table.columns])),
        read_as="; ".join(filter(None, (table.read_as, f"times '{name}' in steps of {config.step:g}"))),
    )
