"""Checks of the motion of states: are equations of second order needed, or are the rows steps of a map? Pure.

If coordinates determine a response, rows with nearly the same coordinates have nearly the same response at all times.
So rows are compared with their nearest neighbours in other passes through the same region (false nearest neighbours,
Kennel et al. 1992; Gamma test, Evans & Jones 2002). Slopes and curvatures are least-squares fits over short windows of
rows.

The checks find nothing if few passes come near each other, or if noise hides the curvatures: even without a finding,
equations of first order may not suffice.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from atoll_coordinator.data.columns.examined_columns import (
    ColumnFinding,
    ExaminedColumns,
    Parts,
    dot,
    mean,
    quoted,
    roughness,
    upper_median,
    variance,
)
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray, IntArray

LIMITS = SETTINGS.columns
_RELEVANT: Final = SETTINGS.inference.part
"""An influence other than the coordinates is relevant if it causes at least this share of the variance (or of the
standard deviation) of a response."""
_MOST_POSITIONS: Final = 4
"""Largest number of states for which neighbours are searched: with more states, no two rows are close in positions and
velocities."""
_FEWEST_PAIRS: Final = 20
"""Fewest pairs of neighbours that a finding needs."""
_JUMPS: Final = 0.75
"""A column jumps from row to row if its roughness is larger than this number: a wave then has fewer than five rows in a
period (1 - cos(2 pi / 5) = 0.69)."""
_ROOT_70: Final = math.sqrt(70.0)
"""Standard deviation of the fourth difference of white noise with standard deviation 1."""


# --------------------------------------------------------------------------------------------------------- the checks


def check_second_order(columns: ExaminedColumns) -> Iterator[ColumnFinding]:
    """Yield a finding if the states do not determine velocities, but states and velocities determine accelerations.

    Not with hidden states: one of them may be the velocity, and order 2 excludes them.
    """
    roles = columns.roles
    is_first = columns.is_in_time and roles.order == 1 and not columns.config.data.stochastic and not roles.hidden
    if not is_first or len(roles.states) > _MOST_POSITIONS:
        return
    slopes = local_slopes(columns.times, columns.values, roles.states)
    if slopes is None:
        return
    first, second = disagreements(slopes, columns)
    is_closed = all(one is not None and one.share < _RELEVANT for one in second)
    if not is_closed or any(one is None for one in first) or not any(one is not None and one.is_open for one in first):
        return
    passes, its = ("passes", "its acceleration follows") if len(roles.states) == 1 else (
        "pass", "their accelerations follow"
    )  # fmt: skip
    yield ColumnFinding(
        f"{quoted(roles.states)} {passes} the same values with different velocities, and {its} from both",
        "to search for equations of second order, add --order 2",
    )


def check_map(columns: ExaminedColumns) -> Iterator[ColumnFinding]:
    """Yield a finding if states jump from row to row, but each row determines the next: x(n + 1) = f(x(n))."""
    states = columns.roles.states
    if not columns.is_in_time or columns.config.data.stochastic or not 0 < len(states) <= _MOST_POSITIONS:
        return
    is_jumping = all(roughness(columns.values[name]) > _JUMPS for name in states)
    if is_jumping and all(_determines_next(columns, name) for name in states):
        yield ColumnFinding(
            f"{quoted(states)} jump{'s' if len(states) == 1 else ''} from row to row, but each row determines the "
            "next, as in steps of a map x(n + 1) = f(x(n)) or in a wave with few rows in a period",
            "sample more often, or, if it is a map, write the next row's value into each row, as "
            f"'{states[0]}_next', and use --target {states[0]}_next",
        )


def _determines_next(columns: ExaminedColumns, name: str) -> bool:
    """Tell whether rows with nearly the same states have nearly the same next row."""
    values, roles = columns.values, columns.roles
    part = np.concatenate([np.full(len(along) - 1, place, np.int64) for place, along in enumerate(columns.times)])
    now = [np.concatenate([along[:-1] for along in values[other]]) for other in (*roles.states, *roles.inputs)]
    after = np.concatenate([along[1:] for along in values[name]])
    is_known = np.logical_and.reduce([np.isfinite(array) for array in (*now, after)])
    rows = np.flatnonzero(is_known)[: SETTINGS.rows.compared]
    if len(rows) < LIMITS.least_rows:
        return False
    pairs = neighbours([array[rows] for array in now], part[rows], 1)
    found = None if pairs is None else disagreement(pairs, after[rows])
    return found is not None and found.share < _RELEVANT


# --------------------------------------------------------------------------------------------------------- neighbours


@dataclass(frozen=True)
class Disagreement:
    """How much neighbours differ in a response.

    `share` is half of the mean squared difference, divided by the variance of the response in these rows: near 0 if the
    coordinates determine the response, near 1 if they do not. `size` is half of the same mean, divided by the variance
    of the response in all rows.
    """

    share: float
    size: float

    @property
    def is_open(self) -> bool:
        """Whether other influences cause more than half of the response's variance in these rows, and more than a
        quarter of its variance in all rows."""
        return self.share > 0.5 and self.size > 0.25


def neighbours(coordinates: Sequence[FloatArray], part: IntArray, apart: int) -> tuple[list[int], list[int]] | None:
    """Return pairs of a row and its nearest neighbour in another pass; only the closer half of all pairs is returned.

    The result is None if there are too few pairs.

    `coordinates` are (n,) each, rows in order; `part` (n,) is the trajectory of each row. Two rows belong to the same
    pass if they are fewer than `apart` rows apart, or if the states stay near between them.
    """
    scaled = [values / math.sqrt(variance(values)) for values in coordinates if variance(values) > 0.0]
    pairs = [pair for row in range(len(part)) if (pair := _neighbour(scaled, part, row, apart)) is not None]
    pairs.sort()
    pairs = pairs[: max(_FEWEST_PAIRS, len(pairs) // 2)]
    if len(pairs) < _FEWEST_PAIRS or not scaled:
        return None
    return [one for _, one, _ in pairs], [other for _, _, other in pairs]


def _neighbour(
    coordinates: Sequence[FloatArray], part: IntArray, row: int, apart: int
) -> tuple[float, int, int] | None:
    """Return the squared distance, the row and its nearest neighbour in another pass; None: no neighbour is near
    enough."""
    distance = np.zeros(len(part))
    for values in coordinates:
        away = values - values[row]
        distance = distance + away * away
    limit = _RELEVANT * _RELEVANT * len(coordinates)
    left = np.flatnonzero((distance > limit) | (part != part[row]))
    place = int(np.searchsorted(left, row))
    first = int(left[place - 1]) if place else -1
    last = int(left[place]) if place < len(left) else len(part)
    distance[max(0, min(first + 1, row - apart)) : max(last, row + apart + 1)] = math.inf
    nearest = int(np.argmin(distance))
    return (float(distance[nearest]), row, nearest) if distance[nearest] <= limit else None


def disagreement(pairs: tuple[list[int], list[int]], response: FloatArray) -> Disagreement | None:
    """Return how much the `pairs` of neighbours differ in a response (n,); None: the response is constant."""
    ones, others = response[pairs[0]], response[pairs[1]]
    both = np.concatenate([ones, others])
    about = both - mean(both)
    among, square = dot(about, about), dot(ones - others, ones - others)
    whole = 2.0 * len(ones) * variance(response)
    return Disagreement(square / among, square / whole) if among > 0.0 and whole > 0.0 else None


def disagreements(
    slopes: "LocalSlopes", columns: ExaminedColumns
) -> tuple[list[Disagreement | None], list[Disagreement | None]]:
    """Return the disagreement of neighbours in each slope, and the disagreement in each curvature of neighbours whose
    slopes also agree."""
    states = columns.roles.states
    positions = [slopes.means[name] for name in (*states, *columns.roles.inputs)]
    velocities = [slopes.slopes[name] for name in states]
    found = []
    for coordinates, responses in (
        (positions, velocities),
        ([*positions, *velocities], [slopes.curvatures[name] for name in states]),
    ):
        pairs = neighbours(coordinates, slopes.part, slopes.apart)
        found.append([None if pairs is None else disagreement(pairs, response) for response in responses])
    return found[0], found[1]


# ------------------------------------------------------------------------------------------------------- local slopes


@dataclass(frozen=True, eq=False)
class LocalSlopes:
    """Results for n windows: means of columns, slopes and curvatures of states, all (n,); `part` is the trajectory.

    `bends` are the sizes of curvatures with respect to the row number instead of the time. Windows fewer than `apart`
    places apart share rows.
    """

    means: Mapping[str, FloatArray]
    slopes: Mapping[str, FloatArray]
    curvatures: Mapping[str, FloatArray]
    bends: Mapping[str, FloatArray]
    part: IntArray
    apart: int


def local_slopes(times: Parts, values: Mapping[str, Parts], states: Sequence[str]) -> LocalSlopes | None:
    """Return slopes over the shortest windows in which noise does not hide curvatures; None: there are no such windows.

    Slopes are least-squares slopes with respect to the row number; time steps are treated as even within a window.
    """
    width = SETTINGS.common.fewest_rows
    noises = {name: _noise(values[name]) for name in states}
    while all(len(part) > width for part in times):
        slopes = _slopes_over(times, values, states, width)
        if slopes is None:
            return None
        # noise of a curvature if the noise of the rows is 1
        gain = math.sqrt(720.0 / (width * (width**2 - 1.0) * (width**2 - 4.0)))
        if all(noises[name] * gain < LIMITS.clear * upper_median(slopes.bends[name]) for name in states):
            return slopes
        width = 2 * width + 1
    return None


def _slopes_over(times: Parts, values: Mapping[str, Parts], states: Sequence[str], width: int) -> LocalSlopes | None:
    half = width // 2
    offsets = np.arange(-half, half + 1, dtype=np.float64)
    squares = dot(offsets, offsets)
    bent = offsets * offsets - squares / width
    means: dict[str, list[FloatArray]] = {name: [] for name in values}
    slopes: dict[str, list[FloatArray]] = {name: [] for name in states}
    curvatures: dict[str, list[FloatArray]] = {name: [] for name in states}
    bends: dict[str, list[FloatArray]] = {name: [] for name in states}
    numbers: list[IntArray] = []
    rows = sum(len(part) - width + 1 for part in times)
    every = max(1, rows // SETTINGS.rows.compared)
    for number, part in enumerate(times):
        firsts = np.arange(0, len(part) - width + 1, every)
        steps = (part[firsts + width - 1] - part[firsts]) / (width - 1)
        numbers.append(np.full(len(firsts), number, np.int64))
        for name, parts in values.items():
            along = parts[number]
            means[name].append(_weighted(along, firsts, np.full(width, 1.0 / width)))
            if name in slopes:
                slopes[name].append(_weighted(along, firsts, offsets / squares) / steps)
                curvature = _weighted(along, firsts, 2.0 * bent / dot(bent, bent))
                bends[name].append(np.abs(curvature))
                curvatures[name].append(curvature / (steps * steps))
    kinds = (means, slopes, curvatures, bends)
    joined = [{name: np.concatenate(parts) for name, parts in kind.items()} for kind in kinds]
    is_known = np.logical_and.reduce([np.isfinite(array) for kind in joined for array in kind.values()])
    kept = np.flatnonzero(is_known)
    if len(kept) < LIMITS.least_rows:
        return None
    a, b, c, d = ({name: array[kept] for name, array in kind.items()} for kind in joined)
    return LocalSlopes(a, b, c, d, np.concatenate(numbers)[kept], max(1, width // every))


def _weighted(values: FloatArray, firsts: IntArray, weights: FloatArray) -> FloatArray:
    """Return the weighted sum over each window; `firsts` are the first rows, and rows are added in order."""
    total = np.zeros(len(firsts))
    for place, weight in enumerate(weights.tolist()):
        total = total + weight * values[firsts + place]
    return total


def _noise(parts: Parts) -> float:
    """Return the size of the noise of a state from its fourth differences; infinite if there are none."""
    differences = np.concatenate([np.diff(part[: SETTINGS.rows.in_sums], 4) for part in parts])
    differences = differences[np.isfinite(differences)]
    return math.sqrt(dot(differences, differences) / len(differences)) / _ROOT_70 if len(differences) else math.inf
