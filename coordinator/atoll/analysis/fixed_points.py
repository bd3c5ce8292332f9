"""All fixed points in a box: damped Newton steps from many starts, eigenvalues of the Jacobian, and what kind they are.

Steps are those of Levenberg and Marquardt, which also approach points where the Jacobian is singular. The search is no
proof: a fixed point whose catchment none of the starts met stays unseen, and the search that was done is stated.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from atoll.analysis.box import Box
from atoll.analysis.flow import Flow, IntegrationBatch, crossing, steps
from atoll_core.data.dataset import FloatArray

Complexes = npt.NDArray[np.complex128]

STARTS_PER_STATE: Final = 200
MOST_STARTS: Final = 2000
MOST_POINTS: Final = 100
"""More points than this are a curve or a surface of them."""

TOLERANCE: Final = 1e-9
"""Of a last step, in widths of the box."""

_ITERATIONS: Final = 80
"""Steps from each start: at a simple point a handful, at a singular one each halves the distance (2**-30 is
`TOLERANCE`); the others are the way there."""

_APART: Final = 1e-5
"""Points nearer than this, in widths of the box, are one."""

_APART_DEGENERATE: Final = 1e-3
"""The same where the Jacobian is singular, which Newton steps approach slowly."""

_EXACT: Final = 1e-13
"""Of typical rates: what rounding leaves of 0."""

_BESIDE: Final = 1e-6
"""Longest Newton step to a root, in widths: of a root of order 5 it is 1e-8 after `_ITERATIONS`, of exp(-x) in a box of
a thousand times the length by which it falls e-fold 1e-3."""

_SINGULAR: Final = 1e-4
"""Smallest singular value of a Jacobian, as a share of the largest, below which it counts as singular."""

_AMPLITUDES: Final = (0.02, 0.1, 0.3)
"""Of orbits around a centre, in widths of the box."""

_CLOSED: Final = 1e-6
"""Share of its distance by which an orbit around a centre may miss itself: a hundred times the error of a turn."""

_EXAMPLES: Final = 10
"""Points that are shown of a curve or surface of them."""

_ROUNDING: Final = 1e-15
"""A real part below this share of the largest eigenvalue is one of rounding, and shown as 0."""

_ZERO: Final = 1e-6
"""A real part below this share of the largest eigenvalue decides nothing."""


@dataclass(frozen=True, eq=False)
class FixedPoint:
    """A point (D,) with dx/dt = 0, the `eigenvalues` (D,) of the Jacobian there by falling real part, and its `kind`.

    It `is_stable` where it attracts: by its eigenvalues, or where one of these is 0 by simulations from beside it.
    """

    point: FloatArray
    eigenvalues: Complexes
    kind: str
    is_stable: bool


@dataclass(frozen=True, eq=False)
class FixedPoints:
    """What a search found from so many `starts`, of which `converged` ended in a fixed point.

    `are_isolated` is False where there are so many that they form a curve or a surface; `points` are some of them then.
    """

    points: tuple[FixedPoint, ...]
    starts: int
    converged: int
    are_isolated: bool


def fixed_points(flow: Flow, box: Box) -> FixedPoints:
    """Return the fixed points in `box`, by rising first coordinate, then second, and so on."""
    starts = min(MOST_STARTS, STARTS_PER_STATE * flow.size)
    corners = [box.lower, box.upper, box.middle]
    ends = newton_ends(flow, box, np.vstack([corners, box.points(starts)]))
    inside = ends[box.contains(ends, 1e-6)]
    distinct = distinct_points(flow, inside, box)
    are_isolated = len(distinct) <= MOST_POINTS
    some = distinct if are_isolated else distinct[:: len(distinct) // _EXAMPLES]
    points = [classified(flow, point, box, is_isolated=are_isolated) for point in some]
    return FixedPoints(tuple(points), starts + len(corners), len(inside), are_isolated)


def newton_ends(flow: Flow, box: Box, starts: FloatArray) -> FloatArray:
    """Return where Newton steps from `starts` (N, D) end in a fixed point, as (n, D), in the order of the starts."""
    scale = rate_scale(flow, box)
    points, damping = starts.copy(), np.full(len(starts), 1e-3)
    values, last = flow.rates(points) / scale, np.full(len(starts), np.inf)
    for _ in range(_ITERATIONS):
        step = _damped_step(_scaled_jacobian(flow, points, box, scale), values, damping)
        step *= np.minimum(1.0, 0.5 / np.maximum(np.abs(step).max(axis=1), 1e-300))[:, None]
        tried = points + step * box.widths
        new = flow.rates(tried) / scale
        with np.errstate(all="ignore"):
            is_better = (new**2).sum(axis=1) < (values**2).sum(axis=1)
        last = np.where(is_better, np.abs(step).max(axis=1), last)
        points[is_better], values[is_better] = tried[is_better], new[is_better]
        damping = np.clip(damping * np.where(is_better, 0.1, 8.0), 1e-14, 1e8)
    with np.errstate(all="ignore"):
        size = np.abs(values).max(axis=1)
        is_root = (size < 1e-10) & ((last < TOLERANCE) | (size < _EXACT) | (damping < 1e8))
    points, values = points[is_root], values[is_root]
    return _polished(flow, points[_are_roots(flow, points, values, box, scale)], box, scale)


def _are_roots(flow: Flow, points: FloatArray, values: FloatArray, box: Box, scale: FloatArray) -> np.ndarray:
    """Tell which of `points` (N, D) with small rates, `values` (N, D) over their `scale`, have a root beside them.

    Where rates only become smaller, as those of exp(-x), a Newton step is long; where they come near to 0 and go away
    again, the Jacobian is singular and rounding is not all that is left of them.
    """
    matrix = _scaled_jacobian(flow, points, box, scale)
    singular = np.linalg.svd(matrix, compute_uv=False)
    step = np.einsum("nij,nj->ni", np.linalg.pinv(matrix, rcond=1e-10), values)
    is_regular = singular[:, -1] > _SINGULAR * singular[:, 0]
    return np.asarray((np.abs(step).max(axis=1) < _BESIDE) & (is_regular | (np.abs(values).max(axis=1) < _EXACT)))


def _polished(flow: Flow, points: FloatArray, box: Box, scale: FloatArray) -> FloatArray:
    """Return `points` after two plain Newton steps where these make the rates smaller; whole numbers come out whole."""
    for _ in range(2):
        values = flow.rates(points) / scale
        inverses = np.linalg.pinv(_scaled_jacobian(flow, points, box, scale), rcond=1e-10)
        tried = points - np.einsum("nij,nj->ni", inverses, values) * box.widths
        with np.errstate(all="ignore"):
            is_better = np.abs(flow.rates(tried) / scale).max(axis=1) < np.abs(values).max(axis=1)
        points = np.where(is_better[:, None], tried, points)
    return np.where(np.abs(points) < 1e-12 * box.widths, 0.0, points)


def _scaled_jacobian(flow: Flow, points: FloatArray, box: Box, scale: FloatArray) -> FloatArray:
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


def distinct_points(flow: Flow, points: FloatArray, box: Box) -> FloatArray:
    """Return one of each group of fixed points (n, D) that lie together, in order of their coordinates."""
    singular = np.linalg.svd(_scaled_jacobian(flow, points, box, rate_scale(flow, box)), compute_uv=False)
    apart = np.where(singular[:, -1] < _SINGULAR * singular[:, 0], _APART_DEGENERATE, _APART)
    kept: list[FloatArray] = []
    for point, least in zip(points, apart.tolist(), strict=True):
        if len(kept) > MOST_POINTS:
            break
        if all(np.abs((point - other) / box.widths).max() > least for other in kept):
            kept.append(point)
    rounded = [tuple(np.round(point / box.widths, 6)) for point in kept]
    order = sorted(range(len(kept)), key=rounded.__getitem__)
    return np.array([kept[index] for index in order]).reshape(-1, flow.size)


def classified(flow: Flow, point: FloatArray, box: Box, *, is_isolated: bool = True) -> FixedPoint:
    """Return a fixed point with its eigenvalues and kind; of one that is not isolated nothing is simulated."""
    matrix = jacobian_in_widths(flow, point, box)
    if not np.isfinite(matrix).all():
        return FixedPoint(point, np.full(flow.size, np.nan + 0j), "not differentiable", False)
    eigenvalues = np.linalg.eigvals(matrix).astype(np.complex128)
    largest = float(np.abs(eigenvalues).max())
    eigenvalues.real[np.abs(eigenvalues.real) < _ROUNDING * largest] = 0.0
    shares = np.round(eigenvalues.real / (largest or 1.0), 12)  # of a pair both real parts are to be one
    eigenvalues = eigenvalues[np.lexsort((eigenvalues.imag, -shares))]
    kind = kind_of(eigenvalues)
    if is_isolated and kind == "centre" and not _is_centre(flow, point, eigenvalues, box):
        kind = "non-hyperbolic"
    is_stable = kind in ("stable node", "stable focus")
    if is_isolated and kind == "non-hyperbolic" and (eigenvalues.real <= _ZERO * np.abs(eigenvalues).max()).all():
        is_stable = _attracts(flow, point, box)
    return FixedPoint(point, eigenvalues, kind, is_stable)


def _attracts(flow: Flow, point: FloatArray, box: Box) -> bool:
    """Tell whether courses from a small box around `point` come nearer to it, and stay."""
    beside = Box(point - 0.05 * box.widths, point + 0.05 * box.widths)
    starts = beside.points(16)
    slowest = time_scale(flow, box)
    batch = IntegrationBatch.of(starts, 1e-3 * slowest)
    batch.advance(flow.rates, 2000.0 * slowest, 1e-3 * box.widths, rtol=1e-5, most_steps=1500)
    first = np.abs((starts - point) / box.widths).max(axis=1)
    last = np.abs((batch.states - point) / box.widths).max(axis=1)
    return bool((~batch.is_lost).all() and (last < 0.5 * first.max()).all())


def kind_of(eigenvalues: Complexes) -> str:
    """Return the kind of a fixed point by the eigenvalues of its Jacobian.

    "stable" or "unstable" with "node" or "focus"; "saddle"; "saddle-focus", a saddle with a complex pair; "centre", an
    imaginary pair in two dimensions, as the linear part has it; "non-hyperbolic" otherwise.
    """
    largest = float(np.abs(eigenvalues).max())
    if largest == 0.0:
        return "non-hyperbolic"
    real, has_pair = eigenvalues.real, bool((np.abs(eigenvalues.imag) > _ZERO * largest).any())
    if (np.abs(real) <= _ZERO * largest).any():
        is_pair = len(eigenvalues) == 2 and has_pair
        return "centre" if is_pair else "non-hyperbolic"
    if (real < 0.0).any() and (real > 0.0).any():
        return "saddle-focus" if has_pair else "saddle"
    return ("stable " if real[0] < 0.0 else "unstable ") + ("focus" if has_pair else "node")


def _is_centre(flow: Flow, point: FloatArray, eigenvalues: Complexes, box: Box) -> bool:
    """Tell whether orbits beside `point` close: the nearest comes round, and each that does is where it began.

    Several are looked at, since a damping that grows with the amplitude is not seen near the point.
    """
    turns = [_turned(flow, point, share * box.widths[0], eigenvalues, box) for share in _AMPLITUDES]
    return turns[0] is not None and all(turn is None or abs(turn - 1.0) < _CLOSED for turn in turns)


def _turned(flow: Flow, point: FloatArray, radius: float, eigenvalues: Complexes, box: Box) -> float | None:
    """Return the distance from `point` on its first side after a turn, over the `radius` before; None: it has none."""
    period = 2.0 * np.pi / float(np.abs(eigenvalues.imag).max())
    start = point + np.array([radius, 0.0])

    def height(x: FloatArray) -> float:
        return float((x - point)[1])

    for step in steps(flow.rates, start, 3.0 * period, box.widths):
        before, after = step.start - point, step.end - point
        if before[1] * after[1] <= 0.0 < after[0] and step.after > 0.5 * period:
            return float((step.at(crossing(step, height)) - point)[0] / radius)
    return None
