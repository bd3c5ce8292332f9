"""Which trajectories are kept from the search: the last ones, or one named by its value in the trajectory column. Pure.

They take no part in any choice, neither of smoothing nor of equations, so that equations can be judged by them.
"""

from collections.abc import Sequence
from typing import Final

from atoll.data.table import Table
from atoll.errors import DataError, UsageError
from atoll_coordinator.data.reading.columns import Roles, check_known
from atoll_coordinator.data.trajectories.trajectories import plain_number

MANY: Final = 10
"""So many values are listed in a message."""
Runs = Sequence[tuple[int, int]]


def held_out_runs(
    holdout: int | str | None, table: Table, roles: Roles, rows: Sequence[int], runs: Runs
) -> tuple[bool, ...]:
    """Return for each trajectory whether it is held out.

    Args:
        holdout: how many of the last trajectories, or ``COLUMN=VALUE``.
        table: what was read.
        roles: the part of every column.
        rows: the rows kept of the table.
        runs: half-open ranges into `rows`, one for each trajectory.

    Raises:
        UsageError: the trajectories are not told apart by that column.
        DataError: there are too few trajectories, or none with that value.
    """
    if holdout is None:
        return (False,) * len(runs)
    if isinstance(holdout, int):
        chosen = [place >= len(runs) - holdout for place in range(len(runs))]
    else:
        chosen = _with_value(holdout, table, roles, [rows[first] for first, _ in runs])
    if all(chosen):
        count = "is only one trajectory" if len(runs) == 1 else f"are {len(runs)} trajectories"
        raise DataError(f"--holdout {holdout} would keep everything from the search: there {count}; leave at least one")
    return tuple(chosen)


def _with_value(holdout: str, table: Table, roles: Roles, rows: Sequence[int]) -> list[bool]:
    """Return for each trajectory, beginning in `rows`, whether it has the value that ``COLUMN=VALUE`` names."""
    name, _, text = holdout.rpartition("=")
    if name != roles.trajectory:
        check_known(name, table)
        by = "blank rows or files" if roles.trajectory is None else f"column '{roles.trajectory}'"
        advice = f"add --trajectory {name}, or give the number of trajectories to hold out"
        raise UsageError(f"--holdout names column '{name}', but trajectories are told apart by {by}; {advice}")
    values = [float(table.column(name)[row]) for row in rows]
    chosen = [value == _number(holdout, text) for value in values]
    if not any(chosen):
        known = ", ".join(plain_number(value) for value in values[:MANY])
        more = ", …" if len(values) > MANY else ""
        raise DataError(f"--holdout {holdout}: no trajectory has this value; there are {known}{more}")
    return chosen


def _number(holdout: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise UsageError(f"--holdout must be a whole number or COLUMN=NUMBER, but {holdout!r} was given") from None
