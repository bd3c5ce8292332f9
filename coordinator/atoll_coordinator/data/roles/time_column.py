"""Which column is the time, by the names of the columns and the options. Pure."""

from collections.abc import Sequence
from typing import Final

from atoll_core.config import DataConfig

TIME_NAMES: Final = ("t", "time", "Time", "TIME")
"""What the time is called unless options name it, in this order."""


def find_time_column(names: Sequence[str], config: DataConfig) -> str | None:
    """Return the column that options name as the time, else one that is called so and has no role but an input's."""
    other = (config.target, config.trajectory, config.weights, *(config.states or ()), *(config.derivatives or ()))
    return config.time or next((name for name in TIME_NAMES if name in names and name not in other), None)
