"""Branches of limit cycles as one parameter varies, from Hopf points and from known cycles.

An orbit is the solution of a boundary value problem, found by collocation. Time runs from 0 to 1 along the orbit, and a
mesh divides this range into N intervals. On each interval the orbit is a polynomial that satisfies the equations at M
Gauss points. The error at the mesh falls with the power 2 M of the interval length (Ascher, Mattheij and Russell 1995,
section 5.4). The linear system of a Newton step is condensed to the states at the mesh, as in AUTO (Doedel, Keller and
Kernévez 1991). The product of the condensed matrices along the orbit is the monodromy matrix. An integral condition
fixes the phase (ibid.).

Branches are followed by pseudo-arclength in (orbit, log period, parameter). At a fold, the component of the tangent
along the parameter changes its sign. At a period doubling, a Floquet multiplier passes -1. At a torus point, a complex
pair passes the unit circle. At a branch point, another multiplier passes 1 (Kuznetsov 2004, sections 5.3 and 10.3).

Doubtful: near homoclinic orbits, rounding errors of the monodromy matrix exceed the nontrivial multipliers, so no test
is made there. Letters: D states, N intervals, M Gauss points, n cycles.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import combinations, pairwise
from typing import Final

import numpy as np
import numpy.typing as npt

from atoll.analysis.continuation import (
    BRANCH_POINT,
    FOLD,
    HOPF,
    OUTSIDE,
    Branch,
    ContinuationParameter,
    CurvePoint,
    CurveSide,
    SpecialPoint,
    continue_curve,
    join_sides,
)
from atoll.analysis.flow import Box, Flow, follow
from atoll.analysis.limit_cycles import SAMPLES, SMALLEST, LimitCycle, multipliers_of
from atoll_core.data.dataset import FloatArray

INTERVALS: Final = 80
"""Number of intervals of a mesh. It was chosen for canards of the FitzHugh-Nagumo model, where multipliers change by
powers of ten within 1e-8 of the parameter. With 80 intervals, the multipliers at folds are 1 with an error of 2e-3, and
period and fold have an error of 1e-9. 40 intervals are not enough."""

GAUSS_POINTS: Final = 4

_ROOTS, _ROOT_WEIGHTS = np.polynomial.legendre.leggauss(GAUSS_POINTS)
_NODES, _WEIGHTS = 0.5 * (_ROOTS + 1.0), 0.5 * _ROOT_WEIGHTS
"""Gauss points (M,) in (0, 1), and their weights (M,)."""

_POWERS: Final = np.arange(1, GAUSS_POINTS + 1)
_INTEGRALS: Final = _NODES[:, None] ** _POWERS / _POWERS @ np.linalg.inv(np.vander(_NODES, increasing=True))
"""The integrals (M, M) of the Lagrange polynomials from 0 to each Gauss point."""

_KNOTS: Final = np.append(0.0, _NODES)
"""Points (M + 1,) of an interval, from 0 to 1, at which a polynomial of degree M is known."""

_DIFFERENCES: Final = np.array([1.0 / np.prod(knot - np.delete(_KNOTS, at)) for at, knot in enumerate(_KNOTS)])
"""Weights (M + 1,) of the values at the knots for the divided difference of order M and barycentric interpolation."""

MOST_BRANCHES: Final = 10
"""Largest number of reported branches; each takes up to two seconds."""

MOST_DOUBLINGS: Final = 2
"""Largest number of consecutive period doublings that are followed: up to four times the first period."""

MOST_CYCLES: Final = 150
"""Largest number of cycles of one branch in each direction."""

LONGEST: Final = 0.05
"""Longest step along a branch, in ranges of the parameter, widths of the box, and shares of the period."""

_LONGEST_PERIOD: Final = 100.0
"""Longest period of a branch over its first period: near a homoclinic orbit, periods grow without bound."""

PERIOD_DOUBLING: Final = "period doubling"
TORUS: Final = "torus"
HOPF_END: Final = "Hopf point"

_MOST_NEWTON_STEPS: Final = 8
"""Largest number of Newton steps. A step doubles the number of correct digits: a guess with 1 % error needs four."""

_LARGEST_TRIVIAL_ERROR: Final = 1e-3
"""Largest error of the trivial multiplier, which is 1. If its error is larger, the other multipliers are not used."""

_MESH_STEPS: Final = 4
"""Number of steps after which the mesh is adapted."""


@dataclass(frozen=True, eq=False)
class SpecialCycle:
    """A cycle where the character of a branch changes: `kind` is fold, branch point, period doubling or torus."""

    kind: str
    value: float
    cycle: LimitCycle


@dataclass(frozen=True, eq=False)
class CycleBranch:
    """The n `cycles` at `values` (n,) of the parameter; `ends` are the reasons why the branch ends on both sides."""

    values: FloatArray = field(repr=False)
    cycles: tuple[LimitCycle, ...] = field(repr=False)
    special: tuple[SpecialCycle, ...]
    ends: tuple[str, str]


def cycle_continuation(
    flow: Flow,
    box: Box,
    parameter: ContinuationParameter,
    bounds: tuple[float, float],
    *,
    branches: Sequence[Branch] = (),
    known: Sequence[tuple[float, LimitCycle]] = (),
) -> tuple[CycleBranch, ...]:
    """Return the branches of limit cycles as `parameter` varies over `bounds`.

    They begin at the Hopf points of `branches` of fixed points, and at `known` pairs of a parameter value and a cycle.
    A branch ends if its cycles leave the box by more than a width.
    """
    search = _CycleSearch(flow, box, parameter, bounds)
    cycle_branches: list[CycleBranch] = []
    for branch in branches:
        for special in branch.special:
            if special.kind == HOPF and not _ends_at(cycle_branches, special, box, bounds):
                cycle_branches += search.from_hopf(special, MOST_BRANCHES - len(cycle_branches))
    for value, cycle in known:
        if not any(_passes(branch, value, cycle, box) for branch in cycle_branches):
            cycle_branches += search.from_cycle(value, cycle, MOST_BRANCHES - len(cycle_branches))
    return tuple(cycle_branches)


def _ends_at(branches: Sequence[CycleBranch], special: SpecialPoint, box: Box, bounds: tuple[float, float]) -> bool:
    for branch in branches:
        for end, at in zip(branch.ends, (0, -1), strict=True):
            middle = branch.cycles[at].points.mean(axis=0)
            near = np.abs((middle - special.point) / box.widths).max() < 2.0 * LONGEST
            if end == HOPF_END and near and abs(branch.values[at] - special.value) < 2.0 * LONGEST * np.diff(bounds):
                return True
    return False


def _passes(branch: CycleBranch, value: float, cycle: LimitCycle, box: Box) -> bool:
    """Tell whether a branch contains a cycle, from its cycles at the nearest values."""
    for (left, first), (right, second) in pairwise(zip(branch.values.tolist(), branch.cycles, strict=True)):
        if min(left, right) <= value <= max(left, right):
            for neighbour in (first, second):
                distance = float(neighbour.distances(cycle.points[::20], box).max())
                if distance < 2.0 * LONGEST and abs(np.log(neighbour.period / cycle.period)) < 2.0 * LONGEST:
                    return True
    return False


# -------------------------------------------------------------------------------------------------------- collocation


@dataclass(frozen=True, eq=False)
class Orbit:
    """A closed orbit on the times `mesh` (N + 1,) from 0 to 1.

    `mesh_states` (N, D) are the states at the beginning of each interval, `nodes` (N, M, D) at its Gauss points.
    """

    mesh: FloatArray
    mesh_states: FloatArray
    nodes: FloatArray

    @property
    def lengths(self) -> FloatArray:
        """The lengths (N,) of the intervals; their sum is 1."""
        return np.diff(self.mesh)

    @property
    def knots(self) -> FloatArray:
        """The states (N, M + 1, D) at the knots of each interval."""
        return np.concatenate([self.mesh_states[:, None], self.nodes], axis=1)

    def at(self, times: FloatArray) -> FloatArray:
        """Return the states (n, D) at times (n,) from 0 to 1, from the polynomial of each interval."""
        which = np.clip(np.searchsorted(self.mesh, times, side="right") - 1, 0, len(self.mesh) - 2)
        distance = ((times - self.mesh[which]) / self.lengths[which])[:, None] - _KNOTS
        distance = np.where(distance == 0.0, 1e-300, distance)
        shares = _DIFFERENCES / distance
        return np.asarray((shares[:, :, None] * self.knots[which]).sum(axis=1) / shares.sum(axis=1)[:, None])


def _sample(states: Callable[[FloatArray], FloatArray], mesh: FloatArray) -> Orbit:
    """Return the orbit of a function of times (n,) from 0 to 1 that returns states (n, D)."""
    times = mesh[:-1, None] + np.diff(mesh)[:, None] * _KNOTS
    values = states(times.ravel()).reshape(*times.shape, -1)
    return Orbit(mesh, values[:, 0].copy(), values[:, 1:].copy())


def _even_mesh(mesh: FloatArray, weight: FloatArray, intervals: int) -> FloatArray:
    """Return a mesh (`intervals` + 1,) of intervals with equal weight; `weight` (n,) belongs to `mesh` (n + 1,)."""
    total = np.append(0.0, np.cumsum(weight))
    even = np.interp(np.linspace(0.0, total[-1], intervals + 1), total, mesh)
    even[0], even[-1] = 0.0, 1.0
    return np.asarray(even)


@dataclass(frozen=True, eq=False)
class _OrbitChange:
    """Changes of the states at the mesh (N, D) and nodes (N, M, D), of the log period and of the parameter.

    The same class holds a row of the linear system: the factors of these changes.
    """

    mesh_states: FloatArray
    nodes: FloatArray
    log_period: float
    parameter: float


class _LUFactors:
    def __init__(self, rows: FloatArray, columns: FloatArray, values: FloatArray) -> None:
        from scipy.sparse import csc_matrix
        from scipy.sparse.linalg import splu

        size = int(rows.max()) + 1
        try:
            self._lu = splu(csc_matrix((values, (rows, columns)), shape=(size, size)))
        except RuntimeError as error:  # scipy's error for a pivot of 0
            raise np.linalg.LinAlgError(str(error)) from None

    def solve(self, right: FloatArray) -> FloatArray:
        return np.asarray(self._lu.solve(right))

    @property
    def scaled_determinant(self) -> float:
        """The sign of the determinant times the geometric mean of the pivots: it is 0 if the determinant is 0."""
        pivots = self._lu.U.diagonal()
        sign = np.prod(np.sign(pivots)) * _parity(self._lu.perm_r) * _parity(self._lu.perm_c)
        return float(sign * np.exp(np.log(np.maximum(np.abs(pivots), 1e-300)).mean()))


def _parity(permutation: npt.NDArray[np.int32]) -> int:
    """Return 1 for an even permutation of 0, 1, ... and -1 for an odd one."""
    order, parity = permutation.tolist(), 1
    for start in range(len(order)):
        while order[start] != start:  # each exchange puts one number in its place
            target = order[start]
            order[start], order[target] = order[target], target
            parity = -parity
    return parity


class Linearised:
    """The linearised equations of an orbit. They give Newton steps, tangents and multipliers."""

    def __init__(
        self, orbit: Orbit, period: float, rates: FloatArray, by_states: FloatArray, by_parameter: FloatArray
    ) -> None:
        """Take the rates at the nodes (NM, D), their Jacobians (NM, D, D), and derivatives by the parameter (NM, D)."""
        count, number, size = orbit.nodes.shape
        spans = (period * orbit.lengths)[:, None, None]
        rates = rates.reshape(count, number, size)
        by_states = by_states.reshape(count, number, size, size)
        by_parameter = by_parameter.reshape(count, number, size)
        moved = spans * np.einsum("jk,nkd->njd", _INTEGRALS, rates)
        residuals = orbit.nodes - orbit.mesh_states[:, None] - moved
        matrix = -spans[..., None, None] * np.einsum("jk,nkde->njdke", _INTEGRALS, by_states)
        matrix = matrix.reshape(count, number * size, number * size) + np.eye(number * size)
        columns = np.empty((count, number, size, size + 3))
        columns[..., :size] = np.eye(size)
        columns[..., size] = moved
        columns[..., size + 1] = spans * np.einsum("jk,nkd->njd", _INTEGRALS, by_parameter)
        columns[..., size + 2] = -residuals
        solved = np.linalg.solve(matrix, columns.reshape(count, number * size, size + 3))
        self.inner = solved.reshape(count, number, size, size + 3)
        ends = spans * np.einsum("j,njde,njec->ndc", _WEIGHTS, by_states, self.inner)
        ends[..., :size] += np.eye(size)
        ends[..., size] += spans[:, 0] * (_WEIGHTS @ rates)
        ends[..., size + 1] += spans[:, 0] * (_WEIGHTS @ by_parameter)
        reached = orbit.mesh_states + spans[:, 0] * (_WEIGHTS @ rates)
        ends[..., size + 2] += reached - np.roll(orbit.mesh_states, -1, axis=0)
        self.ends = ends
        traces = np.einsum("njdd->nj", by_states)
        self.log_multiplier_product = float(period * (orbit.lengths * (traces @ _WEIGHTS)).sum())

    @property
    def monodromy(self) -> FloatArray:
        """The derivative (D, D) of the state after a period with respect to the initial state."""
        size = self.ends.shape[1]
        product = np.eye(size)
        for transfer in self.ends[..., :size]:
            product = transfer @ product
        return np.asarray(product)

    def along(self, begin: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the change `begin` (D,) along the linearised flow: at the mesh (N, D) and nodes (N, M, D)."""
        size, mesh_states = len(begin), [begin]
        for transfer in self.ends[:-1, :, :size]:
            mesh_states.append(transfer @ mesh_states[-1])
        carried = np.array(mesh_states)
        return carried, np.einsum("njde,ne->njd", self.inner[..., :size], carried)

    def factorise(self, rows: tuple[_OrbitChange, _OrbitChange]) -> _LUFactors:
        """Return the LU factors of the condensed system (ND + 2, ND + 2): the equations and two further rows."""
        count, size = self.ends.shape[:2]
        block = np.arange(count * size).reshape(count, size)
        places = [np.broadcast_to(block[:, :, None], (count, size, size)), block]
        columns = [np.broadcast_to(block[:, None, :], (count, size, size)), np.roll(block, -1, axis=0)]
        values = [self.ends[..., :size], np.full((count, size), -1.0)]
        for column in (size, size + 1):
            places.append(block)
            columns.append(np.full((count, size), count * size + column - size))
            values.append(self.ends[..., column])
        for number, row in enumerate(rows):
            by_inner = np.einsum("njd,njdc->nc", row.nodes, self.inner[..., : size + 2])
            last = [row.log_period + by_inner[:, size].sum(), row.parameter + by_inner[:, size + 1].sum()]
            places.append(np.full(count * size + 2, count * size + number))
            columns.append(np.arange(count * size + 2))
            values.append(np.append((row.mesh_states + by_inner[:, :size]).ravel(), last))
        return _LUFactors(*(np.concatenate([np.ravel(part) for part in parts]) for parts in (places, columns, values)))

    def solve(
        self, factors: _LUFactors, rows: tuple[_OrbitChange, _OrbitChange], right: tuple[float, float], *, is_step: bool
    ) -> _OrbitChange:
        """Solve the linear system `factors`; the right-hand sides of its two further `rows` are `right`.

        For a Newton step (`is_step`), the other right-hand sides are minus the residuals of the equations; for a
        tangent they are 0.
        """
        count, size = self.ends.shape[:2]
        share = 1.0 if is_step else 0.0
        constant = share * self.inner[..., size + 2]
        right_side = [value - float((row.nodes * constant).sum()) for row, value in zip(rows, right, strict=True)]
        solution = factors.solve(np.append(-share * self.ends[..., size + 2].ravel(), right_side))
        mesh_states = solution[:-2].reshape(count, size)
        log_period, parameter = float(solution[-2]), float(solution[-1])
        nodes = np.einsum("njde,ne->njd", self.inner[..., :size], mesh_states) + constant
        nodes += self.inner[..., size] * log_period + self.inner[..., size + 1] * parameter
        return _OrbitChange(mesh_states, nodes, log_period, parameter)


# -------------------------------------------------------------------------------------------------- the curve of cycles


@dataclass(frozen=True, eq=False)
class _CycleOnCurve(CurvePoint):
    """A limit cycle as a point of a curve: its `orbit` in widths of the box, `period` and linearised equations."""

    orbit: Orbit
    period: float
    linearised: Linearised


class _CycleCurve:
    """Cycles in coordinates z (N D + N M D + 2,): states in widths, logarithm of the period, parameter over its range.

    States have weights, so that their contribution to the length of a step is their root mean square over the orbit.
    """

    longest = LONGEST
    most = MOST_CYCLES

    def __init__(self, problem: "_CycleSearch", orbit: Orbit, period: float, *, doublings: int = 0) -> None:
        """Take the mesh and the first phase from `orbit`; `period` is the period at the beginning of the branch."""
        self.flow, self.box, self.parameter, bounds = problem.flow, problem.box, problem.parameter, problem.bounds
        self.doublings = doublings
        self._longest_period = float(np.log(_LONGEST_PERIOD * period))
        self.range = bounds[1] - bounds[0]
        self.limits = (bounds[0] / self.range, bounds[1] / self.range)
        count, number, size = orbit.nodes.shape
        by_nodes = np.tile(np.repeat(0.5 * _WEIGHTS / count, size), count)
        self._weights = np.sqrt(np.concatenate([np.full(count * size, 0.5 / count), by_nodes]))
        self._shape, self._number = (count, number, size), count * size
        self._mesh = orbit.mesh
        self._steps = 0
        self._set_phase(orbit)

    def _set_phase(self, orbit: Orbit) -> None:
        """Fix the phase of cycles x with an orbit r on the same mesh: the mean of (x - r) r' is 0."""
        times = orbit.mesh[:-1, None] + orbit.lengths[:, None] * _NODES
        step = 1e-5 * orbit.lengths[:, None]
        slopes = orbit.at((times + step).ravel()) - orbit.at((times - step).ravel())
        slopes = slopes.reshape(orbit.nodes.shape) / (2.0 * step[..., None])
        weighted = slopes * (orbit.lengths[:, None] * _WEIGHTS)[..., None]
        self._reference, self._phase = orbit.nodes, _OrbitChange(np.zeros_like(orbit.mesh_states), weighted, 0.0, 0.0)

    def z_of(self, orbit: Orbit, period: float, value: float) -> FloatArray:
        """Return the coordinates of a cycle."""
        states = np.concatenate([orbit.mesh_states.ravel(), orbit.nodes.ravel()]) * self._weights
        return np.append(states, [np.log(period), value / self.range])

    def value(self, z: FloatArray) -> float:
        """Return the value of the parameter."""
        return float(z[-1] * self.range)

    def _split(self, states: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the states at the mesh (N, D) and nodes (N, M, D)."""
        return states[: self._number].reshape(-1, self._shape[2]), states[self._number :].reshape(self._shape)

    def _orbit(self, z: FloatArray) -> Orbit:
        return Orbit(self._mesh, *self._split(z[:-2] / self._weights))

    def _row(self, z: FloatArray) -> _OrbitChange:
        """Return the row of the linear system for the scalar product with `z`."""
        return _OrbitChange(*self._split(z[:-2] * self._weights), float(z[-2]), float(z[-1]))

    def _z_change(self, change: _OrbitChange) -> FloatArray:
        states = np.concatenate([change.mesh_states.ravel(), change.nodes.ravel()]) * self._weights
        return np.append(states, [change.log_period, change.parameter])

    def _linearise(self, z: FloatArray) -> Linearised | None:
        flow, orbit, widths = self.parameter.at(self.flow, self.value(z)), self._orbit(z), self.box.widths
        x = orbit.nodes.reshape(-1, self._shape[2]) * widths
        by_states = flow.jacobian(x) * widths / widths[:, None]
        rates = (flow.rates(x) / widths, by_states, self.parameter.slope(flow, x) / widths * self.range)
        is_known = all(np.isfinite(array).all() for array in rates)
        return Linearised(orbit, float(np.exp(z[-2])), *rates) if is_known else None

    def correct(self, z: FloatArray, tangent: FloatArray) -> FloatArray | None:
        guess, row = z.copy(), self._row(tangent)
        for _ in range(_MOST_NEWTON_STEPS):
            if abs(guess[-2] - z[-2]) > 1.0:
                return None
            linearised = self._linearise(guess)
            if linearised is None:
                return None
            missed = float((self._phase.nodes * (self._orbit(guess).nodes - self._reference)).sum())
            rows, right = (self._phase, row), (-missed, -float(tangent @ (guess - z)))
            try:
                change = linearised.solve(linearised.factorise(rows), rows, right, is_step=True)
            except np.linalg.LinAlgError:
                return None
            step = self._z_change(change)
            guess = guess + step
            if not np.isfinite(guess).all():
                return None
            if np.abs(step).max() < 1e-10:
                return guess
        return guess if np.abs(step).max() < 1e-7 else None

    def curve_point(self, z: FloatArray, before: FloatArray) -> _CycleOnCurve | None:
        linearised = self._linearise(z)
        if linearised is None:
            return None
        rows = (self._phase, self._row(before))
        try:
            factors = linearised.factorise(rows)
            tangent = self._z_change(linearised.solve(factors, rows, (0.0, 1.0), is_step=False))
        except np.linalg.LinAlgError:
            return None
        tangent = tangent / np.sqrt(tangent @ tangent)
        if not np.isfinite(tangent).all():
            return None
        # the tangent points in the direction of `before`, so the determinant has the same sign with either row
        tests = {FOLD: float(tangent[-1]), BRANCH_POINT: factors.scaled_determinant}
        tests |= _multiplier_tests(linearised.monodromy)
        return _CycleOnCurve(z, tangent, tests, self._orbit(z), float(np.exp(z[-2])), linearised)

    def end(self, last: _CycleOnCurve, after: _CycleOnCurve) -> str | None:
        if not self.box.contains(after.orbit.nodes.reshape(-1, self._shape[2]) * self.box.widths, OUTSIDE).all():
            return "outside the box"
        first, second = (
            point.orbit.nodes - np.einsum("n,k,nkd->d", point.orbit.lengths, _WEIGHTS, point.orbit.nodes)
            for point in (last, after)
        )
        if float((first * second).sum()) <= 0.0 or np.abs(second).max() < 0.5 * SMALLEST:
            return HOPF_END  # the cycle has shrunk to a point; then the same cycles follow, shifted by half a turn
        if self.doublings:
            times = np.linspace(0.0, 0.5, self._shape[0], endpoint=False)
            first, second = (point.orbit.at(times) - point.orbit.at(times + 0.5) for point in (last, after))
            if float((first * second).sum()) <= 0.0:
                return PERIOD_DOUBLING  # then the same cycles follow, shifted by half a period
        return "period without bounds" if after.z[-2] > self._longest_period else None

    def adapt(self, point: _CycleOnCurve) -> _CycleOnCurve:
        self._steps += 1
        if self._steps % _MESH_STEPS:
            self._set_phase(point.orbit)
            return point
        kept = self._mesh, self._reference, self._phase
        # the error is proportional to the derivative of order M + 1: intervals get equal shares of this derivative
        lengths = point.orbit.lengths
        slopes = np.einsum("k,nkd->nd", _DIFFERENCES, point.orbit.knots) / lengths[:, None] ** GAUSS_POINTS
        jumps = np.abs(np.roll(slopes, -1, axis=0) - slopes) / (0.5 * (np.roll(lengths, -1) + lengths))[:, None]
        size = np.maximum(jumps, np.roll(jumps, 1, axis=0)).max(axis=1) ** (1.0 / (GAUSS_POINTS + 1))
        weight = (size + 0.1 * max(float((size * lengths).sum()), 1e-12)) * lengths  # every part keeps some intervals
        mesh = _even_mesh(point.orbit.mesh, weight, len(weight))
        orbit = _sample(point.orbit.at, mesh)
        along = _sample(Orbit(point.orbit.mesh, *self._split(point.tangent[:-2] / self._weights)).at, mesh)
        tangent = self._z_change(_OrbitChange(along.mesh_states, along.nodes, *point.tangent[-2:].tolist()))
        self._mesh = mesh
        self._set_phase(orbit)
        z = self.correct(self.z_of(orbit, point.period, self.value(point.z)), tangent / np.sqrt(tangent @ tangent))
        moved = None if z is None else self.curve_point(z, tangent)
        if moved is None:
            self._mesh, self._reference, self._phase = kept
        return moved or point

    def cycle(self, point: _CycleOnCurve) -> LimitCycle:
        """Return a curve point as a limit cycle."""
        points = point.orbit.at(np.arange(SAMPLES) / SAMPLES) * self.box.widths
        multipliers = multipliers_of(point.linearised.monodromy, point.linearised.log_multiplier_product)
        return LimitCycle(points[0], point.period, multipliers, point.linearised.log_multiplier_product, points)


def _multiplier_tests(monodromy: FloatArray) -> dict[str, float]:
    """Return a number that is 0 if a multiplier is -1, and a number that is 0 if two multipliers have the product 1.

    Both are NaN in the plane, where the nontrivial multiplier is always positive. Both are also NaN if the trivial
    multiplier is not 1, because the other multipliers are then not known either.
    """
    if len(monodromy) == 2:
        return {PERIOD_DOUBLING: np.nan, TORUS: np.nan}
    trivial, *others = multipliers_of(monodromy, 0.0)
    values = np.array(others) if abs(trivial - 1.0) < _LARGEST_TRIVIAL_ERROR else np.full(len(others), np.nan + 0j)
    doubling = np.prod(values + 1.0)
    torus = np.prod([first * second - 1.0 for first, second in combinations(values, 2)]) if len(values) > 1 else 1.0
    return {PERIOD_DOUBLING: float(np.real(doubling)), TORUS: float(np.real(torus))}


# ------------------------------------------------------------------------------------------------- branches of cycles


@dataclass(frozen=True, eq=False)
class _CycleSearch:
    """Branches of cycles of a `flow` as `parameter` varies over `bounds`; the widths of `box` scale the states.

    In all methods, `most` limits the number of returned branches, including the branches from period doublings.
    """

    flow: Flow
    box: Box
    parameter: ContinuationParameter
    bounds: tuple[float, float]

    def from_hopf(self, special: SpecialPoint, most: int) -> list[CycleBranch]:
        """Return the branch from a Hopf point; it begins with a small ellipse in the plane of the complex pair."""
        assert special.frequency is not None
        widths = self.box.widths
        jacobian = self.parameter.at(self.flow, special.value).jacobian(special.point) * widths / widths[:, None]
        values, vectors = np.linalg.eig(jacobian)
        vector = vectors[:, int(np.argmin(np.abs(values - 1j * special.frequency)))]
        mesh = np.linspace(0.0, 1.0, INTERVALS + 1)
        middle = _sample(lambda times: np.tile(special.point / widths, (len(times), 1)), mesh)
        ellipse = _sample(lambda times: np.real(vector * np.exp(2j * np.pi * times)[:, None]), mesh)
        period = 2.0 * np.pi / special.frequency
        curve = _CycleCurve(self, ellipse, period)
        z, direction = curve.z_of(middle, period, special.value), curve.z_of(ellipse, 1.0, 0.0)
        return self._follow(curve, z, direction, HOPF_END, most)

    def from_cycle(self, value: float, cycle: LimitCycle, most: int) -> list[CycleBranch]:
        """Return the branch through a cycle, followed to both sides."""
        widths = self.box.widths
        moved = np.sqrt((np.diff(np.vstack([cycle.points, cycle.points[:1]]) / widths, axis=0) ** 2).sum(axis=1))
        mesh = _even_mesh(np.linspace(0.0, 1.0, len(moved) + 1), moved / moved.sum() + 1.0 / len(moved), INTERVALS)
        flow = self.parameter.at(self.flow, value)
        orbit = _sample(lambda times: follow(flow.rates, cycle.point, cycle.period * times, widths) / widths, mesh)
        sides: list[CurveSide[_CycleOnCurve]] = []
        for sign in (-1.0, 1.0):
            curve = _CycleCurve(self, orbit, cycle.period)
            z = curve.z_of(orbit, cycle.period, value)
            direction = np.append(np.zeros(len(z) - 1), sign)
            start = curve.correct(z, direction) if np.isfinite(z).all() else None
            if start is None:
                return []
            sides.append(continue_curve(curve, start, direction))
        return self._join(curve, sides[0], sides[1], most)

    def from_doubling(self, curve: _CycleCurve, point: _CycleOnCurve, most: int) -> list[CycleBranch]:
        """Return the branch with twice the period that begins at a period doubling of another branch."""
        values, vectors = np.linalg.eig(point.linearised.monodromy)
        mesh_states, nodes = point.linearised.along(np.real(vectors[:, int(np.argmin(np.abs(values + 1.0)))]))
        orbit, mesh = point.orbit, np.append(0.5 * point.orbit.mesh[:-1], 0.5 + 0.5 * point.orbit.mesh)
        twice = Orbit(mesh, np.tile(orbit.mesh_states, (2, 1)), np.tile(orbit.nodes, (2, 1, 1)))
        turned = Orbit(mesh, np.vstack([mesh_states, -mesh_states]), np.vstack([nodes, -nodes]))
        doubled = _CycleCurve(self, twice, 2.0 * point.period, doublings=curve.doublings + 1)
        z = doubled.z_of(twice, 2.0 * point.period, curve.value(point.z))
        return self._follow(doubled, z, doubled.z_of(turned, 1.0, 0.0), PERIOD_DOUBLING, most)

    def _follow(
        self, curve: _CycleCurve, z: FloatArray, direction: FloatArray, origin: str, most: int
    ) -> list[CycleBranch]:
        """Return the branch from `z` in a `direction`; the other direction gives the same cycles half a turn later."""
        direction = direction / np.sqrt(direction @ direction)
        start = curve.correct(z + 0.25 * LONGEST * direction, direction) if most > 0 else None
        if start is None:
            return []
        return self._join(curve, CurveSide([], [], origin), continue_curve(curve, start, direction), most)

    def _join(
        self, curve: _CycleCurve, behind: CurveSide[_CycleOnCurve], ahead: CurveSide[_CycleOnCurve], most: int
    ) -> list[CycleBranch]:
        points, special = join_sides(behind, ahead)
        if len(points) < 2 or most < 1:
            return []
        special = [(kind, point) for kind, point in special if kind != TORUS or _has_complex_pair(point)]
        branches = [
            CycleBranch(
                np.array([curve.value(point.z) for point in points]),
                tuple(curve.cycle(point) for point in points),
                tuple(SpecialCycle(kind, curve.value(point.z), curve.cycle(point)) for kind, point in special),
                (behind.end, ahead.end),
            )
        ]
        for kind, point in special:
            if kind == PERIOD_DOUBLING and curve.doublings < MOST_DOUBLINGS:
                branches += self.from_doubling(curve, point, most - len(branches))
        return branches


def _has_complex_pair(point: _CycleOnCurve) -> bool:
    """Tell whether the pair of multipliers with the product 1 is complex; two real multipliers are no torus point."""
    values = multipliers_of(point.linearised.monodromy, 0.0)[1:]
    first, _ = min(combinations(values, 2), key=lambda pair: abs(pair[0] * pair[1] - 1.0))
    return bool(abs(first.imag) > 1e-6)
