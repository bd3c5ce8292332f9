"""Limit cycles: long simulations, the first near return to a Poincaré section, and Newton steps on the period map.

Newton steps solve phi_T(x) = x together with a phase condition for x and T; the derivative of phi_T is the monodromy
matrix, which the variational equations give (Guckenheimer and Holmes 1983, section 1.5). Its eigenvalues are the
Floquet multipliers. In the plane the one beside 1 is exp of the divergence integrated over a period (Liouville), which
keeps its digits where it is tiny. There, unstable cycles are found in backward time; beyond the plane only cycles that
simulations come near are found.
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
    classified,
    distinct_points,
    jacobian_in_widths,
    newton_ends,
    tangents,
    time_scale,
)
from atoll.analysis.flow import (
    LONGER,
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
from atoll_core.data.dataset import FloatArray

STARTS: Final = 24
MOST_STEPS: Final = 1500
"""Steps of such a simulation."""

MOST_CYCLES: Final = 10
"""Cycles that are shown; each costs up to a second."""

MOST_FAILURES: Final = 2
"""Ends of simulations that lead to no stable cycle, until the rest is left as unsettled."""

SAMPLES: Final = 400
"""Points of a cycle that are kept: the extent of a harmonic one is known to (pi/400)**2/2, 3e-5 of itself."""

_NEAR: Final = 0.1
"""Extents of the course within which a return is near; Newton steps decide whether a cycle is there."""

SMALLEST: Final = 1e-3
"""Smallest extent of a cycle, in widths of the box."""

_SLOWLY: Final = 0.05
"""Widths within which a course is at rest that comes to fixed points along an eigenvalue of 0."""

_CLOSED: Final = 1e-8
"""Widths of the box by which a cycle may miss itself: ten times the error of the integration."""

_NEUTRAL: Final = 1e-4
"""A multiplier nearer to 1, or to the unit circle, decides nothing: the root of `_CLOSED`, by which double multipliers
are off."""

_NEUTRAL_IN_PLANE: Final = 1e-7
"""The same of two states, where it is an integral: a hundred times the tolerance of the integration."""

_KNOWN: Final = 0.01
"""Share of its extent to which a cycle must be known: what a course misses itself by, over what it contracts by."""

_SMALL: Final = 0.01
"""Widths of the box below which orbits are followed with errors of the box, a hundredth of those of a state."""

_MOST_RETURNS: Final = 40
"""Turns of a course in which a return is looked for: cycles of more turns are not told from chaos."""


@dataclass(frozen=True, eq=False)
class LimitCycle:
    """A closed orbit through `point` (D,) with its `period` and Floquet `multipliers` (D,), that of the flow (1) first.

    `points` (n, D) lie on it at even times. `log_multiplier_product` is the logarithm of the product of the
    multipliers. An orbit that is not `is_isolated` belongs to a family, as around a centre.
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
    def _neutral(self) -> float:
        return _NEUTRAL_IN_PLANE if len(self.multipliers) == 2 else _NEUTRAL

    @property
    def is_stable(self) -> bool:
        """Whether it attracts: all multipliers beside that of the flow lie within the unit circle."""
        return bool((np.abs(self.multipliers[1:]) < 1.0 - self._neutral).all())


@dataclass(frozen=True, eq=False)
class LimitCycles:
    """What `starts` simulations over at most `duration` led to.

    `resting` are stable fixed points that they reached outside the box; `unsettled` (n, D) ends that no attractor
    explains; `has_family` tells of closed orbits that are not isolated.
    """

    cycles: tuple[LimitCycle, ...]
    starts: int
    duration: float
    resting: tuple[FixedPoint, ...]
    unsettled: FloatArray = field(repr=False)
    has_family: bool = False


def limit_cycles(flow: Flow, box: Box, fixed: Sequence[FixedPoint], sets: Sequence[FixedSet] = ()) -> LimitCycles:
    """Return the limit cycles that simulations from `box` lead to, by rising period; of two states also backward.

    Simulations that come to rest at one of the `fixed` points, or on one of the `sets` of them, lead to none.
    """
    forward = _reached(flow, box, fixed, sets)
    cycles = list(forward.cycles)
    if flow.size == 2:
        for cycle in _reached(replace(flow, direction=-flow.direction), box, fixed, sets).cycles:
            if all(distance(other, cycle.point[None], box)[0] > 1e-3 for other in cycles):
                turned = _closed_orbit(flow, cycle.point, cycle.period, box)
                cycles += [turned] if turned is not None else []
    isolated = sorted((cycle for cycle in cycles if cycle.is_isolated), key=lambda cycle: cycle.period)
    return replace(forward, cycles=tuple(isolated), has_family=len(isolated) < len(cycles))


def _reached(flow: Flow, box: Box, fixed: Sequence[FixedPoint], sets: Sequence[FixedSet]) -> LimitCycles:
    ends, count, duration = _ends(flow, box, fixed)
    for fixed_set in sets:
        ends = ends[fixed_set.distances(flow, ends, box) > _SLOWLY]
    rests = _rests(flow, ends, box)
    resting = [*fixed, *rests]
    cycles: list[LimitCycle] = []
    unsettled, failures = [], 0
    for end in ends:
        if _is_at_rest(end, resting, box) or any(distance(known, end[None], box)[0] < 1e-2 for known in cycles):
            continue
        if failures >= MOST_FAILURES or len(cycles) >= MOST_CYCLES:
            unsettled.append(end)
            continue
        period = _first_return(flow, end, box, duration)
        cycle = None if period is None else _closed_orbit(flow, end, period, box)
        if cycle is not None and any(distance(known, cycle.point[None], box)[0] < 1e-3 for known in cycles):
            failures += 1  # courses that approach a known cycle slowly tell nothing new
            continue
        cycles += [cycle] if cycle is not None else []
        if cycle is None or not cycle.is_stable:
            unsettled += [end] if cycle is None or cycle.is_isolated else []
            failures += 1
    left = np.array(unsettled).reshape(-1, flow.size)
    return LimitCycles(tuple(cycles), count, duration, tuple(rests), left)


def _ends(flow: Flow, box: Box, fixed: Sequence[FixedPoint]) -> tuple[FloatArray, int, float]:
    """Return where simulations from the box and from beside its fixed points are after the transient, if bounded."""
    duration = SETTLING * time_scale(flow, box)
    beside = [point.point[None] + 0.02 * box.widths for point in fixed[:STARTS]]
    starts = np.vstack([box.points(STARTS), *beside])
    batch = IntegrationBatch.of(starts, 1e-4 * duration)
    most, sizes, before = MOST_STEPS // 5, 1e-3 * box.widths, batch.states
    for part in range(1, 6):
        before = batch.states.copy()
        until = 0.2 * part * duration
        batch.advance(flow.rates, until, sizes, rtol=1e-6, most_steps=most, jacobian=flow.jacobian)
        batch.is_lost |= box.excursions(batch.states) > UNBOUNDED
    is_slow = is_nearly_at_rest(batch.states, before, box, 0.2 * SETTLING) & ~batch.is_lost
    slow = batch.of_rows(is_slow)
    for longer in LONGER if is_slow.any() else ():
        slow.advance(flow.rates, longer * duration, sizes, rtol=1e-6, most_steps=most, jacobian=flow.jacobian)
    batch.states[is_slow], batch.is_lost[is_slow] = slow.states, slow.is_lost
    batch.is_lost |= box.excursions(batch.states) > UNBOUNDED
    return batch.states[~batch.is_lost], len(starts), duration


def _rests(flow: Flow, ends: FloatArray, box: Box) -> list[FixedPoint]:
    """Return the fixed points outside the box that Newton steps find beside `ends`, if these attract.

    So do those on curves of fixed points across these.
    """
    points = distinct_points(flow, newton_ends(flow, box, ends), box)
    is_beside = [bool((np.abs((ends - point) / box.widths).max(axis=1) < 0.01).any()) for point in points]
    points = points[np.array(is_beside, dtype=bool) & ~box.contains(points, 1e-6)]
    along = tangents(flow, points, box)
    rests = [classified(flow, point, box, directions) for point, directions in zip(points, along, strict=True)]
    return [rest for rest in rests if rest.attracts_in_box]


def _is_at_rest(end: FloatArray, fixed: Sequence[FixedPoint], box: Box) -> bool:
    for point in fixed:
        near = SMALLEST
        if point.attracts_in_box:  # along an eigenvalue of 0 it is approached slowly
            near = 10.0 * (_SLOWLY if point.kind == NON_HYPERBOLIC else SMALLEST)
        if np.abs((end - point.point) / box.widths).max() < near:
            return True
    return False


def distance(cycle: LimitCycle, points: FloatArray, box: Box) -> FloatArray:
    """Return how far points (N, D) are from a cycle (N,), in widths of the box: from the polygon of its samples."""
    corners = cycle.points / box.widths
    sides = np.roll(corners, -1, axis=0) - corners
    beside = points[:, None] / box.widths - corners
    lengths = np.maximum((sides**2).sum(axis=1), 1e-300)
    share = np.clip((beside * sides).sum(axis=2) / lengths, 0.0, 1.0)
    return np.asarray(np.sqrt(((beside - share[:, :, None] * sides) ** 2).sum(axis=2)).min(axis=1))


def _first_return(flow: Flow, start: FloatArray, box: Box, longest: float) -> float | None:
    """Return the time of the nearest early return to the section through `start` across the flow; None: no near one."""
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
    if farthest < SMALLEST or nearest > _NEAR * min(farthest, 1.0):
        return None
    return next(time for time, far in returns if far <= 3.0 * nearest + 1e-5)


def _closed_orbit(flow: Flow, start: FloatArray, period: float, box: Box) -> LimitCycle | None:
    """Return the closed orbit that Newton steps reach from a guess of point and period; None where they do not."""
    point, size = start.copy(), flow.size
    phase = period * flow.rates(start) / box.widths
    for round_ in range(12):
        end, monodromy, log_multiplier_product = transported(flow, point, period, box)
        missed = (end - point) / box.widths
        if not np.isfinite(monodromy).all() or not np.isfinite(end).all():
            return None
        if np.abs(missed).max() < _CLOSED:
            break
        if round_ >= 5 and np.abs(missed).max() > 1e-2:
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
    if not cycle.is_isolated:  # of a family each course is one, and a small one that shrinks slowly misses little
        return cycle if miss <= _CLOSED * max(extent, _SMALL) else None
    return cycle if miss / np.abs(cycle.multipliers[1:] - 1.0).min() <= _KNOWN * extent else None


def transported(flow: Flow, start: FloatArray, duration: float, box: Box) -> tuple[FloatArray, FloatArray, float]:
    """Return where `start` (D,) is after `duration`, the derivative of that by `start` (D, D), and the divergence.

    The derivative is in widths of the box. The divergence, integrated over `duration`, is the logarithm of the
    derivative's determinant. NaN where the course cannot be followed.
    """
    size = flow.size

    def rates(y: FloatArray) -> FloatArray:
        matrix = jacobian_in_widths(flow, y[:size], box)
        return np.concatenate(
            [flow.rates(y[:size]), (matrix @ y[size:-1].reshape(size, size)).ravel(), [np.trace(matrix)]]
        )

    sizes = np.concatenate([box.widths, np.ones(size * size + 1)])
    whole = list(steps(rates, np.concatenate([start, np.eye(size).ravel(), [0.0]]), duration, sizes))
    if not whole or whole[-1].after < duration * (1.0 - 1e-12):
        return np.full(size, np.nan), np.full((size, size), np.nan), np.nan
    end = whole[-1].end
    return end[:size], end[size:-1].reshape(size, size), float(end[-1])


def multipliers_of(monodromy: FloatArray, log_multiplier_product: float) -> Complexes:
    """Return the eigenvalues, that of the flow first, then by falling size."""
    if len(monodromy) == 2:
        return np.array([1.0, np.exp(min(log_multiplier_product, 700.0))], dtype=np.complex128)
    values = np.linalg.eigvals(monodromy).astype(np.complex128)
    own = int(np.argmin(np.abs(values - 1.0)))
    others = np.delete(values, own)
    return np.concatenate([values[own : own + 1], others[np.argsort(-np.abs(others), kind="stable")]])
