"""Profile likelihoods: how much worse the data are described as one constant moves and all others are fitted again.

Along a profile the other constants and all initial states are fitted at each value. The errors of the measurements are
those of the best fit, so that the deviance, the sum of squared residuals over their variances beyond that of the best
fit, is exactly the squared distance in standard errors where the model is linear (Bates & Watts 1988, chapter 6). A
value lies within the interval while its deviance is at most the squared quantile of Student's t, which is that of
chi-squared with one degree of freedom where rows are many. Letters: P constants, n points.
"""

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from atoll.experiments.systems import Fitted
from atoll_coordinator.model.shooting.trajectory_fit import TrajectoryFit
from atoll_core.data.dataset import FloatArray

MOST_STEPS: Final = 40
"""Values on either side of the best one."""
FARTHEST: Final = 1e3
"""A constant is followed until it has moved by so many times its size."""
_STEPS_INSIDE: Final = 5
_GROWTH: Final = 3.0
_HALVINGS: Final = 5
_SECANTS: Final = 4
_REFINEMENTS: Final = 14
"""Fits by which an end of an interval is found: the first ones by a secant, then by halving what is left."""
_CLOSE: Final = 1e-3
"""An end of an interval lies where the root of the deviance is the quantile, up to this share."""
FLAT: Final = 0.01
"""Deviance below which nothing is seen of a change: a tenth of a standard error."""


@dataclass(frozen=True, eq=False)
class Profile:
    """The profile of one constant.

    `values` (n,) ascend, the best one among them, with their `deviances` (n,); `path` (n, P) are all constants there.
    `lower` and `upper` are the ends of the interval, infinite where the deviance stays below the threshold as far as it
    was followed, from `values[0]` to `values[-1]`; 0 where the constant may be as small as one likes, but not 0.
    `is_cut` (lower, upper) tells that an end is a bound on the constant, or that the model cannot be simulated beyond.
    """

    best: float
    values: FloatArray
    deviances: FloatArray
    path: FloatArray
    lower: float
    upper: float
    is_cut: tuple[bool, bool]

    @property
    def is_flat(self) -> bool:
        """Whether no value describes the data any worse: nothing in such data could tell the constant."""
        inside = self.deviances[(self.values > self.lower) & (self.values < self.upper)]
        return all(self.is_open) and bool(inside.max() < FLAT)

    @property
    def is_open(self) -> tuple[bool, bool]:
        """Whether the interval has no lower, and no upper end; 0 is none, where the logarithm has none."""
        return math.isinf(self.lower) or self.lower == 0.0, math.isinf(self.upper) or self.upper == 0.0


@dataclass(frozen=True, eq=False)
class _Point:
    """A value, the root of the deviance and the fit of all other constants there."""

    value: float
    root: float
    fit: TrajectoryFit


def profile(fitted: Fitted, index: int, quantile: float) -> Profile:
    """Return the profile of a constant, followed until the root of the deviance is `quantile` on either side."""
    best = float(fitted.values[index])
    start = _Point(best, 0.0, fitted.fit)
    sides = [_Side(fitted, index, quantile, direction).follow(start) for direction in (-1.0, 1.0)]
    points = [*reversed(sides[0][0]), start, *sides[1][0]]
    return Profile(
        best,
        np.array([point.value for point in points]),
        np.array([math.copysign(point.root**2, point.root) for point in points]),
        np.array([point.fit.system.values for point in points]),
        sides[0][1],
        sides[1][1],
        (sides[0][2], sides[1][2]),
    )


class _Side:
    """One side of a profile: values away from the best one, each fitted from where the last two fits point."""

    def __init__(self, fitted: Fitted, index: int, quantile: float, direction: float) -> None:
        self._fitted, self._index, self._quantile, self._direction = fitted, index, quantile, direction
        self._size = abs(float(fitted.values[index])) or self._spread or 1.0
        system = fitted.fit.system
        self._lower = np.full(system.count, -math.inf) if system.lower is None else system.lower
        self._upper = np.full(system.count, math.inf) if system.upper is None else system.upper
        self._bound = float(self._lower[index] if direction < 0.0 else self._upper[index])

    @property
    def _spread(self) -> float:
        variance = float(self._fitted.bounded_covariance[self._index, self._index])
        return math.sqrt(variance) if variance > 0.0 and math.isfinite(variance) else 0.0

    def follow(self, start: _Point) -> tuple[list[_Point], float, bool]:
        """Return the points, the end of the interval, and whether the model cannot be simulated beyond it."""
        aim = self._quantile / _STEPS_INSIDE
        step = min(aim * self._spread, self._size) if self._spread else aim * self._size
        points = [start]
        for _ in range(MOST_STEPS):
            point, step = self._next(points, step)
            if point is None:
                return points[1:], points[-1].value, True
            points.append(point)
            if point.root >= self._quantile:
                inside, end = self._crossing(points)
                return [*points[1:-1], *inside, point], end, False
            if abs(point.value - start.value) >= FARTHEST * self._size:
                break
            gain = (point.root - points[-2].root) / step
            step = min(max(aim / gain, step / _GROWTH) if gain > 0.0 else math.inf, _GROWTH * step)
        return points[1:], self._direction * math.inf, False

    def _next(self, points: list[_Point], step: float) -> tuple[_Point | None, float]:
        """Return the next point and the step to it, a shorter one where the model cannot be simulated or is bounded."""
        step = min(step, abs(self._bound - points[-1].value))
        for _ in range(_HALVINGS if step > 0.0 else 0):
            point = self._point(points, points[-1].value + self._direction * step)
            if point is not None:
                return point, step
            step *= 0.3
        return None, step

    def _point(self, points: list[_Point], value: float) -> _Point | None:
        lower, upper, last = self._lower.copy(), self._upper.copy(), points[-1].fit
        lower[self._index] = upper[self._index] = value
        held = replace(self._fitted.fit.system, lower=lower, upper=upper)
        for constants, starts in (self._foreseen(points, value), (last.system.values, last.starts)):
            fit = self._fitted.again(held.with_values(constants), starts)
            if fit is not None:
                deviance = self._fitted.deviance(fit)
                root = math.copysign(math.sqrt(abs(deviance)), deviance)
                return _Point(value, root, fit)
        return None

    def _foreseen(self, points: list[_Point], value: float) -> tuple[FloatArray, FloatArray]:
        """Return the constants and the initial states that a straight line through the last points gives."""
        last = points[-1]
        constants, starts = last.fit.system.values, last.fit.starts
        if len(points) == 1:
            spread = self._fitted.bounded_covariance[:, self._index]
            slope = spread / spread[self._index] if spread[self._index] > 0.0 else np.zeros(len(spread))
            limit = np.abs(constants)
            return constants + np.clip((value - last.value) * slope, -limit, limit), starts
        before = points[-2]
        share = min((value - last.value) / (last.value - before.value), _GROWTH)
        moved = constants + share * (constants - before.fit.system.values)
        return moved, starts + share * (starts - before.fit.starts)

    def _crossing(self, points: list[_Point]) -> tuple[list[_Point], float]:
        """Return where the root of the deviance is the quantile, and the points fitted on the way."""
        *before, inside, outside = points
        points_between = list[_Point]()
        near, far = inside.root - self._quantile, outside.root - self._quantile
        for number in range(_REFINEMENTS):
            share = near / (near - far) if number < _SECANTS else 0.5
            value = inside.value + share * (outside.value - inside.value)
            if min(abs(near), abs(far)) <= _CLOSE * self._quantile:
                break
            middle = self._point([*before, inside], value)
            if middle is None or middle.root > self._quantile:
                if middle is None or number >= _SECANTS:
                    near, far = -1.0, 1.0
                else:
                    near, far = 0.5 * near, middle.root - self._quantile  # the Illinois variant of regula falsi
                outside = middle or _Point(value, math.inf, inside.fit)
            else:
                points_between.append(middle)
                near, far = middle.root - self._quantile, 0.5 * far
                inside = middle
        return points_between, 0.0 if abs(value) < self._size / FARTHEST else value
