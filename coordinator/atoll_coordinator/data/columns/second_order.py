"""Positions without velocities: the same positions are passed in different ways, by their velocities. Pure."""

from collections.abc import Iterator

from atoll_coordinator.data.columns.finding import Columns, Finding
from atoll_coordinator.data.columns.local_slopes import LocalSlopes, local_slopes
from atoll_coordinator.data.columns.neighbours import Disagreement, disagreement, neighbours
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray

LIMITS = SETTINGS.columns


def check_second_order(columns: Columns) -> Iterator[Finding]:
    """Yield a finding where velocities are no function of the states, but accelerations are one of both."""
    roles = columns.roles
    is_first = columns.is_in_time and roles.order == 1 and not columns.config.data.stochastic
    if not is_first or len(roles.states) > LIMITS.most_positions:
        return
    slopes = local_slopes(columns.times, columns.values, roles.states)
    if slopes is None or not _is_second_order(slopes, columns):
        return
    named = " and ".join(f"'{name}'" for name in roles.states)
    yield Finding(
        f"{named} passes the same values with different velocities, and its acceleration follows from both"
        if len(roles.states) == 1
        else f"{named} pass the same values with different velocities, and their accelerations follow from both",
        "to seek equations of second order, add --order 2",
    )


def _is_second_order(slopes: LocalSlopes, columns: Columns) -> bool:
    first, second = disagreements(slopes, columns)
    if any(one is None for one in (*first, *second)):
        return False
    is_closed = all(one is not None and one.share < LIMITS.closed_share for one in second)
    return is_closed and any(one is not None and one.is_open for one in first)


def disagreements(slopes: LocalSlopes, columns: Columns) -> tuple[list[Disagreement | None], list[Disagreement | None]]:
    """Return how much neighbours differ in the slope of each state, and such of the same slopes in its curvature."""
    states = columns.roles.states
    positions = [slopes.means[name] for name in (*states, *columns.roles.inputs)]
    velocities = [slopes.slopes[name] for name in states]
    curvatures = [slopes.curvatures[name] for name in states]

    def differ(coordinates: list[FloatArray], responses: list[FloatArray]) -> list[Disagreement | None]:
        pairs = neighbours(coordinates, slopes.part, slopes.apart)
        return [None if pairs is None else disagreement(pairs, response) for response in responses]

    return differ(positions, velocities), differ([*positions, *velocities], curvatures)
