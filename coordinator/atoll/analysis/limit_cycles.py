"""Limit cycles by Newton's method, from the first near return of long simulations to a Poincaré section.

Newton's method solves phi_T(x) = x and a phase condition for the state x and the period T; phi_T is the flow over the
time T. The derivative of phi_T is the monodromy matrix, which solves the variational equations (Guckenheimer and Holmes
1983, section 1.5). Its eigenvalues are the Floquet multipliers. In the plane, the nontrivial multiplier is exp of the
divergence integrated over a period (Liouville). This formula keeps all digits if the multiplier is tiny. In the plane,
unstable cycles are found in backward time.

Doubtful: in more dimensions, only the cycles that simulations approach are found. A cycle with more than 40 turns is
not distinguished from chaos. Letters: D states, N points.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from atoll.analysis.fixed_points import (
    NON_HYPERBOLIC,
    Complexes,
    FixedPoint,
    FixedSet,
    classify,
    distinct_points,
    jacobian_in_widths,
    newton_steps,
    tangents,
    time_scale,
)
from atoll.analysis.flow import (
    EXTENSIONS,
    SETTLING,
    UNBOUNDED,
    Box,
    Flow,
    IntegrationBatch,
    crossing,
    follow,
    is_nearly_at_rest,
    steps,
)
from atoll_coordinator.model.batches import BatchFunction, Spread
from atoll_core.data.dataset import FloatArray

STARTS: Final = 24
"""Number of simulations from all over the box."""

_MOST_STEPS: Final = 1500
"""Largest number of steps of one simulation."""

MOST_CYCLES: Final = 10
"""Largest number of reported cycles; each takes up to a second."""

_MOST_FAILURES: Final = 2
"""Number of simulations that may end without a stable cycle. After that, all further simulations count as unsettled."""

SAMPLES: Final = 400
"""Number of points of a cycle. The extent of a harmonic cycle then has a relative error of (pi/400)**2/2 = 3e-5."""

_NEAR_RETURN: Final = 0.1
"""Largest distance of a near return, as a share of the extent of the trajectory. Newton's method then decides whether
there is a cycle."""

SMALLEST: Final = 1e-3
"""Smallest extent of a cycle, in widths of the box."""

_SLOW_DISTANCE: Final = 0.05
"""Distance from a fixed point, in widths, within which a state counts as at rest if it approaches the point slowly, in
the direction of an eigenvalue 0."""

_CLOSING_ERROR: Final = 1e-8
"""Largest distance between the ends of a closed cycle, in widths of the box: ten times the integration error."""

_NEUTRAL: Final = 1e-4
"""A multiplier at a smaller distance from 1 (or from the unit circle) counts as 1 (or as on the circle). The error of a
double multiplier is the square root of `_CLOSING_ERROR`."""

_NEUTRAL_IN_PLANE: Final = 1e-7
"""The same limit for two states, where the multiplier is an integral: a hundred times the integration tolerance."""

_LARGEST_ERROR: Final = 0.01
"""Largest error of a cycle, as a share of its extent: the closing error divided by the contraction in a period."""

_SMALL_EXTENT: Final = 0.01
"""Extent of an orbit, in widths of the box. Errors of smaller orbits are relative to the box, not to their extent."""

_MOST_RETURNS: Final = 40
"""Number of returns among which the nearest is chosen. A cycle with more turns is not distinguished from chaos."""


@dataclass(frozen=True, eq=False)
class LimitCycle:
    """A closed orbit through `point` (D,) with its `period` and Floquet `multipliers` (D,), the trivial one (1) first.

    `points` (n, D) lie on the cycle at equal time steps. `log_multiplier_product` is the logarithm of the product of
    the multipliers. An orbit that is not `is_isolated` belongs to a family of orbits, for example around a centre.
    """

    point: FloatArray
    period: float
    multipliers: Complexes
    log_multiplier_product: float
    points: FloatArray = field(repr=False)

    @property
    def is_isolated(self) -> bool:
        """Whether no other multiplier is 1."""
        return bool((np.abs(self.multipliers[1:] - 1.0) > self._neutral).all())

    @property
    def is_stable(self) -> bool:
        """Whether the cycle attracts: all nontrivial multipliers lie within the unit circle."""
        return bool((np.abs(self.multipliers[1:]) < 1.0 - self._neutral).all())

    @property
    def _neutral(self) -> float:
        return _NEUTRAL_IN_PLANE if len(self.multipliers) == 2 else _NEUTRAL

    @property
    def outline(self) -> FloatArray:
        """Points (n, D) of the cycle."""
        return self.points

    def distances(self, states: FloatArray, box: Box) -> FloatArray:
        """Return the distances (N,) of `states` (N, D) from the polygon through its points, in widths of the box."""
        return box.distances(states, np.vstack([self.points, self.points[:1]]))


@dataclass(frozen=True, eq=False)
class LimitCycles:
    """The result of `starts` simulations over at most `duration`.

    `resting` are the stable fixed points outside of the box that simulations reached. `unsettled` (n, D) are the last
    states of simulations that reached no known attractor. `has_family`: there are closed orbits that are not isolated.
    """

    cycles: tuple[LimitCycle, ...]
    starts: int
    duration: float
    resting: tuple[FixedPoint, ...]
    unsettled: FloatArray = field(repr=False)
    has_family: bool = False


def limit_cycles(
    flow: Flow, box: Box, fixed: Sequence[FixedPoint], sets: Sequence[FixedSet] = (), spread: Spread | None = None
) -> LimitCycles:
    """Return the limit cycles that simulations from `box` reach, in order of their periods.

    For two states, time also runs backward. Simulations that end at one of the `fixed` points, or in one of the `sets`
    of fixed points, reach no cycle. `spread` distributes the searches for closed orbits over workers.
    """
    spread = spread or Spread()
    forward = _reached_cycles(flow, box, fixed, sets, spread)
    cycles = list(forward.cycles)
    if flow.size == 2:
        for cycle in _reached_cycles(replace(flow, direction=-flow.direction), box, fixed, sets, spread).cycles:
            if all(other.distances(cycle.point[None], box)[0] > 1e-3 for other in cycles):
                turned = _closed_orbit(flow, cycle.point, cycle.period, box)
                cycles += [turned] if turned is not None else []
    isolated = sorted((cycle for cycle in cycles if cycle.is_isolated), key=lambda cycle: cycle.period)
    return replace(forward, cycles=tuple(isolated), has_family=len(isolated) < len(cycles))


@dataclass(frozen=True, eq=False)
class _OrbitSearch:
    """Searches closed orbits near the last states of simulations, which took `duration`."""

    flow: Flow
    box: Box
    duration: float

    @np.errstate(all="ignore")
    def orbit(self, end: FloatArray) -> LimitCycle | None:
        """Return the closed orbit near a last state (D,)."""
        period = _first_return(self.flow, end, self.box, self.duration)
        return None if period is None else _closed_orbit(self.flow, end, period, self.box)


_ORBITS: Final = BatchFunction("cycles", _OrbitSearch, FloatArray, LimitCycle | None, _OrbitSearch.orbit)


def _reached_cycles(
    flow: Flow, box: Box, fixed: Sequence[FixedPoint], sets: Sequence[FixedSet], spread: Spread
) -> LimitCycles:
    ends, count, duration = _final_states(flow, box, fixed)
    for fixed_set in sets:
        ends = ends[fixed_set.distances(flow, ends, box) > _SLOW_DISTANCE]
    resting_points = _resting_points(flow, ends, box)
    cycles: list[LimitCycle] = []
    unsettled, failures = [], 0
    search, orbits = _OrbitSearch(flow, box, duration), dict[int, LimitCycle | None]()
    waiting = [end for end in ends if not any(_is_at_rest(end, point, box) for point in (*fixed, *resting_points))]

    def is_known(end: FloatArray) -> bool:
        return any(known.distances(end[None], box)[0] < 1e-2 for known in cycles)

    for place, end in enumerate(waiting):
        if is_known(end):
            continue
        if failures >= _MOST_FAILURES or len(cycles) >= MOST_CYCLES:
            unsettled.append(end)
            continue
        if place not in orbits:
            # if these searches find no stable cycle, all of them are needed, so workers do them at the same time
            most = _MOST_FAILURES - failures if spread.is_shared else 1
            ahead = [other for other in range(place, len(waiting)) if not is_known(waiting[other])][:most]
            found = spread.map(_ORBITS, lambda: search, [waiting[other] for other in ahead])
            orbits.update(zip(ahead, found, strict=True))
        cycle = orbits[place]
        if cycle is not None and any(known.distances(cycle.point[None], box)[0] < 1e-3 for known in cycles):
            failures += 1  # the simulation approaches a known cycle slowly
            continue
        cycles += [cycle] if cycle is not None else []
        if cycle is None or not cycle.is_stable:
            unsettled += [end] if cycle is None or cycle.is_isolated else []
            failures += 1
    left = np.array(unsettled).reshape(-1, flow.size)
    return LimitCycles(tuple(cycles), count, duration, tuple(resting_points), left)


def _final_states(flow: Flow, box: Box, fixed: Sequence[FixedPoint]) -> tuple[FloatArray, int, float]:
    """Return the last states (n, D) of bounded simulations, the number of simulations, and their duration.

    Simulations begin in the box and near its fixed points.
    """
    duration = SETTLING * time_scale(flow, box)
    nearby = [point.point[None] + 0.02 * box.widths for point in fixed[:STARTS]]
    starts = np.vstack([box.points(STARTS), *nearby])
    batch = IntegrationBatch.of(starts, 1e-4 * duration)
    before = batch.states
    for part in range(1, 6):
        before = batch.states.copy()
        batch.settle(flow, box, 0.2 * part * duration, rtol=1e-6, most_steps=_MOST_STEPS // 5)
        batch.is_lost |= box.excursions(batch.states) > UNBOUNDED
    is_slow = is_nearly_at_rest(batch.states, before, box, 0.2 * SETTLING) & ~batch.is_lost
    slow = batch.of_rows(is_slow)
    for longer in EXTENSIONS if is_slow.any() else ():
        slow.settle(flow, box, longer * duration, rtol=1e-6, most_steps=_MOST_STEPS // 5)
    batch.states[is_slow], batch.is_lost[is_slow] = slow.states, slow.is_lost
    batch.is_lost |= box.excursions(batch.states) > UNBOUNDED
    return batch.states[~batch.is_lost], len(starts), duration


def _resting_points(flow: Flow, ends: FloatArray, box: Box) -> list[FixedPoint]:
    """Return the attracting fixed points outside of the box that Newton's method finds near `ends` (n, D).

    This includes points on curves of fixed points if the curve attracts.
    """
    roots, is_root = newton_steps(flow, box, ends)
    points = distinct_points(flow, np.asarray(roots[is_root]), box)
    is_near = [bool((np.abs((ends - point) / box.widths).max(axis=1) < 0.01).any()) for point in points]
    points = points[np.array(is_near, dtype=bool) & ~box.contains(points, 1e-6)]
    along = tangents(flow, points, box)
    resting_points = [classify(flow, point, box, directions) for point, directions in zip(points, along, strict=True)]
    return [rest for rest in resting_points if rest.attracts_in_box]


def _is_at_rest(end: FloatArray, point: FixedPoint, box: Box) -> bool:
    near = SMALLEST
    if point.attracts_in_box:  # the approach along the direction of an eigenvalue 0 is slow
        near = 10.0 * (_SLOW_DISTANCE if point.kind == NON_HYPERBOLIC else SMALLEST)
    return bool(np.abs((end - point.point) / box.widths).max() < near)


def _first_return(flow: Flow, start: FloatArray, box: Box, longest: float) -> float | None:
    """Return the time of the first near return to the section through `start` (D,); None without a near return.

    The section is orthogonal to the flow. A return is near if its distance is about as small as the smallest distance
    of all returns.
    """
    normal = flow.rates(start) / box.widths
    if not np.isfinite(normal).all() or not np.abs(normal).max() > 0.0:
        return None
    normal = normal / np.sqrt((normal**2).sum())

    def side(x: FloatArray) -> float:
        return float(normal @ ((x - start) / box.widths))

    returns: list[tuple[float, float]] = []
    farthest = 0.0
    for step in steps(flow.rates, start, longest, box.widths, rtol=1e-7, most=5000):
        farthest = max(farthest, float(np.abs((step.end - start) / box.widths).max()))
        if farthest > UNBOUNDED or len(returns) >= _MOST_RETURNS:
            break
        if side(step.start) < 0.0 <= side(step.end):
            time = crossing(step, side)
            returns.append((time, float(np.abs((step.at(time) - start) / box.widths).max())))
            if returns[-1][1] < 1e-3 * farthest:
                break
    nearest = min((far for _, far in returns), default=np.inf)
    if farthest < SMALLEST or nearest > _NEAR_RETURN * min(farthest, 1.0):
        return None
    return next(time for time, far in returns if far <= 3.0 * nearest + 1e-5)


def _closed_orbit(flow: Flow, start: FloatArray, period: float, box: Box) -> LimitCycle | None:
    """Return the closed orbit that Newton's method reaches from a first point and period; None if it diverges."""
    point, size = start.copy(), flow.size
    phase = period * flow.rates(start) / box.widths
    for iteration in range(12):
        end, monodromy, log_multiplier_product = _transport(flow, point, period, box)
        missed = (end - point) / box.widths
        if not np.isfinite(monodromy).all() or not np.isfinite(end).all():
            return None
        if np.abs(missed).max() < _CLOSING_ERROR:
            break
        if iteration >= 5 and np.abs(missed).max() > 1e-2:
            return None
        matrix = np.zeros((size + 1, size + 1))
        matrix[:size, :size] = monodromy - np.eye(size)
        matrix[:size, size] = period * flow.rates(end) / box.widths
        matrix[size, :size] = phase
        step = np.linalg.lstsq(matrix, np.append(-missed, 0.0), rcond=1e-9)[0]
        step *= min(1.0, 0.3 / max(float(np.abs(step).max()), 1e-300))
        point, period = point + step[:size] * box.widths, period * (1.0 + float(step[size]))
    else:
        return None
    points = follow(flow.rates, point, np.linspace(0.0, period, SAMPLES, endpoint=False), box.widths)
    extent = ((points.max(axis=0) - points.min(axis=0)) / box.widths).max()
    if not extent > SMALLEST or not period > 0.0:
        return None
    cycle = LimitCycle(point, period, multipliers_of(monodromy, log_multiplier_product), log_multiplier_product, points)
    miss = float(np.abs(missed).max())
    if not cycle.is_isolated:  # an orbit of a family closes exactly; a small spiral that shrinks slowly does not
        return cycle if miss <= _CLOSING_ERROR * max(extent, _SMALL_EXTENT) else None
    return cycle if miss / np.abs(cycle.multipliers[1:] - 1.0).min() <= _LARGEST_ERROR * extent else None


def _transport(flow: Flow, start: FloatArray, duration: float, box: Box) -> tuple[FloatArray, FloatArray, float]:
    """Return the state (D,) at `duration` after `start` (D,), its derivative (D, D), and the integrated divergence.

    The derivative is with respect to `start`, in widths of the box. The integrated divergence is the logarithm of the
    determinant of the derivative. All are NaN if the integration ends early.
    """
    size = flow.size

    def rates(y: FloatArray) -> FloatArray:
        matrix = jacobian_in_widths(flow, y[:size], box)
        transported = (matrix @ y[size:-1].reshape(size, size)).ravel()
        return np.concatenate([flow.rates(y[:size]), transported, [np.trace(matrix)]])

    sizes = np.concatenate([box.widths, np.ones(size * size + 1)])
    whole = list(steps(rates, np.concatenate([start, np.eye(size).ravel(), [0.0]]), duration, sizes))
    if not whole or whole[-1].after < duration * (1.0 - 1e-12):
        return np.full(size, np.nan), np.full((size, size), np.nan), np.nan
    end = whole[-1].end
    return end[:size], end[size:-1].reshape(size, size), float(end[-1])


def multipliers_of(monodromy: FloatArray, log_multiplier_product: float) -> Complexes:
    """Return the eigenvalues (D,) of a monodromy matrix (D, D): the trivial one first, then by descending size."""
    if len(monodromy) == 2:
        return np.array([1.0, np.exp(min(log_multiplier_product, 700.0))], dtype=np.complex128)
    values = np.linalg.eigvals(monodromy).astype(np.complex128)
    trivial = int(np.argmin(np.abs(values - 1.0)))
    others = np.delete(values, trivial)
    return np.concatenate([values[trivial : trivial + 1], others[np.argsort(-np.abs(others), kind="stable")]])
