"""The curve of limit cycles in (orbit, log period, parameter): Newton steps, tangents, and tests for special points.

An orbit is solved for by collocation, its phase fixed by the integral condition (Doedel, Keller and Kernévez 1991).
Letters: D states, N intervals, M Gauss points.
"""

from dataclasses import dataclass
from itertools import combinations
from typing import Final

import numpy as np

from atoll.analysis.box import Box
from atoll.analysis.collocation import NODES, WEIGHTS, Change, Linearised, Orbit, sampled, spread_mesh
from atoll.analysis.continuation import OUTSIDE
from atoll.analysis.continuation_parameter import ContinuationParameter
from atoll.analysis.flow import Flow
from atoll.analysis.limit_cycles import SAMPLES, SMALLEST, LimitCycle, multipliers_of
from atoll.analysis.path_following import BRANCH_POINT, FOLD, CurvePoint
from atoll_core.data.dataset import FloatArray

MOST_CYCLES: Final = 150
"""Cycles of one branch in each direction."""

LONGEST: Final = 0.05
"""Longest step along a branch, in ranges of parameter and box and in parts of the period."""

LONGEST_PERIOD: Final = 100.0
"""Times the first period of a branch, beyond which it is not followed: beside a homoclinic orbit periods grow without
bounds."""

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
class CycleProblem:
    """Limit cycles of a `flow` as `parameter` goes over `bounds`; the widths of `box` scale the states."""

    flow: Flow
    box: Box
    parameter: ContinuationParameter
    bounds: tuple[float, float]


@dataclass(frozen=True, eq=False)
class CycleOnCurve(CurvePoint):
    """A limit cycle as a point of a curve: its `orbit` over widths of the box, `period` and linearised equations."""

    orbit: Orbit
    period: float
    linearised: Linearised


class CycleCurve:
    """Cycles in coordinates z: states of the orbit over widths, logarithm of the period, parameter over its range.

    States are weighed so that their part of a step's length is the root of their mean square over the mesh.
    """

    longest = LONGEST
    most = MOST_CYCLES

    def __init__(self, problem: CycleProblem, orbit: Orbit, period: float, *, doublings: int = 0) -> None:
        """`orbit` has the mesh and gives the phase at first, `period` is that with which the branch begins."""
        self.flow, self.box, self.parameter, bounds = problem.flow, problem.box, problem.parameter, problem.bounds
        self.doublings = doublings
        self._longest_period = float(np.log(LONGEST_PERIOD * period))
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
        """Fix the phase of cycles by an orbit r on the same mesh: the mean of (x - r) times r' is 0."""
        times = orbit.mesh[:-1, None] + orbit.lengths[:, None] * NODES
        step = 1e-5 * orbit.lengths[:, None]
        slopes = orbit.at((times + step).ravel()) - orbit.at((times - step).ravel())
        slopes = slopes.reshape(orbit.nodes.shape) / (2.0 * step[..., None])
        weighed = slopes * (orbit.lengths[:, None] * WEIGHTS)[..., None]
        self._reference, self._phase = orbit.nodes, Change(np.zeros_like(orbit.mesh_states), weighed, 0.0, 0.0)

    # ------------------------------------------------------------------------------------------- coordinates

    def z_of(self, orbit: Orbit, period: float, value: float) -> FloatArray:
        """Return the coordinates of a cycle."""
        states = np.concatenate([orbit.mesh_states.ravel(), orbit.nodes.ravel()]) * self._weights
        return np.append(states, [np.log(period), value / self.range])

    def _split(self, states: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the states at the mesh (N, D) and nodes (N, M, D)."""
        return states[: self._number].reshape(-1, self._shape[2]), states[self._number :].reshape(self._shape)

    def _orbit(self, z: FloatArray) -> Orbit:
        return Orbit(self._mesh, *self._split(z[:-2] / self._weights))

    def _row(self, z: FloatArray) -> Change:
        """Return the row of the linear system that is the product with `z`."""
        return Change(*self._split(z[:-2] * self._weights), float(z[-2]), float(z[-1]))

    def _z_change(self, change: Change) -> FloatArray:
        states = np.concatenate([change.mesh_states.ravel(), change.nodes.ravel()]) * self._weights
        return np.append(states, [change.log_period, change.parameter])

    def value(self, z: FloatArray) -> float:
        """Return the value of the parameter."""
        return float(z[-1] * self.range)

    def _linearised(self, z: FloatArray) -> Linearised | None:
        flow, orbit, widths = self.parameter.at(self.flow, self.value(z)), self._orbit(z), self.box.widths
        x = orbit.nodes.reshape(-1, self._shape[2]) * widths
        by_states = flow.jacobian(x) * widths / widths[:, None]
        rates = (flow.rates(x) / widths, by_states, self.parameter.slope(flow, x) / widths * self.range)
        is_known = all(np.isfinite(array).all() for array in rates)
        return Linearised(orbit, float(np.exp(z[-2])), *rates) if is_known else None

    # ------------------------------------------------------------------------------------------- as a curve

    def correct(self, z: FloatArray, tangent: FloatArray) -> FloatArray | None:
        guess, row = z.copy(), self._row(tangent)
        for _ in range(_NEWTON):
            if abs(guess[-2] - z[-2]) > 1.0:
                return None
            linearised = self._linearised(guess)
            if linearised is None:
                return None
            missed = float((self._phase.nodes * (self._orbit(guess).nodes - self._reference)).sum())
            rows, left = (self._phase, row), (-missed, -float(tangent @ (guess - z)))
            try:
                change = linearised.solve(linearised.matrix(rows), rows, left, is_step=True)
            except np.linalg.LinAlgError:
                return None
            step = self._z_change(change)
            guess = guess + step
            if not np.isfinite(guess).all():
                return None
            if np.abs(step).max() < 1e-10:
                return guess
        return guess if np.abs(step).max() < 1e-7 else None

    def curve_point(self, z: FloatArray, before: FloatArray) -> CycleOnCurve | None:
        linearised = self._linearised(z)
        if linearised is None:
            return None
        rows = (self._phase, self._row(before))
        try:
            factors = linearised.matrix(rows)
            tangent = self._z_change(linearised.solve(factors, rows, (0.0, 1.0), is_step=False))
        except np.linalg.LinAlgError:
            return None
        tangent = tangent / np.sqrt(tangent @ tangent)
        if not np.isfinite(tangent).all():
            return None
        # the tangent goes on in the direction of `before`: with its row the determinant has the same sign
        tests = {FOLD: float(tangent[-1]), BRANCH_POINT: factors.scaled_determinant}
        tests |= _multiplier_tests(linearised.monodromy)
        return CycleOnCurve(z, tangent, tests, self._orbit(z), float(np.exp(z[-2])), linearised)

    def end(self, last: CycleOnCurve, after: CycleOnCurve) -> str | None:
        if not self.box.contains(after.orbit.nodes.reshape(-1, self._shape[2]) * self.box.widths, OUTSIDE).all():
            return "outside the box"
        first, second = (point.orbit.nodes - _mean(point.orbit) for point in (last, after))
        if float((first * second).sum()) <= 0.0 or np.abs(second).max() < 0.5 * SMALLEST:
            return HOPF_END  # the cycle shrinks to a point, beyond which come the same cycles half a turn later
        if self.doublings:
            first, second = (_unlike_halves(point.orbit) for point in (last, after))
            if float((first * second).sum()) <= 0.0:
                return PERIOD_DOUBLING  # the same again: beyond it come the same cycles half a period later
        return "period without bounds" if after.z[-2] > self._longest_period else None

    def adapt(self, point: CycleOnCurve) -> CycleOnCurve:
        self._steps += 1
        if self._steps % _RENEWED:
            self._set_phase(point.orbit)
            return point
        kept = self._mesh, self._reference, self._phase
        mesh = spread_mesh(point.orbit)
        orbit = sampled(point.orbit.at, mesh)
        along = sampled(Orbit(point.orbit.mesh, *self._split(point.tangent[:-2] / self._weights)).at, mesh)
        tangent = self._z_change(Change(along.mesh_states, along.nodes, *point.tangent[-2:].tolist()))
        self._mesh = mesh
        self._set_phase(orbit)
        z = self.correct(self.z_of(orbit, point.period, self.value(point.z)), tangent / np.sqrt(tangent @ tangent))
        moved = None if z is None else self.curve_point(z, tangent)
        if moved is None:
            self._mesh, self._reference, self._phase = kept
        return moved or point

    def cycle(self, point: CycleOnCurve) -> LimitCycle:
        """Return a curve point as a limit cycle."""
        points = point.orbit.at(np.arange(SAMPLES) / SAMPLES) * self.box.widths
        multipliers = multipliers_of(point.linearised.monodromy, point.linearised.log_multiplier_product)
        return LimitCycle(points[0], point.period, multipliers, point.linearised.log_multiplier_product, points)


def _mean(orbit: Orbit) -> FloatArray:
    return np.asarray(np.einsum("n,k,nkd->d", orbit.lengths, WEIGHTS, orbit.nodes))


def _unlike_halves(orbit: Orbit) -> FloatArray:
    """Return by how much the states (N, D) differ from those half a period later."""
    times = np.linspace(0.0, 0.5, len(orbit.mesh_states), endpoint=False)
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
