"""Closed orbits as boundary value problems: collocation at Gauss points, with the unknowns between mesh points removed.

Time runs from 0 to 1 along the orbit. On each of N intervals of the mesh the orbit is a polynomial that satisfies the
equations at M Gauss points; at the mesh its error falls with the power 2 M of the interval (Ascher, Mattheij and
Russell 1995, section 5.4). The linear system of a Newton step is condensed to the states at the mesh, as AUTO does
(Doedel, Keller and Kernévez 1991): the matrices of that, multiplied along the orbit, are the monodromy matrix.
Letters: D states, N intervals, M Gauss points.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from atoll_core.data.dataset import FloatArray

INTERVALS: Final = 80
"""Of a mesh at first. On canards of the FitzHugh-Nagumo nerve, where multipliers change by powers of ten within 1e-8 of
the parameter, those of folds are 1 to 2e-3 (with 40 intervals they are not); period and fold are known to 1e-9."""

GAUSS_POINTS: Final = 4


_ROOTS, _WEIGHTS = np.polynomial.legendre.leggauss(GAUSS_POINTS)
NODES, WEIGHTS = 0.5 * (_ROOTS + 1.0), 0.5 * _WEIGHTS
"""Nodes (M,) in (0, 1), and weights (M,)."""

_POWERS: Final = np.arange(1, GAUSS_POINTS + 1)
INTEGRALS: Final = NODES[:, None] ** _POWERS / _POWERS @ np.linalg.inv(np.vander(NODES, increasing=True))
"""The integrals (M, M) of Lagrange's polynomials up to each node."""

_KNOTS: Final = np.append(0.0, NODES)
"""Where on an interval a polynomial of degree M is known."""

_DIFFERENCES: Final = np.array([1.0 / np.prod(knot - np.delete(_KNOTS, at)) for at, knot in enumerate(_KNOTS)])
"""Of values at the knots: the divided difference of order M, and the weights of barycentric interpolation."""


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


def sampled(states: Callable[[FloatArray], FloatArray], mesh: FloatArray) -> Orbit:
    """Return the orbit of a function of times (n,) from 0 to 1 that returns states (n, D)."""
    times = mesh[:-1, None] + np.diff(mesh)[:, None] * _KNOTS
    values = states(times.ravel()).reshape(*times.shape, -1)
    return Orbit(mesh, values[:, 0].copy(), values[:, 1:].copy())


def spread_mesh(orbit: Orbit) -> FloatArray:
    """Return a mesh on which the derivative of order M + 1, which drives the error, weighs alike on all intervals."""
    lengths = orbit.lengths
    slopes = np.einsum("k,nkd->nd", _DIFFERENCES, orbit.knots) / lengths[:, None] ** GAUSS_POINTS
    jumps = np.abs(np.roll(slopes, -1, axis=0) - slopes) / (0.5 * (np.roll(lengths, -1) + lengths))[:, None]
    size = np.maximum(jumps, np.roll(jumps, 1, axis=0)).max(axis=1) ** (1.0 / (GAUSS_POINTS + 1))
    weight = (size + 0.1 * max(float((size * lengths).sum()), 1e-12)) * lengths  # none is ever left without a mesh
    return levelled(orbit.mesh, weight, len(weight))


def levelled(mesh: FloatArray, weight: FloatArray, intervals: int) -> FloatArray:
    """Return a mesh of so many intervals with equal shares of `weight` (n,), given on the intervals of another mesh."""
    total = np.append(0.0, np.cumsum(weight))
    levelled_mesh = np.interp(np.linspace(0.0, total[-1], intervals + 1), total, mesh)
    levelled_mesh[0], levelled_mesh[-1] = 0.0, 1.0
    return np.asarray(levelled_mesh)


@dataclass(frozen=True, eq=False)
class Change:
    """Changes of states at mesh (N, D) and nodes (N, M, D), of log period and parameter; as a row, their factors."""

    mesh_states: FloatArray
    nodes: FloatArray
    log_period: float
    parameter: float


class Linearised:
    """The equations of an orbit linearised: what a Newton step, a tangent and multipliers come from."""

    def __init__(
        self, orbit: Orbit, period: float, rates: FloatArray, by_states: FloatArray, by_parameter: FloatArray
    ) -> None:
        """Take the rates at the nodes (NM, D), with derivatives by states (NM, D, D) and by the parameter (NM, D)."""
        count, number, size = orbit.nodes.shape
        spans = (period * orbit.lengths)[:, None, None]
        rates = rates.reshape(count, number, size)
        by_states = by_states.reshape(count, number, size, size)
        by_parameter = by_parameter.reshape(count, number, size)
        moved = spans * np.einsum("jk,nkd->njd", INTEGRALS, rates)
        left = orbit.nodes - orbit.mesh_states[:, None] - moved
        matrix = -spans[..., None, None] * np.einsum("jk,nkde->njdke", INTEGRALS, by_states)
        matrix = matrix.reshape(count, number * size, number * size) + np.eye(number * size)
        columns = np.empty((count, number, size, size + 3))
        columns[..., :size] = np.eye(size)
        columns[..., size] = moved
        columns[..., size + 1] = spans * np.einsum("jk,nkd->njd", INTEGRALS, by_parameter)
        columns[..., size + 2] = -left
        solved = np.linalg.solve(matrix, columns.reshape(count, number * size, size + 3))
        self.inner = solved.reshape(count, number, size, size + 3)
        ends = spans * np.einsum("j,njde,njec->ndc", WEIGHTS, by_states, self.inner)
        ends[..., :size] += np.eye(size)
        ends[..., size] += spans[:, 0] * (WEIGHTS @ rates)
        ends[..., size + 1] += spans[:, 0] * (WEIGHTS @ by_parameter)
        reached = orbit.mesh_states + spans[:, 0] * (WEIGHTS @ rates)
        ends[..., size + 2] += reached - np.roll(orbit.mesh_states, -1, axis=0)
        self.ends = ends
        traces = np.einsum("njdd->nj", by_states)
        self.log_multiplier_product = float(period * (orbit.lengths * (traces @ WEIGHTS)).sum())

    @property
    def monodromy(self) -> FloatArray:
        """The derivative (D, D) of the states after a period by those at first."""
        size = self.ends.shape[1]
        product = np.eye(size)
        for transfer in self.ends[..., :size]:
            product = transfer @ product
        return np.asarray(product)

    def along(self, begin: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return where the linearised flow takes a change (D,): at the mesh (N, D) and nodes (N, M, D)."""
        size, mesh_states = len(begin), [begin]
        for transfer in self.ends[:-1, :, :size]:
            mesh_states.append(transfer @ mesh_states[-1])
        taken = np.array(mesh_states)
        return taken, np.einsum("njde,ne->njd", self.inner[..., :size], taken)

    def matrix(self, rows: tuple[Change, Change]) -> "Factors":
        """Return the condensed system (ND + 2, ND + 2), factorised: the equations and two more rows."""
        count, size = self.ends.shape[:2]
        block = np.arange(count * size).reshape(count, size)
        across = [np.broadcast_to(block[:, :, None], (count, size, size)), block]
        along = [np.broadcast_to(block[:, None, :], (count, size, size)), np.roll(block, -1, axis=0)]
        values = [self.ends[..., :size], np.full((count, size), -1.0)]
        for column in (size, size + 1):
            across.append(block)
            along.append(np.full((count, size), count * size + column - size))
            values.append(self.ends[..., column])
        for number, row in enumerate(rows):
            by_inner = np.einsum("njd,njdc->nc", row.nodes, self.inner[..., : size + 2])
            last = [row.log_period + by_inner[:, size].sum(), row.parameter + by_inner[:, size + 1].sum()]
            across.append(np.full(count * size + 2, count * size + number))
            along.append(np.arange(count * size + 2))
            values.append(np.append((row.mesh_states + by_inner[:, :size]).ravel(), last))
        return Factors(*(np.concatenate([np.ravel(part) for part in parts]) for parts in (across, along, values)))

    def solve(
        self, factors: "Factors", rows: tuple[Change, Change], right: tuple[float, float], *, is_step: bool
    ) -> Change:
        """Return the change that gives the two more `rows`, of the matrix `factors`, the values on the `right`.

        After it the equations hold where it `is_step` (of Newton); otherwise they keep what they leave (a tangent).
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
        return Change(mesh_states, nodes, log_period, parameter)


class Factors:
    """A sparse matrix (n, n) factorised; raises LinAlgError where it is singular."""

    def __init__(self, across: FloatArray, along: FloatArray, values: FloatArray) -> None:
        """Take the rows, columns and values of its entries."""
        from scipy.sparse import csc_matrix
        from scipy.sparse.linalg import splu

        size = int(across.max()) + 1
        try:
            self._found = splu(csc_matrix((values, (across, along)), shape=(size, size)))
        except RuntimeError as error:  # as scipy says that a pivot is 0
            raise np.linalg.LinAlgError(str(error)) from None

    def solve(self, right: FloatArray) -> FloatArray:
        """Return the solution (n,) for a right-hand side (n,)."""
        return np.asarray(self._found.solve(right))

    @property
    def scaled_determinant(self) -> float:
        """The sign of the determinant times the geometric mean of the pivots: both vanish at once."""
        pivots = self._found.U.diagonal()
        sign = np.prod(np.sign(pivots)) * _parity(self._found.perm_r) * _parity(self._found.perm_c)
        return float(sign * np.exp(np.log(np.maximum(np.abs(pivots), 1e-300)).mean()))


def _parity(order: npt.NDArray[np.int32]) -> int:
    """Return 1 for an even permutation, -1 for an odd one."""
    left, parity = set(range(len(order))), 1
    while left:
        at = left.pop()
        while (at := int(order[at])) in left:
            left.remove(at)
            parity = -parity
    return parity
