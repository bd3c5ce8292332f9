"""All fixed points in a box: isolated ones, and the curves and surfaces that they may form."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from atoll.analysis.box import Box
from atoll.analysis.fixed_sets import FixedSet, fixed_sets
from atoll.analysis.flow import Flow
from atoll.analysis.newton import SINGULAR, newton_ends, newton_starts, rate_scale, scaled_jacobian
from atoll.analysis.stability import FixedPoint, classified
from atoll_core.data.dataset import FloatArray

MOST_POINTS: Final = 100
"""Points that are looked at: more of them are a curve or a surface, of which so many are enough."""

_APART: Final = 1e-5
"""Points nearer than this, in widths of the box, are one."""

_APART_DEGENERATE: Final = 1e-3
"""The same where the Jacobian is singular, which Newton steps approach slowly."""


@dataclass(frozen=True, eq=False)
class FixedPoints:
    """What a search found from so many `starts`, of which `converged` ended in a fixed point.

    `points` are isolated; `sets` are curves and surfaces of others.
    """

    points: tuple[FixedPoint, ...]
    starts: int
    converged: int
    sets: tuple[FixedSet, ...] = ()

    @property
    def are_isolated(self) -> bool:
        """Whether no fixed points form a curve or a surface."""
        return not self.sets


def fixed_points(flow: Flow, box: Box) -> FixedPoints:
    """Return the fixed points in `box`, by rising first coordinate, then second, and so on."""
    starts = newton_starts(box)
    ends = newton_ends(flow, box, starts)
    inside = ends[box.contains(ends, 1e-6)]
    sets, isolated = fixed_sets(flow, box, distinct_points(flow, inside, box))
    points = tuple(classified(flow, point, box) for point in isolated)
    return FixedPoints(points, len(starts), len(inside), tuple(sets))


def distinct_points(flow: Flow, points: FloatArray, box: Box) -> FloatArray:
    """Return one of each group of fixed points (n, D) that lie together, in order of their coordinates."""
    singular = np.linalg.svd(scaled_jacobian(flow, points, box, rate_scale(flow, box)), compute_uv=False)
    apart = np.where(singular[:, -1] < SINGULAR * singular[:, 0], _APART_DEGENERATE, _APART)
    kept: list[FloatArray] = []
    for point, least in zip(points, apart.tolist(), strict=True):
        if len(kept) > MOST_POINTS:
            break
        if all(np.abs((point - other) / box.widths).max() > least for other in kept):
            kept.append(point)
    rounded = [tuple(np.round(point / box.widths, 6)) for point in kept]
    order = sorted(range(len(kept)), key=rounded.__getitem__)
    return np.array([kept[index] for index in order]).reshape(-1, flow.size)
