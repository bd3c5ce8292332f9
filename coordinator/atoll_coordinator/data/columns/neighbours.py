"""Do the same states go on in the same way? Nearest neighbours of different passes, compared. Pure.

Where a law holds between coordinates and a response, rows with nearly the same coordinates have nearly the same
response, whenever they were measured (false nearest neighbours, Kennel et al. 1992; Gamma test, Evans & Jones 2002).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from atoll_coordinator.data.columns.sums import dot, mean, variance
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray, IntArray

LIMITS = SETTINGS.columns


@dataclass(frozen=True)
class Disagreement:
    """By how much neighbours differ in a response.

    `share` is the mean square of half the difference over the variance of the response in these rows: near 0 where the
    coordinates decide it, near 1 where they do not. `size` is the same over the variance in all rows.
    """

    share: float
    size: float

    @property
    def is_open(self) -> bool:
        """Whether something else decides the response: by half, where it is not next to nothing anyway."""
        return self.share > LIMITS.open_share and self.size > LIMITS.open_share**2


def neighbours(coordinates: Sequence[FloatArray], part: IntArray, apart: int) -> tuple[list[int], list[int]] | None:
    """Return rows and their nearest neighbours in other passes, the nearer half; None where too few rows have one.

    `coordinates` are (n,), rows in order, `part` (n,) the trajectory of each. Rows fewer than `apart` from each other,
    or between which the states stay near, are of the same pass.
    """
    scaled = [values / math.sqrt(variance(values)) for values in coordinates if variance(values) > 0.0]
    pairs = [pair for row in range(len(part)) if (pair := _neighbour(scaled, part, row, apart)) is not None]
    pairs.sort()
    pairs = pairs[: max(LIMITS.least_pairs, len(pairs) // 2)]
    if len(pairs) < LIMITS.least_pairs or not scaled:
        return None
    return [one for _, one, _ in pairs], [other for _, _, other in pairs]


def disagreement(pairs: tuple[list[int], list[int]], response: FloatArray) -> Disagreement | None:
    """Return how much `neighbours` differ in a response (n,), None where it is constant."""
    ones, others = response[pairs[0]], response[pairs[1]]
    both = np.concatenate([ones, others])
    about = both - mean(both)
    among, square = dot(about, about), dot(ones - others, ones - others)
    whole = 2.0 * len(ones) * variance(response)
    return Disagreement(square / among, square / whole) if among > 0.0 and whole > 0.0 else None


def _neighbour(
    coordinates: Sequence[FloatArray], part: IntArray, row: int, apart: int
) -> tuple[float, int, int] | None:
    """Return the square of the distance, the row and its nearest neighbour in another pass, if it is near enough."""
    distance = np.zeros(len(part))
    for values in coordinates:
        away = values - values[row]
        distance = distance + away * away
    limit = LIMITS.near * LIMITS.near * len(coordinates)
    left = np.flatnonzero((distance > limit) | (part != part[row]))
    place = int(np.searchsorted(left, row))
    first = max(int(left[place - 1]) if place else -1, -1)
    last = int(left[place]) if place < len(left) else len(part)
    distance[max(0, min(first + 1, row - apart)) : max(last, row + apart + 1)] = math.inf
    nearest = int(np.argmin(distance))
    return (float(distance[nearest]), row, nearest) if distance[nearest] <= limit else None
