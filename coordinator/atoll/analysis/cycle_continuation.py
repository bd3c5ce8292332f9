"""Limit cycles as one parameter varies: branches from Hopf points and from cycles that are known.

Cycles are followed by pseudo-arclength in (orbit, log period, parameter), the orbit by collocation, with the integral
phase condition (Doedel, Keller and Kernévez 1991). A fold is where the tangent turns back in the parameter; at a period
doubling a Floquet multiplier passes -1, at a torus point a complex pair the unit circle, at a branch point another one
passes 1 (Kuznetsov 2004, sections 5.3 and 10.3). Letters: D states, N intervals, M Gauss points, n cycles.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from typing import Final

import numpy as np

from atoll.analysis.box import Box
from atoll.analysis.collocation import (
    INTERVALS,
    NODES,
    WEIGHTS,
    Change,
    Linearised,
    Orbit,
    Rates,
    levelled,
    sampled,
    spread_mesh,
)
from atoll.analysis.continuation import HOPF, OUTSIDE, Branch, SpecialPoint
from atoll.analysis.fixed_points import Complexes
from atoll.analysis.flow import Flow, follow
from atoll.analysis.limit_cycles import SAMPLES, SMALLEST, LimitCycle, distance, multipliers_of
from atoll.analysis.path_following import BRANCH_POINT, FOLD, Place, Side, followed
from atoll.analysis.varied import Varied
from atoll_core.data.dataset import FloatArray

MOST_CYCLES: Final = 150
"""Cycles of one branch in each direction."""

MOST_BRANCHES: Final = 10
"""Branches that are shown; each costs up to two seconds."""

LONGEST: Final = 0.05
"""Longest step along a branch, in ranges of parameter and box and in parts of the period."""

LONGEST_PERIOD: Final = 100.0
"""Times the first period of a branch, beyond which it is not followed: beside a homoclinic orbit periods grow without
bounds."""

MOST_DOUBLINGS: Final = 2
"""How often branches are followed that begin at a period doubling: up to four times the first period."""

PERIOD_DOUBLING: Final = "period doubling"
TORUS: Final = "torus"
HOPF_END: Final = "Hopf point"

_NEWTON: Final = 8
"""Newton steps double the digits that are right: a guess good to 1 % needs four."""

_KNOWN: Final = 1e-3
"""By which the multiplier of the flow may differ from 1; it does beside homoclinic orbits, whose other ones are beyond
the digits of the monodromy matrix."""

_RENEWED: Final = 4
"""Steps after which the mesh is laid anew."""


@dataclass(frozen=True, eq=False)
class SpecialCycle:
    """Where the character of a branch changes: `kind` is fold, branch point, period doubling or torus."""

    kind: str
    value: float
    cycle: LimitCycle


@dataclass(frozen=True, eq=False)
class CycleBranch:
    """`cycles` at `values` (n,) of the parameter; `ends` say why it is not followed beyond the first and the last."""

    values: FloatArray
    cycles: tuple[LimitCycle, ...]
    special: tuple[SpecialCycle, ...]
    ends: tuple[str, str]


@dataclass(frozen=True, eq=False)
class _Cycle(Place):
    orbit: Orbit
    period: float
    linearised: Linearised


class _CycleCurve:
    """Cycles in coordinates z: states of the orbit over widths, logarithm of the period, parameter over its range.

    States are weighed so that their part of a step's length is the root of their mean square over the mesh.
    """

    longest = LONGEST
    most = MOST_CYCLES

    def __init__(self, search: "_Search", orbit: Orbit, period: float, *, doublings: int = 0) -> None:
        """`orbit` has the mesh and gives the phase at first, `period` is that with which the branch begins."""
        self.flow, self.box, self.varied, self.bounds = search.flow, search.box, search.varied, search.bounds
        self.doublings = doublings
        self._longest_period = float(np.log(LONGEST_PERIOD * period))
        bounds = self.bounds
        self.range = bounds[1] - bounds[0]
        self.limits = (bounds[0] / self.range, bounds[1] / self.range)
        count, number, size = orbit.nodes.shape
        self._weights = np.sqrt(
            np.concatenate([np.full(count * size, 0.5 / count), np.tile(np.repeat(0.5 * WEIGHTS / count, size), count)])
        )
        self._shape, self._number = (count, number, size), count * size
        self._mesh = orbit.mesh
        self._steps = 0
        self._set_phase(orbit)

    def _set_phase(self, orbit: Orbit) -> None:
        """Fix the phase of cycles by that of an orbit on the same mesh: the mean of (x - its x) times its x' is 0."""
        times = orbit.mesh[:-1, None] + orbit.lengths[:, None] * NODES
        step = 1e-5 * orbit.lengths[:, None]
        slopes = orbit.at((times + step).ravel()) - orbit.at((times - step).ravel())
        slopes = slopes.reshape(orbit.nodes.shape) / (2.0 * step[..., None])
        self._reference = orbit.nodes
        self._phase = slopes * (orbit.lengths[:, None] * WEIGHTS)[..., None]

    # ------------------------------------------------------------------------------------------- coordinates

    def z_of(self, orbit: Orbit, period: float, value: float) -> FloatArray:
        """Return the coordinates of a cycle."""
        states = np.concatenate([orbit.begins.ravel(), orbit.nodes.ravel()]) * self._weights
        return np.append(states, [np.log(period), value / self.range])

    def _split(self, states: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return begins (N, D) and nodes (N, M, D)."""
        return states[: self._number].reshape(-1, self._shape[2]), states[self._number :].reshape(self._shape)

    def _orbit(self, z: FloatArray) -> Orbit:
        return Orbit(self._mesh, *self._split(z[:-2] / self._weights))

    def _row(self, z: FloatArray) -> Change:
        """Return the row of the linear system that is the product with `z`."""
        return Change(*self._split(z[:-2] * self._weights), float(z[-2]), float(z[-1]))

    def _z_change(self, change: Change) -> FloatArray:
        states = np.concatenate([change.begins.ravel(), change.nodes.ravel()]) * self._weights
        return np.append(states, [change.log_period, change.parameter])

    def value(self, z: FloatArray) -> float:
        """Return the value of the parameter."""
        return float(z[-1] * self.range)

    def _linearised(self, z: FloatArray) -> Linearised | None:
        flow, orbit, widths = self.varied.at(self.flow, self.value(z)), self._orbit(z), self.box.widths
        x = orbit.nodes.reshape(-1, self._shape[2]) * widths
        by_states = flow.jacobian(x) * widths / widths[:, None]
        rates = Rates(flow.rates(x) / widths, by_states, self.varied.slope(flow, x) / widths * self.range)
        is_known = all(np.isfinite(each).all() for each in (rates.values, rates.by_states, rates.by_parameter))
        return Linearised(orbit, float(np.exp(z[-2])), rates) if is_known else None

    def _phase_row(self) -> Change:
        return Change(np.zeros((self._shape[0], self._shape[2])), self._phase, 0.0, 0.0)

    # ------------------------------------------------------------------------------------------- as a curve

    def corrected(self, z: FloatArray, tangent: FloatArray) -> FloatArray | None:
        guess, row = z.copy(), self._row(tangent)
        for _ in range(_NEWTON):
            if abs(guess[-2] - z[-2]) > 1.0:
                return None
            its = self._linearised(guess)
            if its is None:
                return None
            missed = float((self._phase * (self._orbit(guess).nodes - self._reference)).sum())
            rows, left = (self._phase_row(), row), (-missed, -float(tangent @ (guess - z)))
            try:
                change = its.solved(its.matrix(rows), rows, left, is_step=True)
            except np.linalg.LinAlgError:
                return None
            step = self._z_change(change)
            guess = guess + step
            if not np.isfinite(guess).all():
                return None
            if np.abs(step).max() < 1e-10:
                return guess
        return guess if np.abs(step).max() < 1e-7 else None

    def place(self, z: FloatArray, before: FloatArray) -> _Cycle | None:
        its = self._linearised(z)
        if its is None:
            return None
        rows = (self._phase_row(), self._row(before))
        try:
            factors = its.matrix(rows)
            tangent = self._z_change(its.solved(factors, rows, (0.0, 1.0), is_step=False))
        except np.linalg.LinAlgError:
            return None
        tangent = tangent / np.sqrt(tangent @ tangent)
        if not np.isfinite(tangent).all():
            return None
        # the tangent goes on in the direction of `before`: with its row the determinant has the same sign
        tests = {FOLD: float(tangent[-1]), BRANCH_POINT: factors.scaled_determinant}
        tests |= _multiplier_tests(its.monodromy)
        return _Cycle(z, tangent, tests, self._orbit(z), float(np.exp(z[-2])), its)

    def end(self, last: _Cycle, after: _Cycle) -> str | None:
        if not self.box.contains(after.orbit.nodes.reshape(-1, self._shape[2]) * self.box.widths, OUTSIDE).all():
            return "outside the box"
        first, second = (each.orbit.nodes - _mean(each.orbit) for each in (last, after))
        if float((first * second).sum()) <= 0.0 or np.abs(second).max() < 0.5 * SMALLEST:
            return HOPF_END  # the cycle shrinks to a point, beyond which come the same cycles half a turn later
        if self.doublings:
            first, second = (_unlike_halves(each.orbit) for each in (last, after))
            if float((first * second).sum()) <= 0.0:
                return PERIOD_DOUBLING  # the same again: beyond it come the same cycles half a period later
        return "period without bounds" if after.z[-2] > self._longest_period else None

    def renewed(self, place: _Cycle) -> _Cycle:
        self._steps += 1
        if self._steps % _RENEWED:
            self._set_phase(place.orbit)
            return place
        return self.on_mesh(place, spread_mesh(place.orbit)) or place

    def on_mesh(self, place: _Cycle, mesh: FloatArray) -> _Cycle | None:
        """Return a place on another mesh, that of the curve from now on; None, and the mesh as it was, on failure."""
        kept = self._mesh, self._reference, self._phase
        orbit = place.orbit.on(mesh)
        along = Orbit(place.orbit.mesh, *self._split(place.tangent[:-2] / self._weights)).on(mesh)
        tangent = self._z_change(Change(along.begins, along.nodes, *place.tangent[-2:].tolist()))
        self._mesh = mesh
        self._set_phase(orbit)
        z = self.corrected(self.z_of(orbit, place.period, self.value(place.z)), tangent / np.sqrt(tangent @ tangent))
        found = None if z is None else self.place(z, tangent)
        if found is None:
            self._mesh, self._reference, self._phase = kept
        return found

    def cycle(self, place: _Cycle) -> LimitCycle:
        """Return a place as a limit cycle."""
        points = place.orbit.at(np.arange(SAMPLES) / SAMPLES) * self.box.widths
        found = multipliers_of(place.linearised.monodromy, place.linearised.divergence)
        return LimitCycle(points[0], place.period, found, place.linearised.divergence, points)


def _mean(orbit: Orbit) -> FloatArray:
    return np.asarray(np.einsum("n,k,nkd->d", orbit.lengths, WEIGHTS, orbit.nodes))


def _unlike_halves(orbit: Orbit) -> FloatArray:
    """Return by how much the states (N, D) differ from those half a period later."""
    times = np.linspace(0.0, 0.5, len(orbit.begins), endpoint=False)
    return orbit.at(times) - orbit.at(times + 0.5)


def _multiplier_tests(monodromy: FloatArray) -> dict[str, float]:
    """Return what vanishes where multipliers pass -1, and where a pair of them has the product 1.

    NaN where that of the flow, which is 1, is off by so much that the others are not known either.
    """
    if len(monodromy) == 2:  # that beside the flow's is positive in the plane
        return {PERIOD_DOUBLING: np.nan, TORUS: np.nan}
    own, *others = multipliers_of(monodromy, 0.0)
    values = np.array(others) if abs(own - 1.0) < _KNOWN else np.full(len(others), np.nan + 0j)
    doubling = np.prod(values + 1.0)
    torus = np.prod([first * second - 1.0 for first, second in combinations(values, 2)]) if len(values) > 1 else 1.0
    return {PERIOD_DOUBLING: float(np.real(doubling)), TORUS: float(np.real(torus))}


def cycle_continuation(
    flow: Flow,
    box: Box,
    varied: Varied,
    bounds: tuple[float, float],
    *,
    branches: Sequence[Branch] = (),
    known: Sequence[tuple[float, LimitCycle]] = (),
) -> tuple[CycleBranch, ...]:
    """Return the branches of limit cycles as what is `varied` goes over `bounds`.

    Args:
        flow: the system.
        box: its widths scale the states; cycles that leave it by more than a width are not followed.
        varied: what varies.
        bounds: over which range.
        branches: of fixed points; cycles begin at their Hopf points.
        known: cycles with the value of the parameter at which they are; branches begin at these as well.
    """
    search = _Search(flow, box, varied, bounds)
    found: list[CycleBranch] = []
    for branch in branches:
        for special in branch.special:
            if special.kind == HOPF and not _ends_at(found, special, box, bounds):
                found += search.from_hopf(special, MOST_BRANCHES - len(found))
    for value, cycle in known:
        if not any(_passes(each, value, cycle, box) for each in found):
            found += search.from_cycle(value, cycle, MOST_BRANCHES - len(found))
    return tuple(found)


def _ends_at(found: Sequence[CycleBranch], special: SpecialPoint, box: Box, bounds: tuple[float, float]) -> bool:
    """Tell whether a branch ends, or begins, at a Hopf point."""
    for branch in found:
        for end, at in zip(branch.ends, (0, -1), strict=True):
            middle = branch.cycles[at].points.mean(axis=0)
            near = np.abs((middle - special.point) / box.widths).max() < 2.0 * LONGEST
            if end == HOPF_END and near and abs(branch.values[at] - special.value) < 2.0 * LONGEST * np.diff(bounds):
                return True
    return False


def _passes(branch: CycleBranch, value: float, cycle: LimitCycle, box: Box) -> bool:
    """Tell whether a branch has a cycle, as far as its cycles are near enough to tell."""
    for (left, first), (right, second) in pairwise(zip(branch.values.tolist(), branch.cycles, strict=True)):
        if min(left, right) <= value <= max(left, right):
            for each in (first, second):
                apart = float(distance(each, cycle.points[::20], box).max())
                if apart < 2.0 * LONGEST and abs(np.log(each.period / cycle.period)) < 2.0 * LONGEST:
                    return True
    return False


@dataclass(frozen=True, eq=False)
class _Search:
    """Branches of cycles of a flow; `most` bounds how many a start may give, with those that begin at its doublings."""

    flow: Flow
    box: Box
    varied: Varied
    bounds: tuple[float, float]

    def from_hopf(self, special: SpecialPoint, most: int) -> list[CycleBranch]:
        """Return the branch that begins at a Hopf point: at first an ellipse around it in the plane of the pair."""
        assert special.frequency is not None
        widths = self.box.widths
        jacobian = self.varied.at(self.flow, special.value).jacobian(special.point) * widths / widths[:, None]
        values, vectors = np.linalg.eig(jacobian)
        vector = vectors[:, int(np.argmin(np.abs(values - 1j * special.frequency)))]
        mesh = np.linspace(0.0, 1.0, INTERVALS + 1)
        middle = sampled(lambda times: np.tile(special.point / widths, (len(times), 1)), mesh)
        ellipse = sampled(lambda times: np.real(vector * np.exp(2j * np.pi * times)[:, None]), mesh)
        period = 2.0 * np.pi / special.frequency
        curve = _CycleCurve(self, ellipse, period)
        return self._begun(
            curve, curve.z_of(middle, period, special.value), curve.z_of(ellipse, 1.0, 0.0), HOPF_END, most
        )

    def from_cycle(self, value: float, cycle: LimitCycle, most: int) -> list[CycleBranch]:
        """Return the branch through a cycle, followed to both sides."""
        widths = self.box.widths
        moved = np.sqrt((np.diff(np.vstack([cycle.points, cycle.points[:1]]) / widths, axis=0) ** 2).sum(axis=1))
        mesh = levelled(np.linspace(0.0, 1.0, len(moved) + 1), moved / moved.sum() + 1.0 / len(moved))
        its = self.varied.at(self.flow, value)
        orbit = sampled(lambda times: follow(its, cycle.point, cycle.period * times, widths) / widths, mesh)
        sides: list[Side[_Cycle]] = []
        for sign in (-1.0, 1.0):
            curve = _CycleCurve(self, orbit, cycle.period)
            z = curve.z_of(orbit, cycle.period, value)
            direction = np.append(np.zeros(len(z) - 1), sign)
            start = curve.corrected(z, direction) if np.isfinite(z).all() else None
            if start is None:
                return []
            sides.append(followed(curve, start, direction))
        return self._joined(curve, sides[0], sides[1], most)

    def from_doubling(self, curve: _CycleCurve, place: _Cycle, most: int) -> list[CycleBranch]:
        """Return the branch of twice the period that begins at a period doubling of another one."""
        values, vectors = np.linalg.eig(place.linearised.monodromy)
        begins, nodes = place.linearised.along(np.real(vectors[:, int(np.argmin(np.abs(values + 1.0)))]))
        orbit, mesh = place.orbit, np.append(0.5 * place.orbit.mesh[:-1], 0.5 + 0.5 * place.orbit.mesh)
        twice = Orbit(mesh, np.tile(orbit.begins, (2, 1)), np.tile(orbit.nodes, (2, 1, 1)))
        turned = Orbit(mesh, np.vstack([begins, -begins]), np.vstack([nodes, -nodes]))
        doubled = _CycleCurve(self, twice, 2.0 * place.period, doublings=curve.doublings + 1)
        z = doubled.z_of(twice, 2.0 * place.period, curve.value(place.z))
        return self._begun(doubled, z, doubled.z_of(turned, 1.0, 0.0), PERIOD_DOUBLING, most)

    def _begun(
        self, curve: _CycleCurve, z: FloatArray, direction: FloatArray, origin: str, most: int
    ) -> list[CycleBranch]:
        """Return the branch that leaves `z` in a direction; what lies behind is the same half a turn later."""
        direction = direction / np.sqrt(direction @ direction)
        start = curve.corrected(z + 0.25 * LONGEST * direction, direction) if most > 0 else None
        if start is None:
            return []
        return self._joined(curve, Side([], [], origin), followed(curve, start, direction), most)

    def _joined(self, curve: _CycleCurve, behind: Side[_Cycle], ahead: Side[_Cycle], most: int) -> list[CycleBranch]:
        """Return the branch of two sides, and those that begin at its period doublings."""
        places = [*behind.places[:0:-1], *ahead.places]
        if len(places) < 2 or most < 1:
            return []
        special = [each for each in (*reversed(behind.special), *ahead.special) if _is_real(*each)]
        found = [
            CycleBranch(
                np.array([curve.value(each.z) for each in places]),
                tuple(curve.cycle(each) for each in places),
                tuple(SpecialCycle(kind, curve.value(each.z), curve.cycle(each)) for kind, each in special),
                (behind.end, ahead.end),
            )
        ]
        for kind, place in special:
            if kind == PERIOD_DOUBLING and curve.doublings < MOST_DOUBLINGS:
                found += self.from_doubling(curve, place, most - len(found))
        return found


def _is_real(kind: str, place: _Cycle) -> bool:
    """Tell whether a pair of multipliers with the product 1 is complex: two real ones make no torus."""
    if kind != TORUS:
        return True
    values: Complexes = multipliers_of(place.linearised.monodromy, 0.0)[1:]
    first, _ = min(combinations(values, 2), key=lambda pair: abs(pair[0] * pair[1] - 1.0))
    return bool(abs(first.imag) > 1e-6)
