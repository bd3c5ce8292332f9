"""Which column is the time, by its name, and what is said where none is. Pure."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from atoll_core.config import DataConfig
from atoll_core.data.table import Table
from atoll_core.errors import DataError

TIME_NAMES: Final = ("t", "time", "Time", "TIME")
"""What the time is called unless options name it, in this order."""


def find_time_column(names: Sequence[str], config: DataConfig) -> str | None:
    """Return the column that options name as the time, else one that is called so and has no role but an input's."""
    other = (config.target, config.trajectory, config.weights, *(config.states or ()), *(config.derivatives or ()))
    return config.time or next((name for name in TIME_NAMES if name in names and name not in other), None)


def check_no_text_time(table: Table) -> None:
    """Raise DataError when a column is called as the time is, but holds text; for a table without a time."""
    name = next((name for name in TIME_NAMES if name in table.skipped), None)
    if name is not None:
        reason = f"column '{name}' of {table.files[0]} holds text that is neither a number nor a date"
        raise DataError(f"{reason}; write numbers, or dates as year-month-day")


def missing_time(table: Table, states: Sequence[str], config: DataConfig) -> DataError:
    """Return the error of a table without a time; it names a state that may be the time."""
    looked = config.time or " or ".join(TIME_NAMES[:2])
    ascending = next((name for name in states if _ascends(table, name)), None)
    perhaps = "" if ascending is None else f" (perhaps {ascending})"
    reason = f"no time column was found (looked for {looked})"
    return DataError(f"{reason}; name it with --time{perhaps}, or use --target COLUMN")


def _ascends(table: Table, name: str) -> bool:
    """Tell whether the numbers of a column only grow within each trajectory, as times do."""
    steps = np.delete(np.diff(table.column(name)), [start - 1 for start in table.starts if start])
    return bool(len(steps)) and bool((steps > 0.0).all())
