"""Branches of fixed points as one parameter varies, and the path following that branches of limit cycles also use.

The parameter is a constant, an unwritten coefficient, or an input. A constant has its name in the equations (c1, c2,
…). An unwritten coefficient has the name of its term: in dy/dt = y*(2 - x - y), the coefficient of ``x*y`` is an
unwritten 1.

A curve of solutions is followed by steps along its tangent and Newton steps across it (pseudo-arclength, Keller 1977).
A `Curve` object corrects a guess. It also gives the tangent and some tests at each point: numbers whose sign changes
where the character of the solutions changes.

For fixed points the coordinates are (x, p), divided by their ranges. At a fold, the component of the tangent along p
changes its sign. At a branch point, the determinant of the bordered matrix changes its sign. At a Hopf point, a complex
pair of eigenvalues crosses the imaginary axis (Kuznetsov 2004, chapter 10).

Doubtful: a branch is found only if it has a fixed point at the value of the model or at one of three further values.
Letters: D states, P parameters, U inputs, n points or coordinates.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final, Generic, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from atoll.analysis.fixed_points import fixed_points, rate_scale
from atoll.analysis.flow import Box, Flow
from atoll.model.vector_field import VectorField
from atoll_core.data.dataset import FloatArray
from atoll_core.errors import UsageError
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.operators import ARITY, CONSTANT
from atoll_core.expression.program import Program, ProgramBuilder, constant_places
from atoll_core.expression.text.parsing import from_infix
from atoll_core.expression.unit_coefficients import make_coefficients_explicit

_COMPARED_POINTS: Final = 32
"""Number of points at which a term is compared with the derivative with respect to a constant."""

_SAME_FUNCTION: Final = 1e-9
"""Largest relative difference between both if they are the same function: rounding errors."""

_SHORTEST: Final = 1e-6
"""Shortest step along a curve."""

_SMALLEST_COSINE: Final = 0.95
"""Cosine of the largest angle between the tangents of consecutive points. At a larger angle, the step may have jumped
to another curve nearby."""

_EVALUATIONS: Final = 60
"""Largest number of evaluations to locate a special point. Regula falsi takes about ten; bisection would take 43."""

_LOCATION_ERROR: Final = 1e-13
"""Accuracy of a special point as a share of the step: rounding."""

_DETOUR: Final = 0.01
"""Distance from a singular point at which the test is evaluated instead, as a share of the bracket."""

FOLD: Final = "fold"
BRANCH_POINT: Final = "branch point"
HOPF: Final = "Hopf"

MOST_POINTS: Final = 400
"""Largest number of points of one branch in each direction."""

MOST_BRANCHES: Final = 20
"""Largest number of reported branches."""

LONGEST: Final = 0.02
"""Longest step along a branch, in ranges of parameter and box."""

_FURTHER_VALUES: Final = 3
"""Number of values, spread over the range of the parameter, at which branches begin besides the value of the model."""

OUTSIDE: Final = 1.0
"""A branch is followed up to this number of box widths outside of the box."""


# ------------------------------------------------------------------------------------------------------ the parameter


@dataclass(frozen=True, eq=False)
class ContinuationParameter:
    """A number that varies, with its `value` in the model, and the `name` that the user gave.

    The `parameters` (indices) are the number times `factors`. The `inputs` (indices) are equal to the number.
    """

    name: str
    value: float
    parameters: tuple[int, ...] = ()
    factors: tuple[float, ...] = ()
    inputs: tuple[int, ...] = ()

    def at(self, flow: Flow, value: float) -> Flow:
        """Return the flow at another `value` of the number."""
        parameters, inputs = flow.parameters.copy(), flow.inputs.copy()
        parameters[list(self.parameters)] = value * np.array(self.factors)
        inputs[list(self.inputs)] = value
        return replace(flow, parameters=parameters, inputs=inputs)

    def slope(self, flow: Flow, x: FloatArray) -> FloatArray:
        """Return the derivative (N, D) of the rates at points (N, D) with respect to the value."""
        slope = np.zeros(x.shape)
        if self.parameters:
            derivatives = flow.field.parameter_derivatives(x, flow.inputs, flow.parameters)
            slope = slope + derivatives[..., list(self.parameters)] @ np.array(self.factors)
        if self.inputs:
            derivatives = flow.field.input_derivatives(x, flow.inputs, flow.parameters)
            slope = slope + derivatives[..., list(self.inputs)].sum(axis=-1)
        return flow.direction * slope


@dataclass(frozen=True, eq=False)
class Coefficients:
    """The numbers of a field that can vary: all constants, and coefficients of 1 that the text does not show.

    They are the parameters of `explicit`. `origins` has the index of each among the parameters of `field`; it is None
    for an unwritten coefficient.
    """

    field: VectorField
    explicit: VectorField
    origins: tuple[int | None, ...]

    @classmethod
    def of(cls, field: VectorField) -> "Coefficients":
        """Return the coefficients of a field."""
        programs: list[Program] = []
        origins: list[int | None] = []
        begin = 0
        for program in field.programs:
            explicit = make_coefficients_explicit(program)
            separate, own = _separate_uses(explicit.program, explicit.origins)
            programs.append(separate)
            origins += [None if origin is None else begin + origin for origin in own]
            begin += len(constant_places(program))
        return cls(field, replace(field, programs=tuple(programs), constant_names=()), tuple(origins))

    @cached_property
    def units(self) -> tuple[str, ...]:
        """The names of the unwritten coefficients: ``y:x*y`` is the coefficient of x*y in dy/dt."""
        values = self._values(self.field.values_of_parameters)
        return tuple(
            f"{parameter.variable}:{self.explicit.term_of(index, values)}"
            for index, (parameter, origin) in enumerate(zip(self.explicit.parameters, self.origins, strict=True))
            if origin is None
        )

    def find(self, flow: Flow, name: str) -> tuple[Flow, ContinuationParameter]:
        """Return a flow and its parameter by name: constants (separated by commas), a term, or an input.

        Several constants keep their ratios to the first one. Raises UsageError for an unknown name, or if the first
        constant is 0.
        """
        if name in flow.field.inputs:
            place = flow.field.inputs.index(name)
            return flow, ContinuationParameter(name, float(flow.inputs[place]), inputs=(place,))
        parts = [part.strip() for part in name.split(",")]
        indices = [index for part in parts for index in self._indices(part)]
        values = self._values(flow.parameters)
        named = [float(values[index]) for index in indices]
        if named[0] == 0.0 and any(named):
            raise UsageError(
                f"{parts[0]} is 0, so the other constants have no ratio to it; name another constant first"
            )
        factors = tuple(value / named[0] if named[0] else 1.0 for value in named)
        varied = replace(flow, field=self.explicit, parameters=values)
        return varied, ContinuationParameter(name, named[0], tuple(indices), factors)

    def _values(self, parameters: FloatArray) -> FloatArray:
        return np.array([1.0 if origin is None else float(parameters[origin]) for origin in self.origins])

    def _indices(self, name: str) -> list[int]:
        """Return the parameters of `explicit` by name: all uses of one constant, or the coefficient of one term."""
        constants = self.field.parameters
        named = [place for place, known in enumerate(constants) if known.name == name and name]
        numbered = [place for place, known in enumerate(constants) if str(place + 1) == name and known.name]
        if named or numbered:
            return [index for index, origin in enumerate(self.origins) if origin in (named or numbered)]
        indices = self._term_indices(name)
        if len(indices) == 1:
            return indices
        fault = f"'{name}' occurs in several equations" if indices else f"there is no parameter '{name}'"
        known = ", ".join(
            f"{name} = {one.value:g} of {one.variable}" for name, one in self.field.named_parameters.items()
        )
        others = [*self.units, *self.field.inputs]
        more = f"; you can also vary {', '.join(others)}" if others else ""
        raise UsageError(f"{fault}; the model has {known or 'no constants'}{more}")

    def _term_indices(self, name: str) -> list[int]:
        """Return the indices of the coefficients of a term: ``x*y``, or ``y:x*y`` with its equation."""
        names = (*self.field.states, *self.field.inputs)
        variable, separator, text = name.rpartition(":")
        try:
            program = from_infix(text, names)
        except UsageError:
            return []
        points = np.random.default_rng(0).uniform(0.5, 1.5, (_COMPARED_POINTS, len(names)))
        values = values_of(program, np.ascontiguousarray(points.T))
        states, inputs = points[:, : len(self.field.states)], points[:, len(self.field.states) :]
        own = self._values(self.field.values_of_parameters)
        slopes = self.explicit.parameter_derivatives(states, inputs, own)
        indices = []
        for index, constant in enumerate(self.explicit.parameters):
            slope = slopes[:, self.explicit.states.index(constant.variable), index]
            difference = min(np.abs(slope - values).max(), np.abs(slope + values).max())
            if (not separator or variable == constant.variable) and difference <= _SAME_FUNCTION * np.abs(values).max():
                indices.append(index)
        return indices


def _separate_uses(program: Program, origins: Sequence[int | None]) -> tuple[Program, tuple[int | None, ...]]:
    """Return a program in which each use of a constant is a separate constant, and the origins in node order."""
    nodes, builder = program.nodes(), ProgramBuilder()
    numbers = dict(zip(constant_places(program), origins, strict=True))
    used: dict[int, int | None] = {}
    places: list[int] = []

    def use(old: int) -> int:
        if nodes[old][0] != CONSTANT:
            return places[old]
        new = builder.append(CONSTANT, value=nodes[old][3])
        used[new] = numbers[old]
        return new

    for code, left, right, value in nodes:
        if code == CONSTANT:
            places.append(-1)  # copied where it is used
        elif ARITY[code]:
            places.append(builder.append(code, use(left), use(right) if ARITY[code] == 2 else 0))
        else:
            places.append(builder.append(code, left, right, value))
    return builder.program(use(len(nodes) - 1)), tuple(used.values())


# ----------------------------------------------------------------------------------------------------- path following


@dataclass(frozen=True, eq=False)
class CurvePoint:
    """A point `z` (n,) of a curve with its unit `tangent` (n,), and its `tests` by kind of special point."""

    z: FloatArray
    tangent: FloatArray
    tests: Mapping[str, float]


PointT = TypeVar("PointT", bound=CurvePoint)


class Curve(Protocol[PointT]):
    """A curve in n coordinates of about the same scale; the last one is the parameter.

    `correct` and `curve_point` return None if a rate is undefined or no point of the curve is near.
    """

    longest: float
    """Longest step."""

    most: int
    """Largest number of points on each side of the first point."""

    limits: tuple[float, float]
    """Range of the last coordinate; a curve that leaves the range ends at its limit."""

    def correct(self, z: FloatArray, tangent: FloatArray) -> FloatArray | None:
        """Return the point of the curve in the plane through `z` across `tangent`."""

    def curve_point(self, z: FloatArray, before: FloatArray) -> PointT | None:
        """Return the point `z` with its tests; its tangent continues in the direction of `before`."""

    def end(self, last: PointT, after: PointT) -> str | None:
        """Return why the curve ends before `after`; None if it continues."""

    def adapt(self, point: PointT) -> PointT:
        """Return the same point in the coordinates for the following steps."""
        ...


@dataclass(frozen=True, eq=False)
class CurveSide(Generic[PointT]):
    """One side of a curve: its `points` in order, its `special` points with their kinds, and why it ends."""

    points: list[PointT]
    special: list[tuple[str, PointT]]
    end: str


def join_sides(behind: CurveSide[PointT], ahead: CurveSide[PointT]) -> tuple[list[PointT], list[tuple[str, PointT]]]:
    """Return the points and the special points of a curve, from two sides with the same first point."""
    return [*behind.points[:0:-1], *ahead.points], [*reversed(behind.special), *ahead.special]


def continue_curve(curve: Curve[PointT], start: FloatArray, direction: FloatArray) -> CurveSide[PointT]:
    """Follow `curve` from `start` (n,) in a `direction` (n,)."""
    first = curve.curve_point(start, direction)
    if first is None:
        return CurveSide([], [], "no rates")
    points, length = [first], 0.25 * curve.longest
    special: list[tuple[str, PointT]] = []
    while len(points) < curve.most:
        last = points[-1]
        z = curve.correct(last.z + length * last.tangent, last.tangent)
        after = None if z is None else curve.curve_point(z, last.tangent)
        if after is None or after.tangent @ last.tangent < _SMALLEST_COSINE or _length(after.z - last.z) > 2.0 * length:
            length *= 0.5
            if length < _SHORTEST:
                return CurveSide(points, special, "steps have become too short")
            continue
        end = curve.end(last, after)
        if end is not None:
            return CurveSide(points, special, end)
        if not curve.limits[0] <= after.z[-1] <= curve.limits[1]:
            limit = curve.limits[0] if after.z[-1] < curve.limits[0] else curve.limits[1]
            share = (limit - last.z[-1]) / (after.z[-1] - last.z[-1])
            final = _correct_between(curve, last, after, share, np.append(np.zeros(len(last.z) - 1), 1.0))
            if final is not None:
                special += _find_special_points(curve, last, final)
                points.append(final)
            return CurveSide(points, special, "end of the range")
        special += _find_special_points(curve, last, after)
        points.append(curve.adapt(after))
        if len(points) > 10 and len(after.z) == len(start) and _length(after.z - start) < 0.5 * length:
            return CurveSide(points, special, "closed")
        length = min(1.5 * length, curve.longest)
    return CurveSide(points, special, f"{curve.most} points")


def _length(step: FloatArray) -> float:
    return float(np.sqrt(step @ step))


def _find_special_points(curve: Curve[PointT], first: PointT, second: PointT) -> list[tuple[str, PointT]]:
    """Return the special points between two points, each with its kind. At a special point a test changes its sign.

    At a branch point the test for a fold may also change its sign, but this is not a fold.
    """
    kinds = [kind for kind in first.tests if first.tests[kind] * second.tests[kind] < 0.0]
    if BRANCH_POINT in kinds and FOLD in kinds:
        kinds.remove(FOLD)
    return [(kind, _locate(curve, first, second, kind)) for kind in kinds]


def _locate(curve: Curve[PointT], first: PointT, second: PointT, kind: str) -> PointT:
    """Return the point between two points where a test is 0, by regula falsi (Illinois variant).

    SciPy's root finders cannot be used: they need a value everywhere, and a test has no value at a branch point.
    """
    best = min((first, second), key=lambda point: abs(point.tests[kind]))
    low, high = 0.0, 1.0
    low_value, high_value = first.tests[kind], second.tests[kind]
    for _ in range(_EVALUATIONS):
        share = (low * high_value - high * low_value) / (high_value - low_value)
        point = _correct_between(curve, first, second, share, first.tangent)
        if point is None:  # the matrix of Newton steps is singular at a branch point: move aside
            share += _DETOUR * (high - share)
            point = _correct_between(curve, first, second, share, first.tangent)
        if point is None or not np.isfinite(point.tests[kind]):
            break
        value = point.tests[kind]
        best = point if abs(value) <= abs(best.tests[kind]) else best
        if value * high_value < 0.0:
            low, low_value = high, high_value
        else:
            low_value *= 0.5
        is_done = abs(high - share) < _LOCATION_ERROR or value == 0.0
        high, high_value = share, value
        if is_done:
            break
    return best


def _correct_between(
    curve: Curve[PointT], first: PointT, second: PointT, share: float, across: FloatArray
) -> PointT | None:
    z = curve.correct(first.z + share * (second.z - first.z), across)
    return None if z is None else curve.curve_point(z, first.tangent)


# ------------------------------------------------------------------------------------------- branches of fixed points


@dataclass(frozen=True, eq=False)
class SpecialPoint:
    """A point (D,) where the character of a branch changes, with the `value` of the parameter.

    `kind` is fold, branch point or Hopf. A Hopf point has the `frequency` of its eigenvalues in radians per time.
    """

    kind: str
    value: float
    point: FloatArray
    frequency: float | None = None


@dataclass(frozen=True, eq=False)
class Branch:
    """Fixed points (n, D) at `values` (n,) of the parameter; `unstable` (n,) counts their unstable eigenvalues."""

    values: FloatArray = field(repr=False)
    points: FloatArray = field(repr=False)
    unstable: npt.NDArray[np.int64] = field(repr=False)
    special: tuple[SpecialPoint, ...]


@dataclass(frozen=True, eq=False)
class _FixedPointOnCurve(CurvePoint):
    eigenvalues: npt.NDArray[np.complex128]


class _FixedPointCurve:
    """Fixed points in scaled coordinates z = (x / widths, p / range) of shape (D + 1,)."""

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
        """Return the derivative (D, D + 1) of the rates, divided by their typical sizes, with respect to z."""
        flow, x = self.at(z), z[:-1] * self.box.widths
        by_x = np.hstack([flow.jacobian(x), self.parameter.slope(flow, x[None]).T])
        return np.asarray(by_x / self._rates[:, None] * self.scale)

    def correct(self, z: FloatArray, tangent: FloatArray) -> FloatArray | None:
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
    """Return the branches of fixed points in `box` as `parameter` varies over `bounds`.

    Branches begin at the fixed points for the value of the model, if it lies in `bounds`, and for three values spread
    over `bounds`. A branch without such a fixed point is missed.
    """
    curve = _FixedPointCurve(flow, box, parameter, bounds)
    own = parameter.value
    spread = np.linspace(*bounds, 2 * _FURTHER_VALUES + 1)[1::2].tolist()
    branches: list[Branch] = []
    for value in [*([own] if bounds[0] <= own <= bounds[1] else []), *spread]:
        for fixed in fixed_points(parameter.at(flow, value), box).points:
            start = np.append(fixed.point / box.widths, value / curve.scale[-1])
            is_known = any(_passes(branch, start, curve) for branch in branches)
            if len(branches) < MOST_BRANCHES and not is_known:
                branches += _branch(curve, start)
    return tuple(branches)


def _passes(branch: Branch, start: FloatArray, curve: _FixedPointCurve) -> bool:
    """Tell whether a branch passes through the scaled point `start` (D + 1,), from the chords between its points."""
    scaled = np.hstack([branch.points / curve.box.widths, branch.values[:, None] / curve.scale[-1]])
    sides, away = np.diff(scaled, axis=0), start - scaled[:-1]
    share = np.clip((away * sides).sum(axis=1) / np.maximum((sides**2).sum(axis=1), 1e-300), 0.0, 1.0)
    return bool((np.abs(away - share[:, None] * sides).max(axis=1) < 1e-3).any())


def _branch(curve: _FixedPointCurve, start: FloatArray) -> list[Branch]:
    """Return the branch through `start` (D + 1,), followed to both sides; empty if it cannot be followed at all."""
    matrix = curve.matrix(start)
    if not np.isfinite(matrix).all():
        return []
    tangent = np.linalg.svd(matrix)[2][-1]
    ahead, behind = continue_curve(curve, start, tangent), continue_curve(curve, start, -tangent)
    points, special = join_sides(behind, ahead)
    if len(points) < 2:
        return []
    states = np.array([point.z[:-1] * curve.box.widths for point in points])
    values = np.array([point.z[-1] * curve.scale[-1] for point in points])
    unstable = np.array([int((point.eigenvalues.real > 0.0).sum()) for point in points], dtype=np.int64)
    described = []
    for kind, point in special:
        frequency = _pair(point.eigenvalues)[1] if kind == HOPF else None
        # two real eigenvalues of opposite sign are not a Hopf point
        if frequency is None or frequency > 1e-6 * np.abs(point.eigenvalues).max():
            value = float(point.z[-1] * curve.scale[-1])
            described.append(SpecialPoint(kind, value, point.z[:-1] * curve.box.widths, frequency))
    return [Branch(values, states, unstable, tuple(described))]


def _pair(eigenvalues: npt.NDArray[np.complex128]) -> tuple[float, float]:
    """Return real part and frequency of the complex pair nearest to the imaginary axis; NaN without a pair."""
    pairs = [eigenvalue for eigenvalue in eigenvalues if eigenvalue.imag > 0.0]
    nearest = min(pairs, key=lambda eigenvalue: abs(eigenvalue.real), default=None)
    return (np.nan, np.nan) if nearest is None else (float(nearest.real), float(nearest.imag))


def special_points(branches: Sequence[Branch]) -> list[SpecialPoint]:
    """Return the special points of all branches, ordered by the value of the parameter."""
    return sorted((point for branch in branches for point in branch.special), key=lambda point: point.value)
