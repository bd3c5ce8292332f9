"""Fixed points as one parameter varies: pseudo-arclength continuation, with folds, branch points and Hopf points.

A branch is followed in (x, p), both over their ranges, by steps along its tangent and Newton steps across it (Keller
1977). A fold is where the tangent turns back in p, a branch point where the determinant of the bordered matrix changes
its sign, a Hopf point where a complex pair of eigenvalues crosses the imaginary axis (Kuznetsov 2004, chapter 10); each
is refined by bisection along the branch. Letters: D states, n points.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from atoll.analysis.box import Box
from atoll.analysis.fixed_points import fixed_points
from atoll.analysis.flow import Flow
from atoll.data.dataset import FloatArray

MOST_POINTS: Final = 400
"""Points of one branch in each direction."""

MOST_BRANCHES: Final = 20
LONGEST: Final = 0.02
"""Longest step along a branch, in ranges of parameter and box."""

SHORTEST: Final = 1e-6
SEEDED: Final = 3
"""Values of the parameter, spread over its range, at which branches are sought, besides that of the model."""

_BISECTIONS: Final = 40
_OUTSIDE: Final = 1.0
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

    values: FloatArray
    points: FloatArray
    unstable: npt.NDArray[np.int64]
    special: tuple[SpecialPoint, ...]


@dataclass(frozen=True, eq=False)
class _Place:
    z: FloatArray
    tangent: FloatArray
    determinant: float
    eigenvalues: npt.NDArray[np.complex128]


class _Curve:
    """Fixed points in scaled coordinates z = (x / widths, p / range), (D + 1,)."""

    def __init__(self, flow: Flow, box: Box, index: int, bounds: tuple[float, float]) -> None:
        self.flow, self.index, self.bounds, self.box = flow, index, bounds, box
        self.scale = np.append(box.widths, bounds[1] - bounds[0])

    def at(self, z: FloatArray) -> Flow:
        return self.flow.with_parameter(self.index, float(z[-1] * self.scale[-1]))

    def matrix(self, z: FloatArray) -> FloatArray:
        """Return the derivative (D, D + 1) of the rates by z."""
        flow, x = self.at(z), z[:-1] * self.box.widths
        return np.asarray(np.hstack([flow.jacobian(x), flow.by_parameter(x, self.index)[:, None]]) * self.scale)

    def corrected(self, z: FloatArray, tangent: FloatArray) -> FloatArray | None:
        """Return the fixed point in the plane through `z` across `tangent`; None: none is near."""
        guess = z.copy()
        for _ in range(10):
            rates = self.at(guess).rates(guess[:-1] * self.box.widths)
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

    def place(self, z: FloatArray, before: FloatArray) -> _Place | None:
        """Return what is at a fixed point; its tangent goes on in the direction of `before`."""
        matrix = self.matrix(z)
        if not np.isfinite(matrix).all():
            return None
        tangent = np.linalg.svd(matrix)[2][-1]
        tangent = tangent if tangent @ before >= 0.0 else -tangent
        determinant = float(np.linalg.det(np.vstack([matrix, tangent])))
        jacobian = matrix[:, :-1] / self.box.widths
        return _Place(z, tangent, determinant, np.linalg.eigvals(jacobian).astype(np.complex128))

    def is_inside(self, z: FloatArray) -> bool:
        value = z[-1] * self.scale[-1]
        return bool(self.bounds[0] <= value <= self.bounds[1]) and bool(
            self.box.contains(z[:-1] * self.box.widths, _OUTSIDE)
        )


def continuation(flow: Flow, box: Box, index: int, bounds: tuple[float, float]) -> tuple[Branch, ...]:
    """Return the branches of fixed points in `box` as parameter `index` (from 0) goes over `bounds`.

    Branches begin at the fixed points found at the value of the model, where it lies in `bounds`, and at values
    spread over them; one that meets none of these is not seen.
    """
    curve = _Curve(flow, box, index, bounds)
    own = float(flow.parameters[index])
    spread = np.linspace(*bounds, 2 * SEEDED + 1)[1::2].tolist()
    branches: list[Branch] = []
    for value in [*([own] if bounds[0] <= own <= bounds[1] else []), *spread]:
        for fixed in fixed_points(flow.with_parameter(index, value), box).points:
            start = np.append(fixed.point / box.widths, value / curve.scale[-1])
            if len(branches) < MOST_BRANCHES and not any(_passes(each, fixed.point, value, curve) for each in branches):
                branches += _branch(curve, start)
    return tuple(branches)


def _passes(branch: Branch, point: FloatArray, value: float, curve: _Curve) -> bool:
    """Tell whether a branch goes through a fixed point, as far as its points are near enough to tell."""
    scaled = np.hstack([branch.points / curve.box.widths, branch.values[:, None] / curve.scale[-1]])
    start = np.append(point / curve.box.widths, value / curve.scale[-1])
    sides, beside = np.diff(scaled, axis=0), start - scaled[:-1]
    share = np.clip((beside * sides).sum(axis=1) / np.maximum((sides**2).sum(axis=1), 1e-300), 0.0, 1.0)
    return bool((np.abs(beside - share[:, None] * sides).max(axis=1) < 1e-3).any())


def _branch(curve: _Curve, start: FloatArray) -> list[Branch]:
    """Return the branch through `start`, followed to both sides; empty where it cannot be followed at all."""
    matrix = curve.matrix(start)
    if not np.isfinite(matrix).all():
        return []
    tangent = np.linalg.svd(matrix)[2][-1]
    ahead, special = _followed(curve, start, tangent)
    behind, others = _followed(curve, start, -tangent)
    places = [*behind[:0:-1], *ahead]
    if len(places) < 2:
        return []
    states = np.array([each.z[:-1] * curve.box.widths for each in places])
    values = np.array([each.z[-1] * curve.scale[-1] for each in places])
    unstable = np.array([int((each.eigenvalues.real > 0.0).sum()) for each in places], dtype=np.int64)
    return [Branch(values, states, unstable, (*reversed(others), *special))]


def _followed(curve: _Curve, start: FloatArray, tangent: FloatArray) -> tuple[list[_Place], list[SpecialPoint]]:
    first = curve.place(start, tangent)
    places, special, length = ([first] if first is not None else []), [], 0.25 * LONGEST
    while places and len(places) < MOST_POINTS and length > SHORTEST:
        last = places[-1]
        z = curve.corrected(last.z + length * last.tangent, last.tangent)
        after = None if z is None else curve.place(z, last.tangent)
        if after is None or after.tangent @ last.tangent < 0.95 or np.abs(after.z - last.z).max() > 2.0 * length:
            length *= 0.5
            continue
        if not curve.is_inside(after.z):
            break
        special += _special(curve, last, after)
        places.append(after)
        if len(places) > 10 and np.abs(after.z - start).max() < 0.5 * length:
            break
        length = min(1.5 * length, LONGEST)
    return places, special


def _special(curve: _Curve, first: _Place, second: _Place) -> list[SpecialPoint]:
    found = []
    tests: tuple[tuple[str, Callable[[_Place], float]], ...] = (
        ("fold", lambda each: float(each.tangent[-1])),
        ("branch point", lambda each: each.determinant),
        ("Hopf", lambda each: _pair(each)[0]),
    )
    for kind, test in tests:
        if test(first) * test(second) < 0.0:
            place = _bisected(curve, first, second, test)
            frequency = _pair(place)[1] if kind == "Hopf" else None
            if frequency is None or frequency > 1e-6 * np.abs(place.eigenvalues).max():
                value = float(place.z[-1] * curve.scale[-1])
                found.append(SpecialPoint(kind, value, place.z[:-1] * curve.box.widths, frequency))
    crosses = any(each.kind == "branch point" for each in found)
    return [each for each in found if each.kind != "fold" or not crosses]


def _pair(place: _Place) -> tuple[float, float]:
    """Return real part and frequency of the complex pair nearest the imaginary axis; NaN where there is none."""
    pairs = [each for each in place.eigenvalues if each.imag > 0.0]
    nearest = min(pairs, key=lambda each: abs(each.real), default=None)
    return (np.nan, np.nan) if nearest is None else (float(nearest.real), float(nearest.imag))


def _bisected(curve: _Curve, first: _Place, second: _Place, test: Callable[[_Place], float]) -> _Place:
    low, high = first, second
    for _ in range(_BISECTIONS):
        z = curve.corrected(0.5 * (low.z + high.z), low.tangent)
        middle = None if z is None else curve.place(z, low.tangent)
        if middle is None or not np.isfinite(test(middle)) or np.abs(high.z - low.z).max() < 1e-12:
            break
        low, high = (middle, high) if test(low) * test(middle) > 0.0 else (low, middle)
    return low if abs(test(low)) < abs(test(high)) else high


def special_points(branches: Sequence[Branch]) -> list[SpecialPoint]:
    """Return the special points of all branches by rising value of the parameter."""
    return sorted((each for branch in branches for each in branch.special), key=lambda each: each.value)
