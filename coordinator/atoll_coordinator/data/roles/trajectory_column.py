"""Which column tells the trajectories apart, by the names of the columns and the options. Pure."""

from collections.abc import Iterable
from typing import Final

from atoll_coordinator.data.roles.column_options import named_columns
from atoll_core.config import DataConfig

TRAJECTORY_NAME: Final = "trajectory"
"""What the trajectory column is called unless options name it."""


def find_trajectory_column(names: Iterable[str], config: DataConfig) -> str | None:
    """Return the trajectory column: the one named, else one called ``trajectory`` that has no other part."""
    if config.trajectory is not None:
        return config.trajectory
    return TRAJECTORY_NAME if TRAJECTORY_NAME in names and TRAJECTORY_NAME not in named_columns(config) else None
