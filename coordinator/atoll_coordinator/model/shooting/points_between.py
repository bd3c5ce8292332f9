"""Points off the measured curves, each from two measured points that are far apart. Pure.

Letters: N measured points, V numbers of each, G points off the curves.
"""

import math
from typing import Final

import numpy as np

from atoll_coordinator.model.thinning import thinned_places
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray

MOST_POINTS: Final = 500
"""Measured points that are taken, about: at a lattice, since every n-th row may be the same state of a period."""


def points_between(points: FloatArray) -> FloatArray:
    """Return points (G, V) on the lines between two measured ones each, which are far out among all `points` (V, N).

    Between measured points hold the constraints of all of them, such as a constant weighted sum or a sign, and energies
    are not as large as in the corners of a box of many states.
    """
    first, second, (share,) = _pairs(points, 1)
    return np.asarray(first + share[:, None] * (second - first))


def points_beside(points: FloatArray, moved: int) -> FloatArray:
    """Return points (G, V) in the boxes that two measured ones span, where constant sums and the like do not hold.

    The first `moved` numbers are moved; the others, such as inputs, stay as they are at the first of the two.
    """
    first, second, shares = _pairs(points, moved)
    first[:, :moved] += shares.T * (second - first)[:, :moved]
    return first


def without_kept(moves: FloatArray, points: FloatArray, noise: FloatArray) -> FloatArray:
    """Return `moves` (G, V) that keep the weighted sums which are constant in all measured `points` (V, N).

    These are directions (singular vectors, in widths of the range) along which points do not vary visibly, given their
    `noise` (V,): the variance of N independent rows is known to a share of sqrt(2/N), and a signal differs from noise
    (p = 0.05) where it adds more than 1.64 times that. With no more rows than numbers, no direction is known.
    """
    if points.shape[1] <= len(points):
        return moves
    widths = np.ptp(points, axis=1)
    widths = np.where(widths > 0.0, widths, 1.0)
    scaled = ((points - points.mean(axis=1, keepdims=True)) / widths[:, None]).T
    _, sizes, directions = np.linalg.svd(scaled, full_matrices=False)
    rows = len(scaled)
    least = math.sqrt(1.64 * math.sqrt(2.0 / rows)) * np.sqrt(((directions * noise / widths) ** 2).sum(axis=1))
    kept = directions[sizes / math.sqrt(rows) <= np.maximum(least, SETTINGS.common.clean)]
    return np.asarray(moves - (moves / widths) @ kept.T @ kept * widths)


def _pairs(points: FloatArray, numbers: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return two measured points (G, V), twice, and shares (numbers, G) of the way from one to the other."""
    count, width = SETTINGS.effort.beam, np.maximum(np.ptp(points, axis=1), 1e-300)
    known = points.T[thinned_places(points.shape[1], MOST_POINTS)]
    outer = known[_far_apart(known / width, 2 * count)]
    first_coordinates, second_coordinates, *shares = _latin_hypercube(count, 2 + numbers).T
    first, second = (
        outer[(coordinates * len(outer)).astype(int)] for coordinates in (first_coordinates, second_coordinates)
    )
    return first, second, np.array(shares)


def _far_apart(points: FloatArray, count: int) -> list[int]:
    """Return the places of up to so many of the `points` (N, D), each as far from the earlier ones as any.

    Farthest points first (Gonzalez 1985): a long rest of a process gets no more points than the way there.
    """
    places, nearest = [0], np.full(len(points), math.inf)
    for _ in range(1, count):
        nearest = np.minimum(nearest, ((points - points[places[-1]]) ** 2).sum(axis=1))
        farthest = int(np.argmax(nearest))
        if not nearest[farthest] > 0.0:
            break
        places.append(farthest)
    return places


def _latin_hypercube(count: int, dimensions: int) -> FloatArray:
    """Return points (G, K) of [0, 1): each of `count` equal parts of each dimension has one (McKay et al. 1979).

    As scipy.stats.qmc does it, whose import takes as long as many a search.
    """
    rng = np.random.default_rng(0)
    parts = rng.permuted(np.tile(np.arange(float(count)), (dimensions, 1)), axis=1)
    return np.asarray((parts + rng.random(parts.shape)).T / count)
