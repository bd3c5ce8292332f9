"""Branches of limit cycles as one parameter varies, from Hopf points and from known cycles.

An orbit is the solution of a boundary value problem, found by collocation: time runs from 0 to 1 along the orbit, and
on each of N intervals of a mesh the orbit is a polynomial that satisfies the equations at M Gauss points. At the mesh
its error falls with the power 2 M of the interval (Ascher, Mattheij and Russell 1995, section 5.4). The linear system
of a Newton step is condensed to the states at the mesh, as in AUTO (Doedel, Keller and Kernévez 1991): the product of
the condensed matrices along the orbit is the monodromy matrix. The integral condition fixes the phase (ibid.).

Branches are followed by pseudo-arclength in (orbit, log period, parameter). At a fold the tangent turns back in the
parameter; at a period doubling a Floquet multiplier passes -1, at a torus point a complex pair passes the unit circle,
at a branch point another multiplier passes 1 (Kuznetsov 2004, sections 5.3 and 10.3). Near homoclinic orbits the
nontrivial multipliers are beyond the digits of the monodromy matrix; no test is made there. Letters: D states, N
intervals, M Gauss points, n cycles.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import combinations, pairwise
from typing import Final

import numpy as np

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
    joined,
)
from atoll.analysis.flow import Box, Flow, follow
from atoll.analysis.limit_cycles import SAMPLES, SMALLEST, LimitCycle, multipliers_of
from atoll_core.data.dataset import FloatArray

INTERVALS: Final = 80
"""Intervals of a mesh. On canards of the FitzHugh-Nagumo nerve, where multipliers change by powers of ten within 1e-8
of the parameter, the multipliers at folds are then 1 to 2e-3 (with 40 intervals they are not); period and fold are
known to 1e-9."""

GAUSS_POINTS: Final = 4

_ROOTS, _ROOT_WEIGHTS = np.polynomial.legendre.leggauss(GAUSS_POINTS)
_NODES, _WEIGHTS = 0.5 * (_ROOTS + 1.0), 0.5 * _ROOT_WEIGHTS
"""Gauss points (M,) in (0, 1), and their weights (M,)."""

_POWERS: Final = np.arange(1, GAUSS_POINTS + 1)
_INTEGRALS: Final = _NODES[:, None] ** _POWERS / _POWERS @ np.linalg.inv(np.vander(_NODES, increasing=True))
"""The integrals (M, M) of Lagrange's polynomials up to each Gauss point."""

_KNOTS: Final = np.append(0.0, _NODES)
"""Places on an interval at which a polynomial of degree M is known."""

_DIFFERENCES: Final = np.array([1.0 / np.prod(knot - np.delete(_KNOTS, at)) for at, knot in enumerate(_KNOTS)])
"""Weights of values at the knots: for the divided difference of order M, and for barycentric interpolation."""

MOST_BRANCHES: Final = 10
"""Branches that are reported; each costs up to two seconds."""

MOST_DOUBLINGS: Final = 2
"""How often a branch is followed from a period doubling: up to four times the first period."""

MOST_CYCLES: Final = 150
"""Cycles of one branch in each direction."""

LONGEST: Final = 0.05
"""Longest step along a branch, in ranges of parameter and box and in shares of the period."""

_LONGEST_PERIOD: Final = 100.0
"""Times the first period of a branch, up to which it is followed: near a homoclinic orbit periods have no bound."""

PERIOD_DOUBLING: Final = "period doubling"
TORUS: Final = "torus"
HOPF_END: Final = "Hopf point"

_NEWTON: Final = 8
"""Newton steps double the correct digits: a guess good to 1 % needs four."""

_KNOWN: Final = 1e-3
"""Largest error of the trivial multiplier, which is 1, up to which the others are taken as known."""

_RENEWED: Final = 4
"""Steps after which the mesh is adapted."""


@dataclass(frozen=True, eq=False)
class SpecialCycle:
    """A cycle where the character of a branch changes: `kind` is fold, branch point, period doubling or torus."""

    kind: str
    value: float
    cycle: LimitCycle


@dataclass(frozen=True, eq=False)
class CycleBranch:
    """`cycles` at `values` (n,) of the parameter; `ends` say why it is not followed beyond the first and the last."""

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

    They begin at the Hopf points of `branches` of fixed points, and at `known` cycles, each given with its value of the
    parameter. Cycles that leave the box by more than a width are not followed.
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
    """Tell whether a branch contains a cycle, judged by its cycles at the nearest values."""
    for (left, first), (right, second) in pairwise(zip(branch.values.tolist(), branch.cycles, strict=True)):
        if min(left, right) <= value <= max(left, right):
            for neighbour in (first, second):
                apart = float(neighbour.distances(cycle.points[::20], box).max())
                if apart < 2.0 * LONGEST and abs(np.log(neighbour.period / cycle.period)) < 2.0 * LONGEST:
                    return True
    return False


# -------------------------------------------------------------------------------------------------------- collocation


@dataclass(frozen=True, eq=False)
class Orbit:
    """States at the beginnings of the intervals of `mesh` (N + 1,), `mesh_states` (N, D), and at `nodes` (N, M, D)."""

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
        """Return the states (n, D) at times from 0 to 1, by the polynomial of each interval."""
        which = np.clip(np.searchsorted(self.mesh, times, side="right") - 1, 0, len(self.mesh) - 2)
        apart = ((times - self.mesh[which]) / self.lengths[which])[:, None] - _KNOTS
        apart = np.where(apart == 0.0, 1e-300, apart)
        shares = _DIFFERENCES / apart
        return np.asarray((shares[:, :, None] * self.knots[which]).sum(axis=1) / shares.sum(axis=1)[:, None])


def _sampled(states: Callable[[FloatArray], FloatArray], mesh: FloatArray) -> Orbit:
    """Return the orbit of a function of times (n,) from 0 to 1 that returns states (n, D)."""
    times = mesh[:-1, None] + np.diff(mesh)[:, None] * _KNOTS
    values = states(times.ravel()).reshape(*times.shape, -1)
    return Orbit(mesh, values[:, 0].copy(), values[:, 1:].copy())


def _even_mesh(mesh: FloatArray, weight: FloatArray, intervals: int) -> FloatArray:
    """Return a mesh of intervals with equal shares of `weight` (n,), given on the intervals of another mesh."""
    total = np.append(0.0, np.cumsum(weight))
    even = np.interp(np.linspace(0.0, total[-1], intervals + 1), total, mesh)
    even[0], even[-1] = 0.0, 1.0
    return np.asarray(even)


@dataclass(frozen=True, eq=False)
class _OrbitChange:
    """Changes of states at mesh (N, D) and nodes (N, M, D), of log period and parameter; as a row, their factors."""

    mesh_states: FloatArray
    nodes: FloatArray
    log_period: float
    parameter: float


class _Factors:
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
        """The sign of the determinant times the geometric mean of the pivots: both vanish together."""
        from sympy.combinatorics import Permutation

        pivots = self._lu.U.diagonal()
        parities = [Permutation(order.tolist()).signature() for order in (self._lu.perm_r, self._lu.perm_c)]
        sign = np.prod(np.sign(pivots)) * parities[0] * parities[1]
        return float(sign * np.exp(np.log(np.maximum(np.abs(pivots), 1e-300)).mean()))


class Linearised:
    """The equations of an orbit, linearised: the source of Newton steps, tangents and multipliers."""

    def __init__(
        self, orbit: Orbit, period: float, rates: FloatArray, by_states: FloatArray, by_parameter: FloatArray
    ) -> None:
        """Take the rates at the nodes (NM, D), with derivatives by states (NM, D, D) and by the parameter (NM, D)."""
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
        """The derivative (D, D) of the states after a period by the initial ones."""
        size = self.ends.shape[1]
        product = np.eye(size)
        for transfer in self.ends[..., :size]:
            product = transfer @ product
        return np.asarray(product)

    def along(self, begin: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the change (D,) carried along the linearised flow: at the mesh (N, D) and nodes (N, M, D)."""
        size, mesh_states = len(begin), [begin]
        for transfer in self.ends[:-1, :, :size]:
            mesh_states.append(transfer @ mesh_states[-1])
        carried = np.array(mesh_states)
        return carried, np.einsum("njde,ne->njd", self.inner[..., :size], carried)

    def factorised(self, rows: tuple[_OrbitChange, _OrbitChange]) -> _Factors:
        """Return the condensed system (ND + 2, ND + 2), factorised: the equations and two further rows."""
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
        return _Factors(*(np.concatenate([np.ravel(part) for part in parts]) for parts in (places, columns, values)))

    def solve(
        self, factors: _Factors, rows: tuple[_OrbitChange, _OrbitChange], right: tuple[float, float], *, is_step: bool
    ) -> _OrbitChange:
        """Return the change that gives the two further `rows`, of the matrix `factors`, the values on the `right`.

        For a Newton step (`is_step`) it removes the residuals of the equations; for a tangent it keeps them.
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
    """A limit cycle as a point of a curve: its `orbit` over widths of the box, `period` and linearised equations."""

    orbit: Orbit
    period: float
    linearised: Linearised


class _CycleCurve:
    """Cycles in coordinates z: states of the orbit over widths, logarithm of the period, parameter over its range.

    States have weights: their part of the length of a step is the root of their mean square over the mesh.
    """

    longest = LONGEST
    most = MOST_CYCLES

    def __init__(self, problem: "_CycleSearch", orbit: Orbit, period: float, *, doublings: int = 0) -> None:
        """`orbit` gives the mesh and the first phase, `period` is the period at the beginning of the branch."""
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
        """Fix the phase of cycles by an orbit r on the same mesh: the mean of (x - r) times r' is 0."""
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
        """Return the row of the linear system that is the scalar product with `z`."""
        return _OrbitChange(*self._split(z[:-2] * self._weights), float(z[-2]), float(z[-1]))

    def _z_change(self, change: _OrbitChange) -> FloatArray:
        states = np.concatenate([change.mesh_states.ravel(), change.nodes.ravel()]) * self._weights
        return np.append(states, [change.log_period, change.parameter])

    def _linearised(self, z: FloatArray) -> Linearised | None:
        flow, orbit, widths = self.parameter.at(self.flow, self.value(z)), self._orbit(z), self.box.widths
        x = orbit.nodes.reshape(-1, self._shape[2]) * widths
        by_states = flow.jacobian(x) * widths / widths[:, None]
        rates = (flow.rates(x) / widths, by_states, self.parameter.slope(flow, x) / widths * self.range)
        is_known = all(np.isfinite(array).all() for array in rates)
        return Linearised(orbit, float(np.exp(z[-2])), *rates) if is_known else None

    def correct(self, z: FloatArray, tangent: FloatArray) -> FloatArray | None:
        guess, row = z.copy(), self._row(tangent)
        for _ in range(_NEWTON):
            if abs(guess[-2] - z[-2]) > 1.0:
                return None
            linearised = self._linearised(guess)
            if linearised is None:
                return None
            missed = float((self._phase.nodes * (self._orbit(guess).nodes - self._reference)).sum())
            rows, right = (self._phase, row), (-missed, -float(tangent @ (guess - z)))
            try:
                change = linearised.solve(linearised.factorised(rows), rows, right, is_step=True)
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
        linearised = self._linearised(z)
        if linearised is None:
            return None
        rows = (self._phase, self._row(before))
        try:
            factors = linearised.factorised(rows)
            tangent = self._z_change(linearised.solve(factors, rows, (0.0, 1.0), is_step=False))
        except np.linalg.LinAlgError:
            return None
        tangent = tangent / np.sqrt(tangent @ tangent)
        if not np.isfinite(tangent).all():
            return None
        # the tangent continues in the direction of `before`: with its row the determinant has the same sign
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
            return HOPF_END  # the cycle shrinks to a point, beyond which the same cycles follow half a turn later
        if self.doublings:
            times = np.linspace(0.0, 0.5, self._shape[0], endpoint=False)
            first, second = (point.orbit.at(times) - point.orbit.at(times + 0.5) for point in (last, after))
            if float((first * second).sum()) <= 0.0:
                return PERIOD_DOUBLING  # beyond it the same cycles follow half a period later
        return "period without bounds" if after.z[-2] > self._longest_period else None

    def adapt(self, point: _CycleOnCurve) -> _CycleOnCurve:
        self._steps += 1
        if self._steps % _RENEWED:
            self._set_phase(point.orbit)
            return point
        kept = self._mesh, self._reference, self._phase
        # intervals get equal shares of the derivative of order M + 1, which the error is proportional to
        lengths = point.orbit.lengths
        slopes = np.einsum("k,nkd->nd", _DIFFERENCES, point.orbit.knots) / lengths[:, None] ** GAUSS_POINTS
        jumps = np.abs(np.roll(slopes, -1, axis=0) - slopes) / (0.5 * (np.roll(lengths, -1) + lengths))[:, None]
        size = np.maximum(jumps, np.roll(jumps, 1, axis=0)).max(axis=1) ** (1.0 / (GAUSS_POINTS + 1))
        weight = (size + 0.1 * max(float((size * lengths).sum()), 1e-12)) * lengths  # every part keeps some intervals
        mesh = _even_mesh(point.orbit.mesh, weight, len(weight))
        orbit = _sampled(point.orbit.at, mesh)
        along = _sampled(Orbit(point.orbit.mesh, *self._split(point.tangent[:-2] / self._weights)).at, mesh)
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
    """Return numbers that vanish where a multiplier passes -1, and where a pair of them has the product 1.

    NaN in the plane, where the nontrivial multiplier is positive, and where the trivial one is not 1: then the others
    are not known either.
    """
    if len(monodromy) == 2:
        return {PERIOD_DOUBLING: np.nan, TORUS: np.nan}
    trivial, *others = multipliers_of(monodromy, 0.0)
    values = np.array(others) if abs(trivial - 1.0) < _KNOWN else np.full(len(others), np.nan + 0j)
    doubling = np.prod(values + 1.0)
    torus = np.prod([first * second - 1.0 for first, second in combinations(values, 2)]) if len(values) > 1 else 1.0
    return {PERIOD_DOUBLING: float(np.real(doubling)), TORUS: float(np.real(torus))}


# ------------------------------------------------------------------------------------------------- branches of cycles


@dataclass(frozen=True, eq=False)
class _CycleSearch:
    """Branches of cycles of a `flow` as `parameter` varies over `bounds`; the widths of `box` scale the states.

    `most` bounds the branches that one start may give, including the branches from its period doublings.
    """

    flow: Flow
    box: Box
    parameter: ContinuationParameter
    bounds: tuple[float, float]

    def from_hopf(self, special: SpecialPoint, most: int) -> list[CycleBranch]:
        """Return the branch that begins at a Hopf point, with a small ellipse in the plane of the pair."""
        assert special.frequency is not None
        widths = self.box.widths
        jacobian = self.parameter.at(self.flow, special.value).jacobian(special.point) * widths / widths[:, None]
        values, vectors = np.linalg.eig(jacobian)
        vector = vectors[:, int(np.argmin(np.abs(values - 1j * special.frequency)))]
        mesh = np.linspace(0.0, 1.0, INTERVALS + 1)
        middle = _sampled(lambda times: np.tile(special.point / widths, (len(times), 1)), mesh)
        ellipse = _sampled(lambda times: np.real(vector * np.exp(2j * np.pi * times)[:, None]), mesh)
        period = 2.0 * np.pi / special.frequency
        curve = _CycleCurve(self, ellipse, period)
        z, direction = curve.z_of(middle, period, special.value), curve.z_of(ellipse, 1.0, 0.0)
        return self._begun(curve, z, direction, HOPF_END, most)

    def from_cycle(self, value: float, cycle: LimitCycle, most: int) -> list[CycleBranch]:
        """Return the branch through a cycle, followed to both sides."""
        widths = self.box.widths
        moved = np.sqrt((np.diff(np.vstack([cycle.points, cycle.points[:1]]) / widths, axis=0) ** 2).sum(axis=1))
        mesh = _even_mesh(np.linspace(0.0, 1.0, len(moved) + 1), moved / moved.sum() + 1.0 / len(moved), INTERVALS)
        flow = self.parameter.at(self.flow, value)
        orbit = _sampled(lambda times: follow(flow.rates, cycle.point, cycle.period * times, widths) / widths, mesh)
        sides: list[CurveSide[_CycleOnCurve]] = []
        for sign in (-1.0, 1.0):
            curve = _CycleCurve(self, orbit, cycle.period)
            z = curve.z_of(orbit, cycle.period, value)
            direction = np.append(np.zeros(len(z) - 1), sign)
            start = curve.correct(z, direction) if np.isfinite(z).all() else None
            if start is None:
                return []
            sides.append(continue_curve(curve, start, direction))
        return self._joined(curve, sides[0], sides[1], most)

    def from_doubling(self, curve: _CycleCurve, point: _CycleOnCurve, most: int) -> list[CycleBranch]:
        """Return the branch of twice the period that begins at a period doubling of another one."""
        values, vectors = np.linalg.eig(point.linearised.monodromy)
        mesh_states, nodes = point.linearised.along(np.real(vectors[:, int(np.argmin(np.abs(values + 1.0)))]))
        orbit, mesh = point.orbit, np.append(0.5 * point.orbit.mesh[:-1], 0.5 + 0.5 * point.orbit.mesh)
        twice = Orbit(mesh, np.tile(orbit.mesh_states, (2, 1)), np.tile(orbit.nodes, (2, 1, 1)))
        turned = Orbit(mesh, np.vstack([mesh_states, -mesh_states]), np.vstack([nodes, -nodes]))
        doubled = _CycleCurve(self, twice, 2.0 * point.period, doublings=curve.doublings + 1)
        z = doubled.z_of(twice, 2.0 * point.period, curve.value(point.z))
        return self._begun(doubled, z, doubled.z_of(turned, 1.0, 0.0), PERIOD_DOUBLING, most)

    def _begun(
        self, curve: _CycleCurve, z: FloatArray, direction: FloatArray, origin: str, most: int
    ) -> list[CycleBranch]:
        """Return the branch that leaves `z` in a direction; the other side is the same branch half a turn later."""
        direction = direction / np.sqrt(direction @ direction)
        start = curve.correct(z + 0.25 * LONGEST * direction, direction) if most > 0 else None
        if start is None:
            return []
        return self._joined(curve, CurveSide([], [], origin), continue_curve(curve, start, direction), most)

    def _joined(
        self, curve: _CycleCurve, behind: CurveSide[_CycleOnCurve], ahead: CurveSide[_CycleOnCurve], most: int
    ) -> list[CycleBranch]:
        points, special = joined(behind, ahead)
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
    """Tell whether the pair of multipliers with the product 1 is complex: two real ones make no torus."""
    values = multipliers_of(point.linearised.monodromy, 0.0)[1:]
    first, _ = min(combinations(values, 2), key=lambda pair: abs(pair[0] * pair[1] - 1.0))
    return bool(abs(first.imag) > 1e-6)
