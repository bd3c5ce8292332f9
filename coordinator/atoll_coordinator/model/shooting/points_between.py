"""Points away from the measured curves, each computed from two measured points that are far apart. Pure.

Letters: N measured points, V components of a point, G points away from the curves.
"""

import math
from typing import Final

import numpy as np

from atoll_coordinator.model.thinning import thinned_places
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray

MOST_POINTS: Final = 500
"""Approximate number of measured points used. A lattice selects these points, since with every n-th row all points
might have the same phase of a period."""


def points_between(points: FloatArray) -> FloatArray:
    """Return points (G, V) on lines; each line is between two of the measured `points` (V, N) that are far apart.

    If all measured points satisfy a linear constraint, such as a constant weighted sum or a sign, points on these lines
    also satisfy this constraint. Energies are smaller on the lines than in the corners of a box of many states.
    """
    first, second, (share,) = _draw_pairs(points, 1)
    return np.asarray(first + share[:, None] * (second - first))


def points_in_boxes(points: FloatArray, moved: int) -> FloatArray:
    """Return points (G, V) in boxes; two measured points are opposite corners of each box. Linear constraints, such as
    constant sums, may not hold for these points.

    The first `moved` components vary; the other components, such as inputs, have the values of the first of the two
    points.
    """
    first, second, shares = _draw_pairs(points, moved)
    first[:, :moved] += shares.T * (second - first)[:, :moved]
    return first


def remove_conserved_directions(moves: FloatArray, points: FloatArray, noise: FloatArray) -> FloatArray:
    """Return `moves` (G, V) without their components along conserved directions of the `points` (V, N).

    Along a conserved direction (a singular vector, in units of the range), all points have the same weighted sum: it
    varies by no more than the `noise` (V,). The estimated variance of N independent rows has the relative standard
    error sqrt(2/N). A variance counts as larger than the noise (p = 0.05) if it is more than 1.64 standard errors
    larger. If there are no more rows than components, no direction is removed.
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


def _draw_pairs(points: FloatArray, numbers: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return G pairs of measured points, as two arrays (G, V), and random shares (numbers, G) of the way from the first
    to the second point."""
    count, width = SETTINGS.effort.beam, np.maximum(np.ptp(points, axis=1), 1e-300)
    known = points.T[thinned_places(points.shape[1], MOST_POINTS)]
    outer = known[_choose_far_apart(known / width, 2 * count)]
    first_coordinates, second_coordinates, *shares = latin_hypercube(count, 2 + numbers).T
    first, second = (
        outer[(coordinates * len(outer)).astype(int)] for coordinates in (first_coordinates, second_coordinates)
    )
    return first, second, np.array(shares)


def _choose_far_apart(points: FloatArray, count: int) -> list[int]:
    """Return the indices of up to `count` of the `points` (N, D); each point is the farthest from all earlier points.

    With this farthest-point sampling (Gonzalez 1985), a long steady state gets no more points than the transient.
    """
    places, nearest = [0], np.full(len(points), math.inf)
    for _ in range(1, count):
        nearest = np.minimum(nearest, ((points - points[places[-1]]) ** 2).sum(axis=1))
        farthest = int(np.argmax(nearest))
        if not nearest[farthest] > 0.0:
            break
        places.append(farthest)
    return places


def latin_hypercube(count: int, dimensions: int, seed: int = 0) -> FloatArray:
    """Return points (G, K) in [0, 1): each of `count` equal parts of each dimension has one point (McKay et al. 1979).

    Same as scipy.stats.qmc, without its slow import.
    """
    rng = np.random.default_rng(seed)
    parts = rng.permuted(np.tile(np.arange(float(count)), (dimensions, 1)), axis=1)
    return np.asarray((parts + rng.random(parts.shape)).T / count)
