"""Isolated fixed points in a box, curves and surfaces of fixed points, and their kinds and stability.

Levenberg-Marquardt steps begin at hundreds of points of the box. They also converge to points with a singular Jacobian.

If the Jacobian is singular, the point may belong to a curve or a surface of fixed points. To test this, Newton steps
begin near the point, in each direction in which the rates hardly change. If the point is isolated, they return to it.
On a curve, they end at about the same distance at which they began, and the curve is then followed to its ends.

The eigenvalues determine the kind. An eigenvalue counts as 0 only within its own numerical uncertainty. This comes from
the rounding errors of the Jacobian and of the point, propagated to first order with the left and right eigenvectors
(Golub and Van Loan 2013, section 7.2). If eigenvalues do not decide whether a point attracts, simulations from nearby
states decide.

Doubtful: the search is not a proof. A fixed point is missed if no start converges to it; therefore the result reports
the number of starts. Simulations show only the dynamics within their duration. Letters: D states, N starts, n points.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import numpy.typing as npt

from atoll.analysis.flow import UNBOUNDED, Box, Flow, IntegrationBatch, crossing, steps
from atoll_core.data.dataset import FloatArray

Complexes = npt.NDArray[np.complex128]

STARTS_PER_STATE: Final = 200
MOST_STARTS: Final = 2000
"""Largest number of starts of the search."""

TOLERANCE: Final = 1e-9
"""Length of the last Newton step, in widths of the box."""

_ITERATIONS: Final = 80
"""Number of steps from each start. A simple root takes a few steps. At a singular root each step halves the distance,
so that 30 steps reach `TOLERANCE`; the other 50 steps bring the point near the root."""

_ZERO_RATE: Final = 1e-13
"""Rates below this share of the typical rates count as 0 up to rounding."""

_LONGEST_ROOT_STEP: Final = 1e-6
"""Longest last Newton step at a root, in widths. At a root of order 5 the step is 1e-8 after `_ITERATIONS`. It is 1e-3
for exp(-x), which has no root, in a box of a thousand decay lengths."""

_SINGULAR: Final = 1e-4
"""Smallest singular value of a Jacobian, as a share of the largest, below which it counts as singular."""

MOST_POINTS: Final = 100
"""Largest number of distinct points. More points only occur on a curve or a surface, for which this number is
enough."""

_SMALLEST_DISTANCE: Final = 1e-5
"""Smallest distance of distinct points, in widths of the box."""

_SMALLEST_DISTANCE_DEGENERATE: Final = 1e-3
"""The same distance if the Jacobian is singular, because Newton steps then converge slowly."""

NON_HYPERBOLIC: Final = "non-hyperbolic"

_AMPLITUDES: Final = (0.02, 0.1, 0.3)
"""Amplitudes of the orbits around a centre that are simulated, in widths of the box."""

_CLOSING_ERROR: Final = 1e-6
"""Largest closing error of an orbit around a centre, as a share of its amplitude: a hundred integration errors."""

_ROUNDING: Final = 10.0 * float(np.finfo(np.float64).eps)
"""Relative error of an entry of a Jacobian, which consists of sums and products of a few terms."""

_SHIFTS: Final = 10.0 ** np.arange(-12.0, -1.0)
"""Distances, in widths, by which a point is moved to estimate its rounding error."""

_START_WIDTH: Final = 0.05
"""Largest distance, in widths, between a point and the initial states of the simulations that test if it attracts."""

_STARTS: Final = 16
_MOST_STEPS: Final = 3000

_DURATIONS: Final = (20.0, 200.0, 2e3, 2e4, 1e6, 1e9)
"""Durations of these simulations, in times that a state needs to cross the box. Along the direction of an eigenvalue 0,
the distance from the point decays only as a power of time. Time steps grow, unless the states oscillate."""

MOST_SETS: Final = 10
"""Largest number of reported curves and surfaces."""

_NEIGHBOUR: Final = 0.01
"""Distance, in widths, at which neighbours of a point are searched. Half the distance is searched too: a curve has
neighbours at both distances."""

_STEP: Final = 0.02
"""Distance of consecutive points of a curve, in widths."""

_MOST_CURVE_STEPS: Final = 400
"""Largest number of steps along a curve in each direction."""

_CURVE_DISTANCE: Final = 2e-3
"""Largest distance, in widths, between a followed curve and a point on it: the chords of a curve are more accurate."""

_EXAMPLES: Final = 9
"""Number of points of a curve or a surface that are classified."""


@dataclass(frozen=True, eq=False)
class FixedPoint:
    """A point (D,) with dx/dt = 0, the `eigenvalues` (D,) of the Jacobian in order of descending real part, its `kind`.

    `is_stable`: it attracts from all sides. The eigenvalues show this or, if an eigenvalue is 0, simulations from
    nearby states. `attracts_in_box`: it attracts from the part of the box around it. This is enough for states that are
    never negative.
    """

    point: FloatArray
    eigenvalues: Complexes
    kind: str
    is_stable: bool
    attracts_in_box: bool

    @property
    def outline(self) -> FloatArray:
        """The point as points (1, D)."""
        return self.point[None]

    def distances(self, states: FloatArray, box: Box) -> FloatArray:
        """Return the distances (N,) of `states` (N, D) from the point, in widths of the box."""
        return np.asarray(np.sqrt((((states - self.point) / box.widths) ** 2).sum(axis=1)))


@dataclass(frozen=True, eq=False)
class FixedSet:
    """Fixed points that are not isolated: a curve (`dimension` 1) or a surface (2 or more).

    `course` (n, D) are points in the box; the points of a curve are in order. `points` are some of them, classified by
    the directions across the set. `whole` (m, D) is a curve with its continuation outside of the box, by at most D
    widths.
    """

    dimension: int
    course: FloatArray = field(repr=False)
    whole: FloatArray = field(repr=False)
    points: tuple[FixedPoint, ...] = field(repr=False)

    @property
    def is_straight(self) -> bool:
        """Whether a curve is a straight line."""
        chord = self.course[-1] - self.course[0]
        size = float(chord @ chord)
        if self.dimension > 1 or not size > 0.0:
            return False
        away = self.course - self.course[0]
        return bool(np.abs(away - np.outer(away @ chord / size, chord)).max() <= 1e-6 * np.abs(chord).max())

    @property
    def outline(self) -> FloatArray:
        """Points (n, D) of the set."""
        return self.course

    @property
    def attracts_in_box(self) -> bool:
        """Whether a part of the set attracts."""
        return any(point.attracts_in_box for point in self.points)

    def attracts_at(self, flow: Flow, states: FloatArray, box: Box) -> np.ndarray:
        """Tell for `states` (N, D) near the set whether it attracts there, from the eigenvalues across the set.

        If the largest of these eigenvalues is about 0, the nearest of `points` decides.
        """
        known = np.array([point.point for point in self.points])
        nearest = (((states[:, None] - known) / box.widths) ** 2).sum(axis=2).argmin(axis=1)
        attracts = np.array([point.attracts_in_box for point in self.points])[nearest]
        values = np.linalg.eigvals(np.nan_to_num(flow.jacobian(states)))
        sizes = np.sort(np.abs(values), axis=1)
        is_across = np.abs(values) > sizes[:, self.dimension - 1 : self.dimension]
        slowest = np.where(is_across, values.real, -np.inf).max(axis=1, initial=-np.inf)
        return np.asarray((slowest < 0.0) | (attracts & (slowest <= _CURVE_DISTANCE * sizes[:, -1])))

    def distances(self, flow: Flow, states: FloatArray, box: Box) -> FloatArray:
        """Return the distances (N,) of `states` (N, D) from the set, in widths; for a surface, the Newton step."""
        if self.dimension == 1:
            return box.distances(states, self.whole)
        scale = rate_scale(flow, box)
        inverses = np.linalg.pinv(_scaled_jacobian(flow, states, box, scale), rcond=1e-4)
        newton = np.einsum("nij,nj->ni", inverses, np.nan_to_num(flow.rates(states) / scale))
        return np.asarray(np.sqrt((newton**2).sum(axis=1)))


@dataclass(frozen=True, eq=False)
class FixedPoints:
    """The result of a search from a number of `starts`, of which `converged` ended in a fixed point.

    `points` are the isolated fixed points; `sets` are curves and surfaces of fixed points.
    """

    points: tuple[FixedPoint, ...]
    starts: int
    converged: int
    sets: tuple[FixedSet, ...] = ()

    @property
    def are_isolated(self) -> bool:
        """Whether all fixed points are isolated."""
        return not self.sets


def fixed_points(flow: Flow, box: Box) -> FixedPoints:
    """Return the fixed points in `box`, ordered by their first coordinate, then by the second, and so on."""
    spread = box.points(min(MOST_STARTS, STARTS_PER_STATE * flow.size))
    starts = np.vstack([box.lower, box.upper, box.middle, spread])
    ends, is_root = newton_steps(flow, box, starts)
    inside = ends[is_root & box.contains(ends, 1e-6)]
    sets, isolated = _fixed_sets(flow, box, distinct_points(flow, inside, box))
    points = tuple(classify(flow, point, box) for point in isolated)
    return FixedPoints(points, len(starts), len(inside), tuple(sets))


def distinct_points(flow: Flow, points: FloatArray, box: Box) -> FloatArray:
    """Return one point for each cluster of fixed points (n, D), in order of their coordinates."""
    singular = np.linalg.svd(_scaled_jacobian(flow, points, box, rate_scale(flow, box)), compute_uv=False)
    apart = np.where(singular[:, -1] < _SINGULAR * singular[:, 0], _SMALLEST_DISTANCE_DEGENERATE, _SMALLEST_DISTANCE)
    kept: list[FloatArray] = []
    for point, least in zip(points, apart.tolist(), strict=True):
        if len(kept) > MOST_POINTS:
            break
        if all(np.abs((point - other) / box.widths).max() > least for other in kept):
            kept.append(point)
    kept.sort(key=lambda point: tuple(np.round(point / box.widths, 6)))
    return np.array(kept).reshape(-1, flow.size)


# ------------------------------------------------------------------------------------------------------ Newton steps


def newton_steps(flow: Flow, box: Box, starts: FloatArray) -> tuple[FloatArray, np.ndarray]:
    """Return the points (N, D) at which Newton steps from `starts` (N, D) end, and which are fixed points (N,)."""
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
        if not values.any():
            break
    with np.errstate(all="ignore"):
        size = np.abs(values).max(axis=1)
        is_root = (size < 1e-10) & ((last < TOLERANCE) | (size < _ZERO_RATE) | (damping < 1e8))
    rows = np.flatnonzero(is_root)
    # Rates that only become small, such as exp(-x), give a long Newton step. Rates that come near 0 and grow again
    # give a singular Jacobian and values above rounding errors.
    matrix = _scaled_jacobian(flow, points[rows], box, scale)
    singular = np.linalg.svd(matrix, compute_uv=False)
    newton = np.einsum("nij,nj->ni", np.linalg.pinv(matrix, rcond=1e-10), values[rows])
    is_regular = singular[:, -1] > _SINGULAR * singular[:, 0]
    is_short = np.abs(newton).max(axis=1) < _LONGEST_ROOT_STEP
    rows = rows[is_short & (is_regular | (size[rows] < _ZERO_RATE))]
    points[rows] = _polish(flow, points[rows], box, scale)
    is_root[:] = False
    is_root[rows] = True
    return points, is_root


def _polish(flow: Flow, points: FloatArray, box: Box, scale: FloatArray) -> FloatArray:
    """Return `points` (n, D) after two Newton steps, if these reduce the rates: integer coordinates become exact."""
    for _ in range(2):
        values = flow.rates(points) / scale
        inverses = np.linalg.pinv(_scaled_jacobian(flow, points, box, scale), rcond=1e-10)
        tried = points - np.einsum("nij,nj->ni", inverses, values) * box.widths
        with np.errstate(all="ignore"):
            is_better = np.abs(flow.rates(tried) / scale).max(axis=1) < np.abs(values).max(axis=1)
        points = np.where(is_better[:, None], tried, points)
    return np.where(np.abs(points) < 1e-12 * box.widths, 0.0, points)


def _damped_step(matrix: FloatArray, values: FloatArray, damping: FloatArray) -> FloatArray:
    """Return Levenberg-Marquardt steps (N, D); undefined values count as 0."""
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

    A state that does not move in the box has the time scale of the slowest other state. If no state moves, the time
    needed to cross the box is set to 1; no result depends on this value.
    """
    rates = np.abs(flow.rates(box.points(256)))
    finite_rates = [finite[np.isfinite(finite)] for finite in rates.T]
    typical = np.array([np.median(finite) or finite.max() if len(finite) else 0.0 for finite in finite_rates])
    moving = typical > 0.0
    slowest = (typical[moving] / box.widths[moving]).min() if moving.any() else 1.0
    return np.where(moving, typical, slowest * box.widths)


def time_scale(flow: Flow, box: Box) -> float:
    """Return the time that the slowest state needs to cross the box at its typical rate."""
    return float((box.widths / rate_scale(flow, box)).max())


def jacobian_in_widths(flow: Flow, points: FloatArray, box: Box) -> FloatArray:
    """Return the Jacobian at (D,) or (N, D) for states in widths of the box.

    It has the same eigenvalues as the Jacobian of the model, and the unit of every entry is 1/time.
    """
    return np.asarray(flow.jacobian(points) / box.widths[:, None] * box.widths)


def _scaled_jacobian(flow: Flow, points: FloatArray, box: Box, scale: FloatArray) -> FloatArray:
    """Return the Jacobian (N, D, D) of rates over `scale` (D,) by states in widths; undefined entries are 0."""
    matrix = flow.jacobian(points) / scale[:, None] * box.widths
    return np.where(np.isfinite(matrix), matrix, 0.0)


def _singular_directions(flow: Flow, points: FloatArray, box: Box) -> list[FloatArray]:
    """Return for each of `points` (N, D) the directions (k, D), in widths of the box, in which rates hardly change."""
    directions: list[FloatArray] = []
    for matrix in _scaled_jacobian(flow, points, box, rate_scale(flow, box)):
        _, sizes, vectors = np.linalg.svd(matrix)
        directions.append(vectors[sizes <= _SINGULAR * max(sizes[0], 1.0)])
    return directions


# ------------------------------------------------------------------------------------------------ kinds and stability


@np.errstate(all="ignore")
def classify(flow: Flow, point: FloatArray, box: Box, along: FloatArray | None = None) -> FixedPoint:
    """Return a fixed point with its eigenvalues and kind.

    For a point of a curve or surface of fixed points, `along` (k, D) are the directions of this set, in widths. Then k
    eigenvalues are 0; the other eigenvalues determine the kind and whether the point attracts.
    """
    matrix, along = jacobian_in_widths(flow, point, box), np.zeros((0, flow.size)) if along is None else along
    if not np.isfinite(matrix).all():
        return FixedPoint(point, np.full(flow.size, np.nan + 0j), "not differentiable", False, False)
    eigenvalues, uncertainties = _eigenvalues(flow, point, box, matrix, along)
    across = np.sort(np.argsort(np.abs(eigenvalues), kind="stable")[len(along) :])
    kind = kind_of(eigenvalues[across], uncertainties[across])
    if kind == "centre" and (len(along) or not _is_centre(flow, point, eigenvalues, box)):
        kind = NON_HYPERBOLIC
    is_stable = attracts_in_box = kind in ("stable node", "stable focus")
    if kind == NON_HYPERBOLIC and len(across) and (eigenvalues.real[across] <= uncertainties[across]).all():
        attracts_in_box, is_stable = _attracts(flow, point, box, along)
    return FixedPoint(point, eigenvalues, kind, is_stable, attracts_in_box)


def kind_of(eigenvalues: Complexes, uncertainties: FloatArray | float = 0.0) -> str:
    """Return the kind of a fixed point from the eigenvalues (D,) of its Jacobian and the uncertainty of each (D,).

    The kinds are "stable" or "unstable" with "node" or "focus"; "saddle"; "saddle-focus", a saddle with a complex pair;
    "centre", an imaginary pair of the linear part in two dimensions; and "non-hyperbolic" otherwise.
    """
    real, has_pair = eigenvalues.real, bool((np.abs(eigenvalues.imag) > uncertainties).any())
    if not len(real) or (np.abs(real) <= uncertainties).any():
        return "centre" if len(eigenvalues) == 2 and has_pair else NON_HYPERBOLIC
    if (real < 0.0).any() and (real > 0.0).any():
        return "saddle-focus" if has_pair else "saddle"
    return ("stable " if real[0] < 0.0 else "unstable ") + ("focus" if has_pair else "node")


def _eigenvalues(
    flow: Flow, point: FloatArray, box: Box, matrix: FloatArray, along: FloatArray
) -> tuple[Complexes, FloatArray]:
    """Return the eigenvalues (D,) of the Jacobian `matrix` by descending real part, and the uncertainty of each (D,).

    To first order, an error E of the matrix A changes an eigenvalue by y^H E x / y^H x, with its right eigenvector x
    and left eigenvector y. This estimate has no bound if eigenvectors coincide, but the change is at most about
    |A| (|E|/|A|)^(1/D). Eigenvalues within their uncertainty become 0. For k directions `along` a set, the k smallest
    eigenvalues become 0 too.
    """
    from scipy.linalg import eig

    values, left, right = eig(matrix, left=True, right=True)
    values = values.astype(np.complex128)
    conditions = np.maximum(np.abs((left.conj() * right).sum(axis=0)), 1e-300)
    shifts = _ROUNDING * np.diag(np.maximum(np.abs(point), box.widths))
    changes = np.abs(jacobian_in_widths(flow, point + np.vstack([shifts, -shifts]), box) - matrix).max(axis=0)
    rounding = _ROUNDING * np.abs(matrix) + np.where(np.isfinite(changes), changes, 0.0)
    errors = [rounding, *_changes(flow, point, box, matrix, along)]
    by_errors = [np.einsum("ij,ik,kj->j", np.abs(left), error, np.abs(right)) for error in errors]
    size = float(np.linalg.norm(matrix))
    by_errors.append(np.full(len(values), _ROUNDING * size))  # the backward error of the algorithm
    total = _ROUNDING * size + float(np.linalg.norm(np.sum(errors, axis=0)))
    most = size * (total / size) ** (1.0 / len(values)) if size > 0.0 else total
    uncertainties = np.minimum(np.sum(by_errors, axis=0) / conditions, most)
    values.real[np.abs(values.real) <= uncertainties] = 0.0
    values.imag[np.abs(values.imag) <= uncertainties] = 0.0
    values[np.argsort(np.abs(values), kind="stable")[: len(along)]] = 0.0
    rounded = [float(f"{value:.12g}") for value in values.real.tolist()]  # the real parts of a pair must be equal
    falling = np.lexsort((values.imag, -np.array(rounded)))
    return values[falling] + 0.0, uncertainties[falling]


def _changes(flow: Flow, point: FloatArray, box: Box, matrix: FloatArray, along: FloatArray) -> Iterator[FloatArray]:
    """Yield changes of the Jacobian (D, D): from the point to states that rounding does not distinguish from it.

    In each direction, the rates of these states are below `_ZERO_RATE` or at most twice as large as at the point.
    Directions `along` a curve of fixed points do not count.
    """
    scale = rate_scale(flow, box)
    directions = np.linalg.svd(_scaled_jacobian(flow, point[None], box, scale)[0])[2]
    limit = max(_ZERO_RATE, 2.0 * float(np.abs(flow.rates(point) / scale).max()))
    for direction in directions - directions @ along.T @ along:
        moved = point + _SHIFTS[:, None, None] * np.array([[1.0], [-1.0]]) * direction * box.widths
        sizes = np.abs(flow.rates(moved.reshape(-1, flow.size)) / scale).max(axis=1).reshape(-1, 2).max(axis=1)
        open_places = int(np.logical_and.accumulate(sizes <= limit).sum())
        if open_places:
            change = np.abs(jacobian_in_widths(flow, moved[open_places - 1], box) - matrix).max(axis=0)
            yield np.where(np.isfinite(change), change, 0.0)


def _attracts(flow: Flow, point: FloatArray, box: Box, along: FloatArray) -> tuple[bool, bool]:
    """Tell whether `point` (D,) attracts all simulations from nearby states in the `box`, and whether from all sides.

    Simulations begin all around the point. More simulations begin on both sides of it in the directions in which rates
    hardly change, because it may attract from one side only. With directions `along` a curve or surface, distances are
    measured from this set.
    """
    around = Box(point - _START_WIDTH * box.widths, point + _START_WIDTH * box.widths)
    slow = _START_WIDTH * _singular_directions(flow, point[None], box)[0] * box.widths
    starts = np.vstack([around.points(_STARTS), point + slow, point - slow])
    within = np.clip(starts, box.lower, box.upper)
    scale = time_scale(flow, box)
    batch = IntegrationBatch.of(np.vstack([within, starts]), 1e-3 * scale)

    def distances(states: FloatArray) -> FloatArray:
        away = (states - point) / box.widths
        return np.asarray(np.abs(away - away @ along.T @ along).max(axis=1))

    first = distances(batch.states)
    for duration in _DURATIONS:
        batch.settle(flow, box, duration * scale, rtol=1e-5, most_steps=_MOST_STEPS // len(_DURATIONS))
        batch.is_lost |= box.excursions(batch.states) > UNBOUNDED
        if batch.is_lost[: len(within)].any():
            return False, False
    is_nearer = ~batch.is_lost & (distances(batch.states) < 0.5 * first.max())
    return bool(is_nearer[: len(within)].all()), bool(is_nearer.all())


def _is_centre(flow: Flow, point: FloatArray, eigenvalues: Complexes, box: Box) -> bool:
    """Tell whether orbits around `point` are closed: the smallest orbit, and each larger orbit that returns.

    Several amplitudes are simulated, because damping that grows with the amplitude is not visible near the point.
    """
    period = 2.0 * np.pi / float(np.abs(eigenvalues.imag).max())

    def height(x: FloatArray) -> float:
        return float((x - point)[1])

    def turn(radius: float) -> float | None:
        for step in steps(flow.rates, point + np.array([radius, 0.0]), 3.0 * period, box.widths):
            before, after = step.start - point, step.end - point
            if before[1] * after[1] <= 0.0 < after[0] and step.after > 0.5 * period:
                return float((step.at(crossing(step, height)) - point)[0] / radius)
        return None

    turns = [turn(share * box.widths[0]) for share in _AMPLITUDES]
    return turns[0] is not None and all(ratio is None or abs(ratio - 1.0) < _CLOSING_ERROR for ratio in turns)


# -------------------------------------------------------------------------------------------------- curves and surfaces


def tangents(flow: Flow, points: FloatArray, box: Box) -> list[FloatArray]:
    """Return for each of the fixed `points` (n, D) the directions (k, D), in widths, to other fixed points near it."""
    starts, owners = [np.zeros((0, flow.size))], list[int]()
    for index, (point, directions) in enumerate(zip(points, _singular_directions(flow, points, box), strict=True)):
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
    continues = (near > 0.25 * _NEIGHBOUR) & (far > 1.5 * near) & (far < 4.0 * _NEIGHBOUR)
    found: list[FloatArray] = []
    for index in range(len(points)):
        rows = np.flatnonzero(np.array(owners) == index)
        moved = [away[4 * row + side] for row in rows for side in (0, 1) if continues[row, side]]
        if not moved:
            found.append(np.zeros((0, flow.size)))
            continue
        _, lengths, directions = np.linalg.svd(np.array(moved), full_matrices=False)
        found.append(directions[lengths > 0.1 * lengths[0]])
    return found


def _fixed_sets(flow: Flow, box: Box, points: FloatArray) -> tuple[list[FixedSet], FloatArray]:
    """Return the curves and surfaces that contain some of the fixed `points` (n, D), and the isolated points (m, D)."""
    directions = tangents(flow, points, box)
    counts = np.array([len(along) for along in directions], dtype=np.int64)
    is_left, sets = counts > 0, list[FixedSet]()
    while (is_left & (counts == 1)).any() and len(sets) < MOST_SETS:
        seed = int(np.flatnonzero(is_left & (counts == 1))[0])
        course, whole = _follow_both_ways(flow, box, points[seed], directions[seed][0])
        is_left[seed] = False
        if len(course) > 2:
            is_left &= box.distances(points, course) > _CURVE_DISTANCE
            kinds = []
            for row in _spread(len(course)):
                chord = (course[min(row + 1, len(course) - 1)] - course[max(row - 1, 0)]) / box.widths
                unit = chord[None] / max(float(np.sqrt(chord @ chord)), 1e-300)
                kinds.append(classify(flow, course[row], box, unit))
            sets.append(FixedSet(1, course, whole, tuple(kinds)))
        else:
            counts[seed] = 0
    rest = np.flatnonzero(is_left & (counts > 1))
    if len(rest) > 2 and len(sets) < MOST_SETS:
        dimension = int(np.median(counts[rest]))
        rows = rest[counts[rest] == dimension]
        examples = tuple(classify(flow, points[row], box, directions[row]) for row in rows[_spread(len(rows))])
        sets.append(FixedSet(dimension, points[rows], points[rows], examples))
        is_left[rest] = False
    alone = (counts == 0) | (is_left & (counts > 1))
    for fixed in sets:
        if fixed.dimension == 1:
            alone &= box.distances(points, fixed.course) > _CURVE_DISTANCE
    return sets, points[alone]


def _spread(count: int) -> list[int]:
    """Return the indices of at most `_EXAMPLES` of `count` points, spread evenly."""
    rows: list[int] = np.unique(np.linspace(0, count - 1, _EXAMPLES).round().astype(int)).tolist()
    return rows


def _follow_both_ways(flow: Flow, box: Box, seed: FloatArray, direction: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the points (n, D) of the curve through `seed` (D,) in the box, and the same curve continued outside."""
    ahead, is_closed = _follow_curve(flow, box, box, seed, direction)
    if is_closed:
        course = np.array([seed, *ahead, seed])
        return course, course
    behind, _ = _follow_curve(flow, box, box, seed, -direction)
    course = np.array([*reversed(behind), seed, *ahead])
    if len(course) < 3:
        return course, course
    margin = flow.size * box.widths  # if the sum of the states is conserved, a curve can be that long
    wide = Box(box.lower - margin, box.upper + margin)
    beyond = []
    for last, before in ((course[0], course[1]), (course[-1], course[-2])):
        away = (last - before) / box.widths
        away /= max(float(np.sqrt(away @ away)), 1e-300)
        beyond.append(_follow_curve(flow, box, wide, last, away)[0])
    return course, np.array([*reversed(beyond[0]), *course, *beyond[1]])


def _follow_curve(
    flow: Flow, box: Box, limits: Box, seed: FloatArray, direction: FloatArray
) -> tuple[list[FloatArray], bool]:
    """Return the points within `limits` after `seed` (D,) in a direction (D,), and whether the curve closes."""
    course, here = list[FloatArray](), seed
    for _ in range(_MOST_CURVE_STEPS):
        with np.errstate(all="ignore"):  # the last step ends at the limits
            room = np.where(direction > 0.0, limits.upper - here, here - limits.lower) / box.widths / np.abs(direction)
        step = float(np.clip(room[np.abs(direction) > 1e-9].min(initial=_STEP), 0.0, _STEP))
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
