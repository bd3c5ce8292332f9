"""Newton steps to fixed points from many starts, and the scales of rates and times in a box.

Steps are those of Levenberg and Marquardt, which also approach points where the Jacobian is singular. The search is no
proof: a fixed point whose catchment none of the starts met stays unseen, and the search that was done is stated.
"""

from typing import Final

import numpy as np

from atoll.analysis.box import Box
from atoll.analysis.flow import Flow
from atoll_core.data.dataset import FloatArray

STARTS_PER_STATE: Final = 200
MOST_STARTS: Final = 2000
TOLERANCE: Final = 1e-9
"""Of a last step, in widths of the box."""

_ITERATIONS: Final = 80
"""Steps from each start: at a simple point a handful, at a singular one each halves the distance (2**-30 is
`TOLERANCE`); the others are the way there."""

EXACT: Final = 1e-13
"""Of typical rates: what rounding leaves of 0."""

_BESIDE: Final = 1e-6
"""Longest Newton step to a root, in widths: of a root of order 5 it is 1e-8 after `_ITERATIONS`, of exp(-x) in a box of
a thousand times the length by which it falls e-fold 1e-3."""

SINGULAR: Final = 1e-4
"""Smallest singular value of a Jacobian, as a share of the largest, below which it counts as singular."""


def newton_starts(box: Box) -> FloatArray:
    """Return where Newton steps begin, (N, D)."""
    size = len(box.lower)
    spread = box.points(min(MOST_STARTS, STARTS_PER_STATE * size))
    return np.vstack([box.lower, box.upper, box.middle, spread])


def newton_ends(flow: Flow, box: Box, starts: FloatArray) -> FloatArray:
    """Return where Newton steps from `starts` (N, D) end in a fixed point, as (n, D), in the order of the starts."""
    points, is_root = newton_steps(flow, box, starts)
    return np.asarray(points[is_root])


def newton_steps(flow: Flow, box: Box, starts: FloatArray) -> tuple[FloatArray, np.ndarray]:
    """Return where Newton steps from `starts` (N, D) end, (N, D), and which of these are fixed points (N,)."""
    scale = rate_scale(flow, box)
    points, damping = starts.copy(), np.full(len(starts), 1e-3)
    values, last = flow.rates(points) / scale, np.full(len(starts), np.inf)
    for _ in range(_ITERATIONS):
        step = _damped_step(scaled_jacobian(flow, points, box, scale), values, damping)
        step *= np.minimum(1.0, 0.5 / np.maximum(np.abs(step).max(axis=1), 1e-300))[:, None]
        tried = points + step * box.widths
        new = flow.rates(tried) / scale
        with np.errstate(all="ignore"):
            is_better = (new**2).sum(axis=1) < (values**2).sum(axis=1)
        last = np.where(is_better, np.abs(step).max(axis=1), last)
        points[is_better], values[is_better] = tried[is_better], new[is_better]
        damping = np.clip(damping * np.where(is_better, 0.1, 8.0), 1e-14, 1e8)
        if not values.any():
            break
    with np.errstate(all="ignore"):
        size = np.abs(values).max(axis=1)
        is_root = (size < 1e-10) & ((last < TOLERANCE) | (size < EXACT) | (damping < 1e8))
    rows = np.flatnonzero(is_root)
    rows = rows[_are_roots(flow, points[rows], values[rows], box, scale)]
    points[rows] = _polished(flow, points[rows], box, scale)
    is_root[:] = False
    is_root[rows] = True
    return points, is_root


def _are_roots(flow: Flow, points: FloatArray, values: FloatArray, box: Box, scale: FloatArray) -> np.ndarray:
    """Tell which of `points` (N, D) with small rates, `values` (N, D) over their `scale`, have a root beside them.

    Where rates only become smaller, as those of exp(-x), a Newton step is long; where they come near to 0 and go away
    again, the Jacobian is singular and rounding is not all that is left of them.
    """
    matrix = scaled_jacobian(flow, points, box, scale)
    singular = np.linalg.svd(matrix, compute_uv=False)
    step = np.einsum("nij,nj->ni", np.linalg.pinv(matrix, rcond=1e-10), values)
    is_regular = singular[:, -1] > SINGULAR * singular[:, 0]
    return np.asarray((np.abs(step).max(axis=1) < _BESIDE) & (is_regular | (np.abs(values).max(axis=1) < EXACT)))


def _polished(flow: Flow, points: FloatArray, box: Box, scale: FloatArray) -> FloatArray:
    """Return `points` after two plain Newton steps where these make the rates smaller; whole numbers come out whole."""
    for _ in range(2):
        values = flow.rates(points) / scale
        inverses = np.linalg.pinv(scaled_jacobian(flow, points, box, scale), rcond=1e-10)
        tried = points - np.einsum("nij,nj->ni", inverses, values) * box.widths
        with np.errstate(all="ignore"):
            is_better = np.abs(flow.rates(tried) / scale).max(axis=1) < np.abs(values).max(axis=1)
        points = np.where(is_better[:, None], tried, points)
    return np.where(np.abs(points) < 1e-12 * box.widths, 0.0, points)


def scaled_jacobian(flow: Flow, points: FloatArray, box: Box, scale: FloatArray) -> FloatArray:
    """Return the Jacobian (N, D, D) of rates over their `scale` (D,) by states in widths; 0 where it has no value."""
    matrix = flow.jacobian(points) / scale[:, None] * box.widths
    return np.where(np.isfinite(matrix), matrix, 0.0)


def _damped_step(matrix: FloatArray, values: FloatArray, damping: FloatArray) -> FloatArray:
    """Return the steps of Levenberg and Marquardt (N, D); zero where something has no value."""
    transposed = matrix.transpose(0, 2, 1)
    right = transposed @ np.where(np.isfinite(values), values, 0.0)[:, :, None]
    normal = transposed @ matrix
    diagonal = np.einsum("nii->ni", normal)
    added = damping[:, None] * (diagonal.max(axis=1, keepdims=True) + 1e-30) + 1e-300
    normal = normal + added[:, :, None] * np.eye(matrix.shape[1])
    try:
        return np.asarray(-np.linalg.solve(normal, right)[:, :, 0])
    except np.linalg.LinAlgError:
        return np.asarray(-(np.linalg.pinv(normal) @ right)[:, :, 0])


def rate_scale(flow: Flow, box: Box) -> FloatArray:
    """Return the typical size (D,) of each rate in the box.

    A state that does not move there is taken to be as slow as the slowest of the others; where none moves, the time
    that it takes through the box is 1, which decides nothing.
    """
    rates = np.abs(flow.rates(box.points(256)))
    finite_rates = [finite[np.isfinite(finite)] for finite in rates.T]
    typical = np.array([np.median(finite) or finite.max() if len(finite) else 0.0 for finite in finite_rates])
    moving = typical > 0.0
    slowest = (typical[moving] / box.widths[moving]).min() if moving.any() else 1.0
    return np.where(moving, typical, slowest * box.widths)


def time_scale(flow: Flow, box: Box) -> float:
    """Return the time that the slowest state takes through the box at its typical rate."""
    return float((box.widths / rate_scale(flow, box)).max())


def jacobian_in_widths(flow: Flow, points: FloatArray, box: Box) -> FloatArray:
    """Return the Jacobian at (D,) or (N, D) of states in widths of the box: similar, but of no unit but time's."""
    return np.asarray(flow.jacobian(points) / box.widths[:, None] * box.widths)


def singular_directions(flow: Flow, points: FloatArray, box: Box) -> list[FloatArray]:
    """Return for each of `points` (N, D) the directions (k, D), in widths of the box, in which rates hardly change."""
    matrices = scaled_jacobian(flow, points, box, rate_scale(flow, box))
    directions: list[FloatArray] = []
    for matrix in matrices:
        _, sizes, vectors = np.linalg.svd(matrix)
        directions.append(vectors[sizes <= SINGULAR * max(sizes[0], 1.0)])
    return directions
