"""Curves of solutions as one parameter varies: steps along the tangent, Newton steps across it (Keller 1977).

A curve says what it is a curve of: it corrects a guess, and tells of each of its points the tangent and tests, numbers
that change their signs where the character of the solutions does. Letters: n coordinates, all of about the same scale,
the parameter last.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Generic, Protocol, TypeVar

import numpy as np

from atoll_core.data.dataset import FloatArray

SHORTEST: Final = 1e-6
"""Shortest step along a curve."""

FOLD: Final = "fold"
BRANCH_POINT: Final = "branch point"

_STRAIGHT: Final = 0.95
"""Cosine of the largest angle between tangents one step apart: larger angles may hide a second curve close by."""

_EVALUATIONS: Final = 60
"""Regula falsi takes about ten; bisection to `_LOCATED` would take 43."""

_LOCATED: Final = 1e-13
"""Share of the last step within which a special point is located: what rounding leaves."""

_BESIDE: Final = 0.01
"""Share of the bracket by which a singular point is avoided."""


@dataclass(frozen=True, eq=False)
class CurvePoint:
    """A point `z` (n,) of a curve with its unit `tangent` (n,), and its `tests` by kind of special point."""

    z: FloatArray
    tangent: FloatArray
    tests: Mapping[str, float]


PointT = TypeVar("PointT", bound=CurvePoint)


class Curve(Protocol[PointT]):
    """What a curve knows of its points; all return None where a rate has no finite value, or nothing is near."""

    longest: float
    """Longest step."""

    most: int
    """Points on each side of the first one."""

    limits: tuple[float, float]
    """Between which values of its last coordinate it is followed; its last point is at one of these."""

    def correct(self, z: FloatArray, tangent: FloatArray) -> FloatArray | None:
        """Return the point of the curve in the plane through `z` across `tangent`."""

    def curve_point(self, z: FloatArray, before: FloatArray) -> PointT | None:
        """Return what is known of the point `z` of the curve; its tangent goes on in the direction of `before`."""

    def end(self, last: PointT, after: PointT) -> str | None:
        """Return why the curve is not followed to `after`; None where it is."""

    def adapt(self, point: PointT) -> PointT:
        """Return a point in the coordinates in which the curve is followed from there."""
        ...


@dataclass(frozen=True, eq=False)
class Side(Generic[PointT]):
    """One side of a curve: its `points` from the first one, the special ones by kind in this order, and its end."""

    points: list[PointT]
    special: list[tuple[str, PointT]]
    end: str


def joined(behind: Side[PointT], ahead: Side[PointT]) -> tuple[list[PointT], list[tuple[str, PointT]]]:
    """Return the points of two sides from the same first one, and the special points, along the curve."""
    return [*behind.points[:0:-1], *ahead.points], [*reversed(behind.special), *ahead.special]


def continue_curve(curve: Curve[PointT], start: FloatArray, direction: FloatArray) -> Side[PointT]:
    """Return the points of `curve` from `start` (n,) in a direction (n,)."""
    first = curve.curve_point(start, direction)
    if first is None:
        return Side([], [], "no rates")
    points, length = [first], 0.25 * curve.longest
    special: list[tuple[str, PointT]] = []
    while len(points) < curve.most:
        last = points[-1]
        z = curve.correct(last.z + length * last.tangent, last.tangent)
        after = None if z is None else curve.curve_point(z, last.tangent)
        if after is None or after.tangent @ last.tangent < _STRAIGHT or _far(after.z - last.z) > 2.0 * length:
            length *= 0.5
            if length < SHORTEST:
                return Side(points, special, "steps have become too short")
            continue
        end = curve.end(last, after)
        if end is not None:
            return Side(points, special, end)
        if not curve.limits[0] <= after.z[-1] <= curve.limits[1]:
            limit = curve.limits[0] if after.z[-1] < curve.limits[0] else curve.limits[1]
            share = (limit - last.z[-1]) / (after.z[-1] - last.z[-1])
            final = _between(curve, last, after, share, np.append(np.zeros(len(last.z) - 1), 1.0))
            if final is not None:
                special += locate_special_points(curve, last, final)
                points.append(final)
            return Side(points, special, "end of the range")
        special += locate_special_points(curve, last, after)
        points.append(curve.adapt(after))
        if len(points) > 10 and len(after.z) == len(start) and _far(after.z - start) < 0.5 * length:
            return Side(points, special, "closed")
        length = min(1.5 * length, curve.longest)
    return Side(points, special, f"{curve.most} points")


def _far(step: FloatArray) -> float:
    return float(np.sqrt(step @ step))


def locate_special_points(curve: Curve[PointT], first: PointT, second: PointT) -> list[tuple[str, PointT]]:
    """Return the special points between two points, where a test changes its sign, each with its kind.

    At a branch point the tangent of the curve may turn as well: that is no fold.
    """
    kinds = [kind for kind in first.tests if first.tests[kind] * second.tests[kind] < 0.0]
    if BRANCH_POINT in kinds and FOLD in kinds:
        kinds.remove(FOLD)
    return [(kind, locate_special_point(curve, first, second, kind)) for kind in kinds]


def locate_special_point(curve: Curve[PointT], first: PointT, second: PointT, kind: str) -> PointT:
    """Return the point between two where a test vanishes, by regula falsi (the Illinois variant)."""
    best = min((first, second), key=lambda point: abs(point.tests[kind]))
    low, high = 0.0, 1.0
    low_value, high_value = first.tests[kind], second.tests[kind]
    for _ in range(_EVALUATIONS):
        share = (low * high_value - high * low_value) / (high_value - low_value)
        point = _between(curve, first, second, share, first.tangent)
        if point is None:  # at a branch point itself Newton steps have no matrix to go by: go beside it
            share += _BESIDE * (high - share)
            point = _between(curve, first, second, share, first.tangent)
        if point is None or not np.isfinite(point.tests[kind]):
            break
        value = point.tests[kind]
        best = point if abs(value) <= abs(best.tests[kind]) else best
        if value * high_value < 0.0:
            low, low_value = high, high_value
        else:
            low_value *= 0.5
        is_done = abs(high - share) < _LOCATED or value == 0.0
        high, high_value = share, value
        if is_done:
            break
    return best


def _between(curve: Curve[PointT], first: PointT, second: PointT, share: float, across: FloatArray) -> PointT | None:
    """Return the point of the curve in the plane across a direction that lies at a share of the way between two."""
    z = curve.correct(first.z + share * (second.z - first.z), across)
    return None if z is None else curve.curve_point(z, first.tangent)
