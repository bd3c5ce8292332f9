"""Which trajectories are kept from the search: the last ones, or one named by its value in the trajectory column. Pure.

They take no part in any choice, neither of smoothing nor of equations, so that equations can be judged by them.
"""

from collections.abc import Sequence
from typing import Final

from atoll_coordinator.data.trajectories.trajectories import format_number
from atoll_core.errors import DataError, UsageError

MANY: Final = 10
"""So many values are listed in a message."""


def select_held_out(holdout: int | str | None, trajectory: str | None, values: Sequence[float]) -> tuple[bool, ...]:
    """Return for each trajectory whether it is held out.

    Args:
        holdout: how many of the last trajectories, or ``COLUMN=VALUE``.
        trajectory: the trajectory column, if there is one.
        values: of that column, one for each trajectory.

    Raises:
        UsageError: the trajectories are not told apart by that column.
        DataError: there are too few trajectories, or none with that value.
    """
    count = len(values)
    if isinstance(holdout, str):
        held_out = _with_value(holdout, trajectory, values)
    else:
        held_out = [place >= count - (holdout or 0) for place in range(count)]
    if all(held_out):
        there = "is only one trajectory" if count == 1 else f"are {count} trajectories"
        raise DataError(f"--holdout {holdout} would keep everything from the search: there {there}; leave at least one")
    return tuple(held_out)


def _with_value(holdout: str, trajectory: str | None, values: Sequence[float]) -> list[bool]:
    """Return for each trajectory whether it has the value that ``COLUMN=VALUE`` names."""
    name, _, text = holdout.rpartition("=")
    if name != trajectory:
        by = "blank rows or files" if trajectory is None else f"column '{trajectory}'"
        advice = f"add --trajectory {name}, or give the number of trajectories to hold out"
        raise UsageError(f"--holdout names column '{name}', but trajectories are told apart by {by}; {advice}")
    try:
        held_out = [value == float(text) for value in values]
    except ValueError:
        raise UsageError(f"--holdout must be a whole number or COLUMN=NUMBER, but {holdout!r} was given") from None
    if not any(held_out):
        known = ", ".join(format_number(value) for value in values[:MANY])
        more = ", …" if len(values) > MANY else ""
        raise DataError(f"--holdout {holdout}: no trajectory has this value; there are {known}{more}")
    return held_out
