"""Limit cycles as one parameter varies: branches from Hopf points and from cycles that are known.

Cycles are followed by pseudo-arclength in (orbit, log period, parameter), the orbit by collocation, with the integral
phase condition (Doedel, Keller and Kernévez 1991). A fold is where the tangent turns back in the parameter; at a period
doubling a Floquet multiplier passes -1, at a torus point a complex pair the unit circle, at a branch point another one
passes 1 (Kuznetsov 2004, sections 5.3 and 10.3). Letters: D states, N intervals, M Gauss points, n cycles.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations, pairwise
from typing import Final

import numpy as np

from atoll.analysis.box import Box
from atoll.analysis.collocation import INTERVALS, Orbit, levelled, sampled
from atoll.analysis.continuation import HOPF, Branch, SpecialPoint
from atoll.analysis.continuation_parameter import ContinuationParameter
from atoll.analysis.cycle_curve import HOPF_END, LONGEST, PERIOD_DOUBLING, TORUS, CycleCurve, CycleOnCurve, CycleProblem
from atoll.analysis.flow import Flow, follow
from atoll.analysis.limit_cycles import LimitCycle, distance, multipliers_of
from atoll.analysis.path_following import Side, continue_curve, joined
from atoll.analysis.stability import Complexes
from atoll_core.data.dataset import FloatArray

MOST_BRANCHES: Final = 10
"""Branches that are shown; each costs up to two seconds."""

MOST_DOUBLINGS: Final = 2
"""How often branches are followed that begin at a period doubling: up to four times the first period."""


@dataclass(frozen=True, eq=False)
class SpecialCycle:
    """Where the character of a branch changes: `kind` is fold, branch point, period doubling or torus."""

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
    """Return the branches of limit cycles as `parameter` goes over `bounds`.

    They begin at the Hopf points of `branches` of fixed points, and at `known` cycles, each given with its value of the
    parameter. Cycles that leave the box by more than a width are not followed.
    """
    search = _Search(flow, box, parameter, bounds)
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
    """Tell whether a branch ends, or begins, at a Hopf point."""
    for branch in branches:
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
            for neighbour in (first, second):
                apart = float(distance(neighbour, cycle.points[::20], box).max())
                if apart < 2.0 * LONGEST and abs(np.log(neighbour.period / cycle.period)) < 2.0 * LONGEST:
                    return True
    return False


class _Search(CycleProblem):
    """Branches of cycles of a flow; `most` bounds how many a start may give, with those that begin at its doublings."""

    def from_hopf(self, special: SpecialPoint, most: int) -> list[CycleBranch]:
        """Return the branch that begins at a Hopf point: at first an ellipse around it in the plane of the pair."""
        assert special.frequency is not None
        widths = self.box.widths
        jacobian = self.parameter.at(self.flow, special.value).jacobian(special.point) * widths / widths[:, None]
        values, vectors = np.linalg.eig(jacobian)
        vector = vectors[:, int(np.argmin(np.abs(values - 1j * special.frequency)))]
        mesh = np.linspace(0.0, 1.0, INTERVALS + 1)
        middle = sampled(lambda times: np.tile(special.point / widths, (len(times), 1)), mesh)
        ellipse = sampled(lambda times: np.real(vector * np.exp(2j * np.pi * times)[:, None]), mesh)
        period = 2.0 * np.pi / special.frequency
        curve = CycleCurve(self, ellipse, period)
        return self._begun(
            curve, curve.z_of(middle, period, special.value), curve.z_of(ellipse, 1.0, 0.0), HOPF_END, most
        )

    def from_cycle(self, value: float, cycle: LimitCycle, most: int) -> list[CycleBranch]:
        """Return the branch through a cycle, followed to both sides."""
        widths = self.box.widths
        moved = np.sqrt((np.diff(np.vstack([cycle.points, cycle.points[:1]]) / widths, axis=0) ** 2).sum(axis=1))
        mesh = levelled(np.linspace(0.0, 1.0, len(moved) + 1), moved / moved.sum() + 1.0 / len(moved), INTERVALS)
        flow = self.parameter.at(self.flow, value)
        orbit = sampled(lambda times: follow(flow.rates, cycle.point, cycle.period * times, widths) / widths, mesh)
        sides: list[Side[CycleOnCurve]] = []
        for sign in (-1.0, 1.0):
            curve = CycleCurve(self, orbit, cycle.period)
            z = curve.z_of(orbit, cycle.period, value)
            direction = np.append(np.zeros(len(z) - 1), sign)
            start = curve.correct(z, direction) if np.isfinite(z).all() else None
            if start is None:
                return []
            sides.append(continue_curve(curve, start, direction))
        return self._joined(curve, sides[0], sides[1], most)

    def from_doubling(self, curve: CycleCurve, point: CycleOnCurve, most: int) -> list[CycleBranch]:
        """Return the branch of twice the period that begins at a period doubling of another one."""
        values, vectors = np.linalg.eig(point.linearised.monodromy)
        mesh_states, nodes = point.linearised.along(np.real(vectors[:, int(np.argmin(np.abs(values + 1.0)))]))
        orbit, mesh = point.orbit, np.append(0.5 * point.orbit.mesh[:-1], 0.5 + 0.5 * point.orbit.mesh)
        twice = Orbit(mesh, np.tile(orbit.mesh_states, (2, 1)), np.tile(orbit.nodes, (2, 1, 1)))
        turned = Orbit(mesh, np.vstack([mesh_states, -mesh_states]), np.vstack([nodes, -nodes]))
        doubled = CycleCurve(self, twice, 2.0 * point.period, doublings=curve.doublings + 1)
        z = doubled.z_of(twice, 2.0 * point.period, curve.value(point.z))
        return self._begun(doubled, z, doubled.z_of(turned, 1.0, 0.0), PERIOD_DOUBLING, most)

    def _begun(
        self, curve: CycleCurve, z: FloatArray, direction: FloatArray, origin: str, most: int
    ) -> list[CycleBranch]:
        """Return the branch that leaves `z` in a direction; what lies behind is the same half a turn later."""
        direction = direction / np.sqrt(direction @ direction)
        start = curve.correct(z + 0.25 * LONGEST * direction, direction) if most > 0 else None
        if start is None:
            return []
        return self._joined(curve, Side([], [], origin), continue_curve(curve, start, direction), most)

    def _joined(
        self, curve: CycleCurve, behind: Side[CycleOnCurve], ahead: Side[CycleOnCurve], most: int
    ) -> list[CycleBranch]:
        """Return the branch of two sides, and those that begin at its period doublings."""
        points, special = joined(behind, ahead)
        if len(points) < 2 or most < 1:
            return []
        special = [(kind, point) for kind, point in special if _is_real(kind, point)]
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


def _is_real(kind: str, point: CycleOnCurve) -> bool:
    """Tell whether a pair of multipliers with the product 1 is complex: two real ones make no torus."""
    if kind != TORUS:
        return True
    values: Complexes = multipliers_of(point.linearised.monodromy, 0.0)[1:]
    first, _ = min(combinations(values, 2), key=lambda pair: abs(pair[0] * pair[1] - 1.0))
    return bool(abs(first.imag) > 1e-6)
