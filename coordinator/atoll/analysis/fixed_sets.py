"""Curves and surfaces of fixed points: told from isolated points by their neighbours, curves followed to their ends.

Where the Jacobian at a fixed point is singular, Newton steps begin a little beside it in each direction in which rates
hardly change. Beside a point that is isolated they return to it; on a curve or a surface they end about as far away as
they began. Letters: D states, n points.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from atoll.analysis.box import Box
from atoll.analysis.flow import Flow
from atoll.analysis.newton import newton_steps, rate_scale, scaled_jacobian, singular_directions
from atoll.analysis.stability import FixedPoint, classified
from atoll_core.data.dataset import FloatArray

MOST_SETS: Final = 10
"""Curves and surfaces that are shown."""

_NEIGHBOUR: Final = 0.01
"""Widths beside a point at which neighbours are sought, and half of that: a curve goes on for both."""

_STEP: Final = 0.02
"""Widths from one point of a curve to the next."""

_MOST_STEPS: Final = 400
"""Of a curve, in each direction."""

_ON: Final = 2e-3
"""Widths within which a point belongs to a curve that has been followed: its chords are off by less."""

_EXAMPLES: Final = 9
"""Points of a curve or a surface that are classified."""


@dataclass(frozen=True, eq=False)
class FixedSet:
    """Fixed points that are not isolated: a curve of `dimension` 1, a surface of 2 or more.

    `course` (n, D) are points of it in the box, those of a curve in their order, and `points` some of these with their
    kinds across it. `whole` (m, D) are those of a curve also outside, to D widths of the box beyond.
    """

    dimension: int
    course: FloatArray = field(repr=False)
    whole: FloatArray = field(repr=False)
    points: tuple[FixedPoint, ...] = field(repr=False)

    @property
    def is_straight(self) -> bool:
        """Whether a curve is a line."""
        chord = self.course[-1] - self.course[0]
        size = float(chord @ chord)
        if self.dimension > 1 or not size > 0.0:
            return False
        away = self.course - self.course[0]
        return bool(np.abs(away - np.outer(away @ chord / size, chord)).max() <= 1e-6 * np.abs(chord).max())

    @property
    def attracts_in_box(self) -> bool:
        """Whether a part of it attracts."""
        return any(point.attracts_in_box for point in self.points)

    def attracts_at(self, flow: Flow, states: FloatArray, box: Box) -> np.ndarray:
        """Tell of `states` (N, D) beside it whether it attracts there: by the eigenvalues across it.

        Where the largest of these is about 0, the nearest of `points` decides.
        """
        known = np.array([point.point for point in self.points])
        nearest = (((states[:, None] - known) / box.widths) ** 2).sum(axis=2).argmin(axis=1)
        attracts = np.array([point.attracts_in_box for point in self.points])[nearest]
        values = np.linalg.eigvals(np.nan_to_num(flow.jacobian(states)))
        sizes = np.sort(np.abs(values), axis=1)
        is_across = np.abs(values) > sizes[:, self.dimension - 1 : self.dimension]
        slowest = np.where(is_across, values.real, -np.inf).max(axis=1, initial=-np.inf)
        return np.asarray((slowest < 0.0) | (attracts & (slowest <= _ON * sizes[:, -1])))

    def distances(self, flow: Flow, states: FloatArray, box: Box) -> FloatArray:
        """Return how far `states` (N, D) are from it (N,), in widths: of a surface, the length of a Newton step."""
        if self.dimension == 1:
            return from_course(self.whole, states, box)
        scale = rate_scale(flow, box)
        inverses = np.linalg.pinv(scaled_jacobian(flow, states, box, scale), rcond=1e-4)
        steps = np.einsum("nij,nj->ni", inverses, np.nan_to_num(flow.rates(states) / scale))
        return np.asarray(np.sqrt((steps**2).sum(axis=1)))


def from_course(course: FloatArray, states: FloatArray, box: Box) -> FloatArray:
    """Return how far `states` (N, D) are from the chords of a `course` (n, D), (N,), in widths."""
    corners = course / box.widths
    sides, beside = np.diff(corners, axis=0), states[:, None] / box.widths - corners[:-1]
    lengths = np.maximum((sides**2).sum(axis=1), 1e-300)
    share = np.clip((beside * sides).sum(axis=2) / lengths, 0.0, 1.0)
    return np.asarray(np.sqrt(((beside - share[:, :, None] * sides) ** 2).sum(axis=2)).min(axis=1))


def tangents(flow: Flow, points: FloatArray, box: Box) -> list[FloatArray]:
    """Return for each of the fixed `points` (n, D) the directions (k, D), in widths, in which others lie beside it."""
    slow = singular_directions(flow, points, box)
    starts, owners = [np.zeros((0, flow.size))], list[int]()
    for index, (point, directions) in enumerate(zip(points, slow, strict=True)):
        for direction in directions:
            sides = _NEIGHBOUR * np.array([[1.0], [-1.0], [0.5], [-0.5]]) * direction
            starts.append(point + sides * box.widths)
            owners.append(index)
    begun = np.vstack(starts)
    if not len(begun):
        return [np.zeros((0, flow.size))] * len(points)
    ends, is_root = newton_steps(flow, box, begun)
    away = (ends - np.repeat(points[owners], 4, axis=0)) / box.widths
    sizes = np.where(is_root, np.abs(away).max(axis=1), 0.0).reshape(-1, 4)
    far, near = sizes[:, :2], sizes[:, 2:]
    goes_on = (near > 0.25 * _NEIGHBOUR) & (far > 1.5 * near) & (far < 4.0 * _NEIGHBOUR)
    found: list[FloatArray] = []
    for index in range(len(points)):
        mine = np.flatnonzero(np.array(owners) == index)
        moved = [away[4 * row + side] for row in mine for side in (0, 1) if goes_on[row, side]]
        if not moved:
            found.append(np.zeros((0, flow.size)))
            continue
        _, lengths, directions = np.linalg.svd(np.array(moved), full_matrices=False)
        found.append(directions[lengths > 0.1 * lengths[0]])
    return found


def fixed_sets(flow: Flow, box: Box, points: FloatArray) -> tuple[list[FixedSet], FloatArray]:
    """Return the curves and surfaces that some of the fixed `points` (n, D) lie on, and the others, (m, D)."""
    directions = tangents(flow, points, box)
    counts = np.array([len(along) for along in directions], dtype=np.int64)
    is_left, sets = counts > 0, list[FixedSet]()
    while (is_left & (counts == 1)).any() and len(sets) < MOST_SETS:
        seed = int(np.flatnonzero(is_left & (counts == 1))[0])
        course, whole = _followed(flow, box, points[seed], directions[seed][0])
        is_left[seed] = False
        if len(course) > 2:
            is_left &= from_course(course, points, box) > _ON
            sets.append(_curve(flow, box, course, whole))
        else:
            counts[seed] = 0
    rest = np.flatnonzero(is_left & (counts > 1))
    if len(rest) > 2 and len(sets) < MOST_SETS:
        sets.append(_surface(flow, box, points[rest], [directions[index] for index in rest]))
        is_left[rest] = False
    alone = (counts == 0) | (is_left & (counts > 1))
    for fixed in sets:
        if fixed.dimension == 1:
            alone &= from_course(fixed.course, points, box) > _ON
    return sets, points[alone]


def _curve(flow: Flow, box: Box, course: FloatArray, whole: FloatArray) -> FixedSet:
    rows = np.unique(np.linspace(0, len(course) - 1, _EXAMPLES).round().astype(int))
    kinds = []
    for row in rows.tolist():
        chord = (course[min(row + 1, len(course) - 1)] - course[max(row - 1, 0)]) / box.widths
        kinds.append(classified(flow, course[row], box, chord[None] / max(float(np.sqrt(chord @ chord)), 1e-300)))
    return FixedSet(1, course, whole, tuple(kinds))


def _surface(flow: Flow, box: Box, points: FloatArray, directions: Sequence[FloatArray]) -> FixedSet:
    dimension = int(np.median([len(along) for along in directions]))
    rows = [row for row in range(len(points)) if len(directions[row]) == dimension]
    shown = [rows[place] for place in np.unique(np.linspace(0, len(rows) - 1, _EXAMPLES).round().astype(int))]
    kinds = tuple(classified(flow, points[row], box, directions[row]) for row in shown)
    return FixedSet(dimension, points[rows], points[rows], kinds)


def _followed(flow: Flow, box: Box, seed: FloatArray, direction: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the points (n, D) of the curve through `seed` across the box, and those from beyond it on either side."""
    ahead, is_closed = _followed_to_its_end(flow, box, box, seed, direction)
    if is_closed:
        course = np.array([seed, *ahead, seed])
        return course, course
    behind, _ = _followed_to_its_end(flow, box, box, seed, -direction)
    course = np.array([*reversed(behind), seed, *ahead])
    if len(course) < 3:
        return course, course
    beside = flow.size * box.widths  # as far as sums that are kept may lead
    wide = Box(box.lower - beside, box.upper + beside)
    beyond = []
    for last, before in ((course[0], course[1]), (course[-1], course[-2])):
        away = (last - before) / box.widths
        away /= max(float(np.sqrt(away @ away)), 1e-300)
        beyond.append(_followed_to_its_end(flow, box, wide, last, away)[0])
    return course, np.array([*reversed(beyond[0]), *course, *beyond[1]])


def _followed_to_its_end(
    flow: Flow, box: Box, limits: Box, seed: FloatArray, direction: FloatArray
) -> tuple[list[FloatArray], bool]:
    """Return the points within `limits` after `seed` in a direction (D,), and whether they lead back to it."""
    course, here = list[FloatArray](), seed
    for _ in range(_MOST_STEPS):
        step = _STEP * _inside(here, direction, limits, box)
        if step < 1e-6:
            break
        ends, is_root = newton_steps(flow, box, (here + step * direction * box.widths)[None])
        moved = (ends[0] - here) / box.widths
        size = float(np.sqrt(moved @ moved))
        if not is_root[0] or not 0.5 * step < size < 2.0 * step or moved @ direction <= 0.5 * size:
            break
        here, direction = ends[0], moved / size
        course.append(np.clip(here, limits.lower, limits.upper))
        back = (here - seed) / box.widths
        if len(course) > 2 and np.sqrt(back @ back) < 0.6 * _STEP:
            return course[:-1], True
    return course, False


def _inside(here: FloatArray, direction: FloatArray, limits: Box, box: Box) -> float:
    """Return which share of a step in a direction, (D,) in widths of the box, remains within `limits`, at most 1."""
    with np.errstate(all="ignore"):
        room = (
            np.where(direction > 0.0, limits.upper - here, here - limits.lower)
            / box.widths
            / (_STEP * np.abs(direction))
        )
    return float(np.clip(room[np.abs(direction) > 1e-9].min(initial=1.0), 0.0, 1.0))
