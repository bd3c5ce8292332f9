"""Fixed points as one parameter varies: pseudo-arclength continuation, with folds, branch points and Hopf points.

A branch is followed in (x, p), both over their ranges. A fold is where the tangent turns back in p, a branch point
where the determinant of the bordered matrix changes its sign, a Hopf point where a complex pair of eigenvalues crosses
the imaginary axis (Kuznetsov 2004, chapter 10). Letters: D states, n points.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import numpy.typing as npt

from atoll.analysis.box import Box
from atoll.analysis.continuation_parameter import ContinuationParameter
from atoll.analysis.fixed_points import fixed_points
from atoll.analysis.flow import Flow
from atoll.analysis.newton import rate_scale
from atoll.analysis.path_following import BRANCH_POINT, FOLD, CurvePoint, continue_curve, joined
from atoll_core.data.dataset import FloatArray

MOST_POINTS: Final = 400
"""Points of one branch in each direction."""

MOST_BRANCHES: Final = 20
"""Branches that are shown."""

LONGEST: Final = 0.02
"""Longest step along a branch, in ranges of parameter and box."""

SEEDED: Final = 3
"""Values of the parameter, spread over its range, at which branches are sought, besides that of the model."""

HOPF: Final = "Hopf"
OUTSIDE: Final = 1.0
"""Widths of the box beyond which a branch is not followed."""


@dataclass(frozen=True, eq=False)
class SpecialPoint:
    """Where the character of a branch changes: `kind` is fold, branch point or Hopf; `frequency` is that of Hopf."""

    kind: str
    value: float
    point: FloatArray
    frequency: float | None = None


@dataclass(frozen=True, eq=False)
class Branch:
    """Fixed points (n, D) at `values` (n,) of the parameter, each with so many `unstable` eigenvalues (n,)."""

    values: FloatArray = field(repr=False)
    points: FloatArray = field(repr=False)
    unstable: npt.NDArray[np.int64] = field(repr=False)
    special: tuple[SpecialPoint, ...]


@dataclass(frozen=True, eq=False)
class _FixedPointOnCurve(CurvePoint):
    eigenvalues: npt.NDArray[np.complex128]


class _FixedPointCurve:
    """Fixed points in scaled coordinates z = (x / widths, p / range), (D + 1,)."""

    longest = LONGEST
    most = MOST_POINTS

    def __init__(self, flow: Flow, box: Box, parameter: ContinuationParameter, bounds: tuple[float, float]) -> None:
        self.flow, self.parameter, self.box = flow, parameter, box
        self.scale = np.append(box.widths, bounds[1] - bounds[0])
        self._rates = rate_scale(flow, box)
        self.limits = (bounds[0] / self.scale[-1], bounds[1] / self.scale[-1])

    def at(self, z: FloatArray) -> Flow:
        return self.parameter.at(self.flow, float(z[-1] * self.scale[-1]))

    def matrix(self, z: FloatArray) -> FloatArray:
        """Return the derivative (D, D + 1) of the rates, over their typical sizes, by z."""
        flow, x = self.at(z), z[:-1] * self.box.widths
        by_x = np.hstack([flow.jacobian(x), self.parameter.slope(flow, x[None]).T])
        return np.asarray(by_x / self._rates[:, None] * self.scale)

    def correct(self, z: FloatArray, tangent: FloatArray) -> FloatArray | None:
        """Return the fixed point in the plane through `z` across `tangent`; None: none is near."""
        guess = z.copy()
        for _ in range(10):
            rates = self.at(guess).rates(guess[:-1] * self.box.widths) / self._rates
            bordered = np.vstack([self.matrix(guess), tangent])
            if not (np.isfinite(bordered).all() and np.isfinite(rates).all()):
                return None
            try:
                step = np.linalg.solve(bordered, -np.append(rates, tangent @ (guess - z)))
            except np.linalg.LinAlgError:
                return None
            guess = guess + step
            if np.abs(step).max() < 1e-11:
                return guess
        return guess if np.abs(step).max() < 1e-8 else None

    def curve_point(self, z: FloatArray, before: FloatArray) -> _FixedPointOnCurve | None:
        matrix = self.matrix(z)
        if not np.isfinite(matrix).all():
            return None
        tangent = np.linalg.svd(matrix)[2][-1]
        tangent = tangent if tangent @ before >= 0.0 else -tangent
        similar = matrix[:, :-1] * (self._rates / self.box.widths)[:, None]
        eigenvalues = np.linalg.eigvals(similar).astype(np.complex128)
        determinant = float(np.linalg.det(np.vstack([matrix, tangent])))
        tests = {FOLD: float(tangent[-1]), BRANCH_POINT: determinant, HOPF: _pair(eigenvalues)[0]}
        return _FixedPointOnCurve(z, tangent, tests, eigenvalues)

    def end(self, last: _FixedPointOnCurve, after: _FixedPointOnCurve) -> str | None:
        del last
        return None if self.box.contains(after.z[:-1] * self.box.widths, OUTSIDE) else "outside the box"

    def adapt(self, point: _FixedPointOnCurve) -> _FixedPointOnCurve:
        return point


def continuation(
    flow: Flow, box: Box, parameter: ContinuationParameter, bounds: tuple[float, float]
) -> tuple[Branch, ...]:
    """Return the branches of fixed points in `box` as `parameter` goes over `bounds`.

    Branches begin at the fixed points found at the value of the model, where it lies in `bounds`, and at values
    spread over them; one that meets none of these is not seen.
    """
    curve = _FixedPointCurve(flow, box, parameter, bounds)
    own = parameter.value
    spread = np.linspace(*bounds, 2 * SEEDED + 1)[1::2].tolist()
    branches: list[Branch] = []
    for value in [*([own] if bounds[0] <= own <= bounds[1] else []), *spread]:
        for fixed in fixed_points(parameter.at(flow, value), box).points:
            start = np.append(fixed.point / box.widths, value / curve.scale[-1])
            is_seen = any(_passes(branch, fixed.point, value, curve) for branch in branches)
            if len(branches) < MOST_BRANCHES and not is_seen:
                branches += _branch(curve, start)
    return tuple(branches)


def _passes(branch: Branch, point: FloatArray, value: float, curve: _FixedPointCurve) -> bool:
    """Tell whether a branch goes through a fixed point, as far as its points are near enough to tell."""
    scaled = np.hstack([branch.points / curve.box.widths, branch.values[:, None] / curve.scale[-1]])
    start = np.append(point / curve.box.widths, value / curve.scale[-1])
    sides, beside = np.diff(scaled, axis=0), start - scaled[:-1]
    share = np.clip((beside * sides).sum(axis=1) / np.maximum((sides**2).sum(axis=1), 1e-300), 0.0, 1.0)
    return bool((np.abs(beside - share[:, None] * sides).max(axis=1) < 1e-3).any())


def _branch(curve: _FixedPointCurve, start: FloatArray) -> list[Branch]:
    """Return the branch through `start`, followed to both sides; empty where it cannot be followed at all."""
    matrix = curve.matrix(start)
    if not np.isfinite(matrix).all():
        return []
    tangent = np.linalg.svd(matrix)[2][-1]
    ahead, behind = continue_curve(curve, start, tangent), continue_curve(curve, start, -tangent)
    points, special = joined(behind, ahead)
    if len(points) < 2:
        return []
    states = np.array([point.z[:-1] * curve.box.widths for point in points])
    values = np.array([point.z[-1] * curve.scale[-1] for point in points])
    unstable = np.array([int((point.eigenvalues.real > 0.0).sum()) for point in points], dtype=np.int64)
    described = []
    for kind, point in special:
        frequency = _pair(point.eigenvalues)[1] if kind == HOPF else None
        # two real eigenvalues of opposite sign make no Hopf point
        if frequency is None or frequency > 1e-6 * np.abs(point.eigenvalues).max():
            value = float(point.z[-1] * curve.scale[-1])
            described.append(SpecialPoint(kind, value, point.z[:-1] * curve.box.widths, frequency))
    return [Branch(values, states, unstable, tuple(described))]


def _pair(eigenvalues: npt.NDArray[np.complex128]) -> tuple[float, float]:
    """Return real part and frequency of the complex pair nearest the imaginary axis; NaN where there is none."""
    pairs = [eigenvalue for eigenvalue in eigenvalues if eigenvalue.imag > 0.0]
    nearest = min(pairs, key=lambda eigenvalue: abs(eigenvalue.real), default=None)
    return (np.nan, np.nan) if nearest is None else (float(nearest.real), float(nearest.imag))


def special_points(branches: Sequence[Branch]) -> list[SpecialPoint]:
    """Return the special points of all branches by rising value of the parameter."""
    return sorted((point for branch in branches for point in branch.special), key=lambda point: point.value)
