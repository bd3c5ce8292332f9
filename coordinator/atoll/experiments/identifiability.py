"""How well the data determine the constants of a model: profile likelihoods, and directions of joint change.

For a profile, one constant is fixed at each of several values, and all other constants and all initial states are
fitted again. All fits use the measurement errors that were estimated from the best fit. The deviance is the sum of
squared residuals over the variances of these errors, minus the same sum of the best fit. For a linear model, it is
exactly the squared distance in standard errors (Bates & Watts 1988, chapter 6). A value lies within the interval if its
deviance is at most the squared quantile of Student's t. For many rows this is the quantile of chi-squared with one
degree of freedom.

The directions are eigenvectors of the curvature (Hessian) of the misfit with respect to the constants, with initial
states eliminated. Each constant is divided by its own size, which corresponds to logarithmic coordinates (Gutenkunst et
al. 2007).

Doubtful: a profile follows one local minimum, so another minimum far away is missed. It ends after 40 values on each
side or at 1,000 times the size of the constant; the interval then counts as open. Letters: P constants, n points of a
profile.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np

from atoll.experiments.fits import (
    EncodedData,
    EquationSetFit,
    FreeConstant,
    constants_of,
    equations_of,
    fit_displayed,
    measured_of,
)
from atoll.terminal.output import attributes, plain
from atoll_coordinator.model.batches import BatchFunction, Spread
from atoll_coordinator.model.shooting.fit_result import TrajectoryFit, covariance
from atoll_coordinator.result.result import Result
from atoll_core.data.dataset import FloatArray
from atoll_core.data.frames import FrameLibrary, frame_of
from atoll_core.data.table import Table
from atoll_core.errors import UsageError
from atoll_core.quoting import enumerated, first_lines

if TYPE_CHECKING:
    import polars

SCHEMA: Final = 1

Determination = Literal[
    "determined", "open above", "open below", "practically non-identifiable", "structurally non-identifiable"
]
"""The interval is closed; it has no upper end, no lower end, or neither end; or the deviance does not change at all
(Raue et al. 2009)."""


@dataclass(frozen=True, eq=False)
class Direction:
    """A direction in the space of constants.

    `error` is the standard error along the direction, relative to the sizes of the constants; it is infinite if the
    data do not determine the direction at all. `weights` (P,) is the unit vector of the direction. `is_sloppy`: the
    data do not determine it. `words` says which combination of the constants is determined; it is "" if the direction
    is not sloppy.
    """

    error: float
    weights: FloatArray
    is_sloppy: bool
    words: str


@dataclass(frozen=True, eq=False)
class ProfiledConstant:
    """A constant with its profile; all values have the sign in the text of the equation.

    `estimate` is the best value. `std_error` is the standard error from the curvature at the best value; it is infinite
    without curvature. `interval` is the interval from the profile. `quadratic` is the estimate minus and plus the
    quantile times the standard error. `values` and `deviances` (n,) are the profile.
    """

    name: str
    variable: str
    is_written: bool
    estimate: float
    std_error: float
    interval: tuple[float, float]
    quadratic: tuple[float, float]
    verdict: Determination
    is_cut: tuple[bool, bool]
    values: FloatArray = field(repr=False)
    deviances: FloatArray = field(repr=False)

    @property
    def _digits(self) -> int:
        """The number of digits that distinguish the ends of the interval, plus two; at least four."""
        largest = max((abs(end) for end in self.interval if math.isfinite(end)), default=0.0)
        width = self.interval[1] - self.interval[0]
        return max(4, math.ceil(math.log10(largest / width)) + 2) if 0.0 < width < largest else 4

    @property
    def sentence(self) -> str:
        """Estimate and interval in a sentence without the name of the constant."""
        low, high = (f"{end:.{self._digits}g}" for end in self.interval)
        ends = {
            "determined": f": {low} to {high}",
            "open above": f": at least {low}",
            "open below": f": at most {high}",
        }
        if all(self.is_cut):
            return f"{self.estimate:.{self._digits}g}, not determined between its bounds {low} and {high}"
        return f"{self.estimate:.{self._digits}g}, {self.verdict}{ends.get(self.verdict, '')}"


@dataclass(frozen=True, eq=False)
class Identifiability:
    """How well the data determine the constants of a model.

    `quantile` is the quantile of Student's t at `level` with `freedom` degrees of freedom; deviances are compared with
    its square. `directions` are directions in the space of all constants, the least determined direction first.
    `source` names the data. Trajectories were simulated in pieces of at most `piece` rows.
    """

    level: float
    freedom: float
    quantile: float
    constants: tuple[ProfiledConstant, ...]
    directions: tuple[Direction, ...]
    source: str
    piece: int

    def __getitem__(self, name: str) -> ProfiledConstant:
        """Return a constant by name; raises KeyError for an unknown name."""
        return {constant.name: constant for constant in self.constants}[name]

    @property
    def sloppy(self) -> tuple[Direction, ...]:
        """The directions that the data do not determine."""
        return tuple(direction for direction in self.directions if direction.is_sloppy)

    def __str__(self) -> str:
        lines = [f"identifiability ({100 * self.level:g} % profile likelihood; {self.source}):"]
        lines += [f"  {constant.name} = {constant.sentence}" for constant in self.constants]
        lines += [f"  {direction.words}" for direction in self.sloppy]
        return "\n".join(lines)

    def __repr__(self) -> str:
        return first_lines(str(self), "print it")

    def to_frame(self, library: FrameLibrary = "polars") -> "polars.DataFrame | Any":
        """Return a ``"polars"`` or ``"pandas"`` frame with a row for each constant.

        `lower` and `upper` are the ends of its interval; an open end is infinite. Raises UsageError without that
        library.
        """
        constants = self.constants
        named = ("name", "variable", "estimate", "std_error", "verdict")
        columns: dict[str, list[object]] = {name: [getattr(each, name) for each in constants] for name in named}
        ends: dict[str, list[object]] = {
            name: [each.interval[place] for each in constants] for place, name in enumerate(("lower", "upper"))
        }
        return frame_of(columns | ends, library)

    def as_dict(self) -> dict[str, object]:
        """Return the identifiability as plain data; null stands for an infinite number."""
        names = [constant.name for constant in self.constants]
        constants = []
        for constant in self.constants:
            data = {**vars(constant), "sentence": constant.sentence}
            constants.append(data | {"profile": {name: data.pop(name) for name in ("values", "deviances")}})
        return plain(
            {
                "schema": SCHEMA,
                **attributes(self, "level", "freedom"),
                "threshold": self.quantile**2,
                "data": self.source,
                "piece": self.piece,
                "constants": constants,
                "directions": [
                    vars(direction) | {"weights": dict(zip(names, direction.weights, strict=True))}
                    for direction in self.directions
                ],
            }
        )


# ------------------------------------------------------------------------------------------------------------ profiles


MOST_STEPS: Final = 40
"""Largest number of values on each side of the best value."""
FARTHEST: Final = 1e3
"""A profile ends when the constant has changed by this multiple of its size."""
_STEPS_INSIDE: Final = 5
_GROWTH: Final = 3.0
_HALVINGS: Final = 5
_SECANTS: Final = 4
_REFINEMENTS: Final = 14
"""Largest number of fits to locate an end of an interval: first by secants, then by bisection."""
_END_ERROR: Final = 1e-3
"""Relative error of the root of the deviance at an end of an interval."""
FLAT: Final = 0.01
"""Smallest deviance that counts as a change: the square of a tenth of a standard error."""


@dataclass(frozen=True, eq=False)
class ConstantProfile:
    """The profile of one constant.

    `values` (n,) ascend and include the best value; `deviances` (n,) belong to them. `path` (n, P) are all constants at
    these values. `lower` and `upper` are the ends of the interval. An end is infinite if the deviance on its side stays
    below the threshold. It is 0 if the constant may be arbitrarily small, but not 0. `is_cut` (lower, upper): the end
    is a bound on the constant, or the model cannot be simulated beyond it.
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
        """Whether all values fit equally well: data of this kind cannot determine the constant."""
        inside = self.deviances[(self.values > self.lower) & (self.values < self.upper)]
        return all(self.is_open) and bool(inside.max(initial=0.0) < FLAT)

    @property
    def is_open(self) -> tuple[bool, bool]:
        """Whether the lower and the upper end are open; an end at 0 is open, because log(0) is infinite.

        If both ends are cut, both are open: the bounds limit the constant, and not the data.
        """
        if all(self.is_cut):
            return True, True
        return math.isinf(self.lower) or self.lower == 0.0, math.isinf(self.upper) or self.upper == 0.0


@dataclass(frozen=True, eq=False)
class _ProfilePoint:
    value: float
    root: float
    fit: TrajectoryFit


def profile(fitted: EquationSetFit, index: int, quantile: float) -> ConstantProfile:
    """Return the profile of constant `index`: on each side up to the value whose root of the deviance is `quantile`."""
    best = float(fitted.values[index])
    start = _ProfilePoint(best, 0.0, fitted.fit)
    sides = [_ProfileSide(fitted, index, quantile, direction).follow(start) for direction in (-1.0, 1.0)]
    points = [*reversed(sides[0][0]), start, *sides[1][0]]
    return ConstantProfile(
        best,
        np.array([point.value for point in points]),
        np.array([math.copysign(point.root**2, point.root) for point in points]),
        np.array([point.fit.system.values for point in points]),
        sides[0][1],
        sides[1][1],
        (sides[0][2], sides[1][2]),
    )


class _ProfileSide:
    """One side of a profile: the fit at each value begins at the extrapolation of the last two fits."""

    def __init__(self, fitted: EquationSetFit, index: int, quantile: float, direction: float) -> None:
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

    def follow(self, start: _ProfilePoint) -> tuple[list[_ProfilePoint], float, bool]:
        """Return the points, the end of the interval, and whether a bound or a failed simulation is the end."""
        aim = self._quantile / _STEPS_INSIDE
        step = min(aim * self._spread, self._size) if self._spread else aim * self._size
        points = [start]
        for _ in range(MOST_STEPS):
            point, step = self._next(points, step)
            if point is None:
                return points[1:], points[-1].value, True
            points.append(point)
            if point.root >= self._quantile:
                inside, end, outside = self._locate_end(points)
                nearer = self._missed_minimum([*points[:-1], *inside], outside)
                if nearer is None:
                    return [*points[1:-1], *inside, point], end, False
                points = [*points[:-1], *inside, nearer]
                continue
            if abs(point.value - start.value) >= FARTHEST * self._size:
                break
            gain = (point.root - points[-2].root) / step
            step = min(max(aim / gain, step / _GROWTH) if gain > 0.0 else math.inf, _GROWTH * step)
        return points[1:], self._direction * math.inf, False

    def _missed_minimum(self, points: list[_ProfilePoint], outside: float) -> _ProfilePoint | None:
        """Return the point at the value `outside`, fitted again from `points`, if the first fit missed the minimum;
        else None.

        Then the deviance jumps: no value was found at which its root is the quantile.
        """
        if points[-1].root >= (1.0 - _END_ERROR) * self._quantile:
            return None
        nearer = self._point(points, outside)
        return nearer if nearer is not None and nearer.root < self._quantile else None

    def _next(self, points: list[_ProfilePoint], step: float) -> tuple[_ProfilePoint | None, float]:
        step = min(step, abs(self._bound - points[-1].value))
        for _ in range(_HALVINGS if step > 0.0 else 0):
            point = self._point(points, points[-1].value + self._direction * step)
            if point is not None:
                return point, step
            step *= 0.3
        return None, step

    def _point(self, points: list[_ProfilePoint], value: float) -> _ProfilePoint | None:
        lower, upper, last = self._lower.copy(), self._upper.copy(), points[-1].fit
        lower[self._index] = upper[self._index] = value
        held = replace(self._fitted.fit.system, lower=lower, upper=upper)
        for constants, starts in (self._extrapolate(points, value), (last.system.values, last.starts)):
            fit = self._fitted.refit(held.with_values(constants), starts)
            if fit is not None:
                deviance = self._fitted.deviance(fit)
                root = math.copysign(math.sqrt(abs(deviance)), deviance)
                return _ProfilePoint(value, root, fit)
        return None

    def _extrapolate(self, points: list[_ProfilePoint], value: float) -> tuple[FloatArray, FloatArray]:
        """Return constants (P,) and initial states (G, D), extrapolated linearly from the last two points."""
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

    def _locate_end(self, points: list[_ProfilePoint]) -> tuple[list[_ProfilePoint], float, float]:
        """Return further points between the last two, the value where the root of the deviance is the quantile, and the
        nearest value beyond it."""
        *before, inside, outside = points
        points_between = list[_ProfilePoint]()
        near, far = inside.root - self._quantile, outside.root - self._quantile
        for number in range(_REFINEMENTS):
            share = near / (near - far) if number < _SECANTS else 0.5
            value = inside.value + share * (outside.value - inside.value)
            if min(abs(near), abs(far)) <= _END_ERROR * self._quantile:
                break
            middle = self._point([*before, inside], value)
            if middle is None or middle.root > self._quantile:
                if middle is None or number >= _SECANTS:
                    near, far = -1.0, 1.0
                else:
                    near, far = 0.5 * near, middle.root - self._quantile  # the Illinois variant of regula falsi
                outside = middle or _ProfilePoint(value, math.inf, inside.fit)
            else:
                points_between.append(middle)
                near, far = middle.root - self._quantile, 0.5 * far
                inside = middle
        return points_between, 0.0 if abs(value) < self._size / FARTHEST else value, outside.value


SLOPPY: Final = 1.0
"""Half width of an interval along a direction, relative to the constants, from which the direction is not determined:
the constants could be twice as large, or 0."""
_SMALLEST_COMPONENT: Final = 0.1
"""Smallest component of a constant that belongs to a direction, as a share of the largest component."""
_LARGEST_CHANGE: Final = 0.1
"""Largest change of a determined relation along a profile, as a share of the change of its terms."""
_LARGEST_POWER: Final = 3
_LEAST_CURVATURE: Final = 1e-11
"""Smallest curvature that is not a rounding error, as a share of the largest eigenvalue."""


def directions(fitted: EquationSetFit, profiles: Sequence[ConstantProfile], names: Sequence[str], signs: FloatArray,
               quantile: float) -> tuple[Direction, ...]:  # fmt: skip
    """Return the directions, the least determined direction first.

    `signs` (P,) are -1 for names that stand for minus the constant. `quantile` is the half width of an interval in
    standard errors.
    """
    sizes = np.maximum(np.abs(fitted.values), 1e-300)
    curvature = np.nan_to_num(fitted.fit.reduced) * np.outer(sizes, sizes)
    values, vectors = np.linalg.eigh(0.5 * (curvature + curvature.T))
    eigendirections = []
    for value, vector in zip(values.tolist(), vectors.T, strict=True):
        error = 1.0 / math.sqrt(value) if value > _LEAST_CURVATURE * values[-1] else math.inf
        is_sloppy = quantile * error >= SLOPPY
        words = _describe(vector, profiles, names, signs, quantile) if is_sloppy else ""
        eigendirections.append(Direction(error, vector * np.sign(vector[np.argmax(np.abs(vector))]), is_sloppy, words))
    return tuple(eigendirections)


def _describe(vector: FloatArray, profiles: Sequence[ConstantProfile], names: Sequence[str], signs: FloatArray,
           quantile: float) -> str:  # fmt: skip
    part: list[int] = np.flatnonzero(np.abs(vector) >= _SMALLEST_COMPONENT * np.abs(vector).max()).tolist()
    is_open = any(any(profiles[index].is_open) for index in part)
    if len(part) == 1:
        return f"{names[part[0]]} is not determined" if is_open else ""
    listed = enumerated([names[index] for index in part])
    lead = max(part, key=lambda index: abs(float(vector[index])))
    inside = profiles[lead].path[profiles[lead].deviances <= quantile**2][:, part] * signs[part]
    relation = relation_of(inside, (names[part[0]], names[part[1]])) if len(part) == 2 else None
    if relation is not None:
        if is_open:
            return f"only {relation} is determined, not {listed} separately"
        return f"{relation} is determined better than {listed} separately"
    shares = ", ".join(f"{names[index]} by {vector[index] / vector[lead]:+.2g} %" for index in part if index != lead)
    return f"{listed} can change together: if {names[lead]} changes by +1 %, {shares}"


def relation_of(path: FloatArray, names: tuple[str, str]) -> str | None:
    """Return a combination of two constants that does not change along a path (n, 2), such as ``a*b``; or None.

    Products of powers up to cubes are tried, and sums. A sum with a factor other than 1 is reported only if no product
    is constant, because along a short path every relation is nearly such a sum.
    """
    product, total = _product(path, names), _sum(path, names)
    if total.change <= min(_LARGEST_CHANGE, product.change) and (total.is_plain or product.change > _LARGEST_CHANGE):
        return total.text
    return product.text if product.change <= _LARGEST_CHANGE else None


@dataclass(frozen=True)
class _ConstantRelation:
    """The change of a relation along a path, divided by the changes of its terms; `is_plain`: it has no factor."""

    change: float = math.inf
    text: str = ""
    is_plain: bool = False


def _product(path: FloatArray, names: tuple[str, str]) -> _ConstantRelation:
    signs = np.sign(path)
    kept = (signs == np.sign(signs.sum(axis=0))).all(axis=1)  # on the other side of 0 another relation may hold
    path = path[kept & (path != 0.0).all(axis=1)]
    if len(path) < max(3, len(signs) // 2):
        return _ConstantRelation()
    logs = np.log(np.abs(path))
    spread = np.ptp(logs, axis=0)
    if not np.all(spread > 0.0):
        return _ConstantRelation()
    ratio = _slope(logs)
    power = Fraction(abs(ratio)).limit_denominator(_LARGEST_POWER)
    if not 0 < power.numerator <= _LARGEST_POWER:
        return _ConstantRelation()
    # along the path, the logarithm of the second constant changes `ratio` times as much as the first logarithm
    first, second = power.numerator, power.denominator * (1 if ratio < 0.0 else -1)
    change = float(np.ptp(first * logs[:, 0] + second * logs[:, 1])) / float(
        first * spread[0] + abs(second) * spread[1]
    )
    operator = "*" if second > 0 else "/"
    return _ConstantRelation(change, f"{_power(names[0], first)}{operator}{_power(names[1], abs(second))}", True)


def _sum(path: FloatArray, names: tuple[str, str]) -> _ConstantRelation:
    spread = np.ptp(path, axis=0) if len(path) > 1 else np.zeros(2)
    if not np.all(spread > 0.0):
        return _ConstantRelation()
    ratio = _slope(path)
    factor = float(f"{abs(ratio):.2g}")
    sign = -1.0 if ratio > 0.0 else 1.0
    change = float(np.ptp(factor * path[:, 0] + sign * path[:, 1])) / float(factor * spread[0] + spread[1])
    first = names[0] if factor == 1.0 else f"{factor:g}*{names[0]}"
    return _ConstantRelation(change, f"{first} {'+' if sign > 0 else '-'} {names[1]}", factor == 1.0)


def _slope(path: FloatArray) -> float:
    """Return the slope of the second column against the first, from the principal axis in scaled units."""
    centred = path - path.mean(axis=0)
    scale = centred.std(axis=0)
    return float(scale[1] / scale[0]) * (1.0 if float(centred[:, 0] @ centred[:, 1]) >= 0.0 else -1.0)


def _power(name: str, power: int) -> str:
    return name if power == 1 else f"{name}**{power}"


MOST_CONSTANTS: Final = 60
"""Largest number of profiled constants; more would take minutes."""
_RESTARTS: Final = 2
_IMPROVEMENT: Final = 0.01
"""A fit on a profile is better than the best fit if its deviance is lower by at least this amount."""

_BY_OPEN_ENDS: Final[Mapping[tuple[bool, bool], Determination]] = {
    (False, False): "determined",
    (False, True): "open above",
    (True, False): "open below",
    (True, True): "practically non-identifiable",
}


def identify(
    result: Result, table: Table | None = None, level: float = 0.95, spread: Spread | None = None
) -> Identifiability:
    """Return how well data determine the constants of a model, as confidence intervals at `level` (0 to 1).

    `table` has the data; None stands for the data of the result. The profiles are independent of each other; `spread`
    distributes them over workers.

    Raises:
        UsageError: the level is invalid, the model has no constants or too many, or there are no measurements.
        AtollError: the model cannot be simulated along the data.
    """
    if not 0.0 < level < 1.0:
        raise UsageError(f"the level must be between 0 and 1, but {level!r} was given")
    measured, equations = measured_of(result, table), equations_of(result)
    if not constants_of(equations, result):
        raise UsageError("the model has no fitted constants, so there is nothing to profile")
    fitted = fit_displayed(measured, result)
    constants = constants_of(fitted.equations, result)
    count = len(constants)
    if count > MOST_CONSTANTS:
        raise UsageError(f"the model has {count} fitted constants; at most {MOST_CONSTANTS} can be profiled")
    from scipy import special

    quantile = float(special.stdtrit(fitted.degrees_of_freedom, 0.5 + level / 2.0))
    fitted, profiles = _profile_all(_Profiler(fitted, quantile, result, table), count, spread or Spread())
    signs = np.array([constant.sign for constant in constants])
    with np.errstate(invalid="ignore"):
        errors = np.sqrt(np.diag(covariance(fitted.fit))).tolist()
    names = [constant.name for constant in constants]
    profiled = [_profiled_constant(*described, quantile) for described in zip(constants, profiles, errors, strict=True)]
    order = sorted(range(count), key=lambda place: _reading_order(constants[place], fitted))
    eigendirections = directions(fitted, profiles, names, signs, quantile)
    return Identifiability(
        level,
        fitted.degrees_of_freedom,
        quantile,
        tuple(profiled[place] for place in order),
        tuple(replace(direction, weights=direction.weights[order]) for direction in eigendirections),
        measured.source,
        fitted.measured.longest,
    )


def _reading_order(constant: FreeConstant, fitted: EquationSetFit) -> tuple[int, bool, int, str]:
    """Return the sort key of a constant: by equation, then in the order of the text, unwritten coefficients last."""
    number = int(constant.name[1:]) if constant.name[:1] == "c" and constant.name[1:].isdigit() else 0
    variables = fitted.equations.variables
    place = variables.index(constant.variable) if constant.variable in variables else len(variables)
    return place, not constant.is_written, number, constant.name


@dataclass(frozen=True)
class _ProfilerParts:
    """The form in which a `_Profiler` is sent to workers."""

    data: EncodedData
    quantile: float
    restarts: tuple[FloatArray, ...]

    def profiler(self) -> "_Profiler":
        result, table = self.data.decode()
        profiler = _Profiler(fit_displayed(measured_of(result, table), result), self.quantile, result, table)
        for values in self.restarts:
            profiler = profiler.from_values(values) or profiler
        return profiler


@dataclass(frozen=True, eq=False)
class _Profiler:
    """Computes profiles of the fit of a result to a table, up to the values whose root of the deviance is `quantile`.

    `restarts` are the constants (P,) from which the result was fitted again, in this order.
    """

    fitted: EquationSetFit
    quantile: float
    result: Result
    table: Table | None
    restarts: tuple[FloatArray, ...] = ()

    def profile(self, index: int) -> ConstantProfile:
        """Return the profile of a constant."""
        return profile(self.fitted, index, self.quantile)

    def from_values(self, values: FloatArray) -> "_Profiler | None":
        """Fit again from other values (P,) of the constants; None if the fit does not improve."""
        fit = self.fitted.refit(self.fitted.fit.system.with_values(values), self.fitted.fit.starts)
        if fit is None or self.fitted.deviance(fit) >= 0.0:
            return None
        return replace(self, fitted=replace(self.fitted, fit=fit), restarts=(*self.restarts, values))

    def parts(self) -> _ProfilerParts:
        return _ProfilerParts(EncodedData.of(self.result, self.table), self.quantile, self.restarts)

    def itself(self) -> "_Profiler":
        return self


_PROFILE: Final = BatchFunction(
    "profile", _ProfilerParts, int, ConstantProfile, _Profiler.profile, _ProfilerParts.profiler
)


def _profile_all(profiler: _Profiler, count: int, spread: Spread) -> tuple[EquationSetFit, list[ConstantProfile]]:
    """Return the fit and the profiles of all constants; if a profile finds a better fit, all are repeated from it."""
    for _ in range(_RESTARTS + 1):
        mapped = spread.map(_PROFILE, profiler.itself, range(count), parts=profiler.parts)
        profiles = [likelihood for likelihood in mapped if likelihood is not None]
        lowest = min(profiles, key=lambda likelihood: float(likelihood.deviances.min()))
        if lowest.deviances.min() > -_IMPROVEMENT:
            break
        better = profiler.from_values(lowest.path[int(np.argmin(lowest.deviances))])
        if better is None:
            break
        profiler = better
    return profiler.fitted, profiles


def _profiled_constant(
    constant: FreeConstant, likelihood: ConstantProfile, error: float, quantile: float
) -> ProfiledConstant:
    half = quantile * error if math.isfinite(error) else math.inf
    ends, cut = (likelihood.lower, likelihood.upper), likelihood.is_cut
    values, deviances = constant.sign * likelihood.values, likelihood.deviances
    is_open = likelihood.is_open
    if constant.sign < 0.0:
        ends, cut, is_open = (-ends[1], -ends[0]), (cut[1], cut[0]), (is_open[1], is_open[0])
        values, deviances = values[::-1], deviances[::-1]
    best = constant.sign * likelihood.best
    return ProfiledConstant(
        constant.name, constant.variable, constant.is_written, best, error, ends, (best - half, best + half),
        "structurally non-identifiable" if likelihood.is_flat else _BY_OPEN_ENDS[is_open], cut, values, deviances,
    )  # fmt: skip
