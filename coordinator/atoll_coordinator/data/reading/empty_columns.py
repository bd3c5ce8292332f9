"""Columns without a single value, as of instruments that were not connected: they are left out. Pure."""

from dataclasses import replace

import numpy as np

from atoll_coordinator.data.roles.column_options import named_columns, strip_units
from atoll_coordinator.data.roles.roles import assigned
from atoll_coordinator.data.roles.time_column import TIME_NAMES
from atoll_coordinator.data.roles.trajectory_column import find_trajectory_column
from atoll_core.config import DataConfig
from atoll_core.data.table import Table


def without_empty(table: Table, config: DataConfig) -> Table:
    """Return the table without columns that hold nothing in any row of any file.

    Those stay that options name or that are called as the time or the trajectories are, and all where nothing else
    would be left to have an equation: they are missed then.
    """
    config = strip_units(config, table.names)
    trajectory = find_trajectory_column(table.names, config)
    needed = {*named_columns(config), *TIME_NAMES, trajectory}
    empty = [name for name in table.names if name not in needed and np.isnan(table.column(name)).all()]
    left = [name for name in table.names if name not in empty]
    if not empty or not assigned(left, config, trajectory).equations:
        return table
    kept = [table.names.index(name) for name in left]
    phrase = f"empty columns left out: {', '.join(empty)}"
    return replace(
        table,
        names=tuple(left),
        units=tuple(table.units[place] for place in kept),
        columns=np.ascontiguousarray(table.columns[kept]),
        read_as="; ".join(filter(None, (table.read_as, phrase))),
        left_out=(*table.left_out, phrase),
    )
