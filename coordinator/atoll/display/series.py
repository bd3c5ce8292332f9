"""What pictures of a result show, as numbers and labels: the same by matplotlib and on a page."""

from collections.abc import Sequence

from atoll_coordinator.result.base import Curve
from atoll_coordinator.result.equations import Member
from atoll_coordinator.result.result import Result


def label(result: Result, column: str) -> str:
    """Return the name of a column with its unit."""
    unit = result.units.get(column)
    return f"{column} [{unit}]" if unit else column


def residuals(measured: Curve, simulated: Curve) -> list[float | None]:
    """Return measured less simulated values, None where one of both is not known."""
    pairs = zip(measured, simulated, strict=True)
    return [left - right if left is not None and right is not None else None for left, right in pairs]


def front(members: Sequence[Member], *, is_selected: bool = False) -> tuple[list[int], list[float | None]]:
    """Return complexity and error of those members of a front that have one; of the selected ones where asked."""
    shown = [member for member in members if member.normalized_error and (member.selected or not is_selected)]
    return [member.complexity or 0 for member in shown], [member.normalized_error for member in shown]
