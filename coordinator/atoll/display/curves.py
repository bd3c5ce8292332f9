"""The numbers and labels of the pictures of a result, for Matplotlib, a report and a page.

A result lists a simulation only at measured rows. Between the rows, the model is integrated again. Enough points are
kept that a curve looks smooth: its straight lines differ from it by less than a pixel. The integration starts at the
fitted initial state. If the trajectory was fitted in pieces, this simulation differs from the listed rows; then the
integration starts again at each listed row. Letters: D states, N rows, M points of a curve.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np
import numpy.typing as npt

from atoll.model.arguments import input_curves, inputs_along, values_of_curve
from atoll.model.equations import differing_groups
from atoll.model.simulation import Inputs, simulate
from atoll_coordinator.result.base import Curve
from atoll_coordinator.result.equations import Member
from atoll_coordinator.result.listed_trajectories import Simulated
from atoll_coordinator.result.result import Result
from atoll_core.data.dataset import FloatArray
from atoll_core.errors import AtollError

if TYPE_CHECKING:
    from atoll.model.core import ModelCore


def label(result: Result, column: str) -> str:
    """Return the name of a column with its unit."""
    unit = result.units.get(column)
    return f"{column} [{unit}]" if unit else column


def residuals(measured: Curve, simulated: Curve) -> list[float | None]:
    """Return measured minus simulated values (N,), None if one of both is not known."""
    pairs = zip(measured, simulated, strict=True)
    return [None if value is None or known is None else value - known for value, known in pairs]


def front(members: Sequence[Member], *, is_selected: bool = False) -> tuple[list[int], list[float | None]]:
    """Return complexities and errors of the members of a front that have an error, or only of selected members."""
    displayed = [member for member in members if member.normalized_error and (member.selected or not is_selected)]
    return [member.complexity or 0 for member in displayed], [member.normalized_error for member in displayed]


TOLERANCE: Final = 5e-4
"""Largest distance between a curve and its straight lines, as a share of its range: less than a pixel."""
MOST_POINTS: Final = 4_000
"""Largest number of points of a curve: several for each pixel."""
SHOWN: Final = 6
"""Largest number of trajectories in a picture, each in a different colour."""
_GRIDS: Final = (2_000, 8_000, 32_000)
"""Numbers of points of a simulation. The next number is used if the curve bends between the points."""
_AGREEMENT: Final = TOLERANCE
"""Simulations with smaller differences count as equal; a share of the range of a state, invisible in a picture.

Doubtful: it was measured on only eight results. Seven of them look the same for all values from 1e-4 to 1e-1. The
eighth was fitted in two pieces, which differ by 1e-3 to 5e-3 at one row; smaller values detect both pieces.
"""
_TINY: Final = float(np.finfo(np.float64).tiny)
_SUBSTEPS: Final = 24
"""Steps of the Runge-Kutta method between two listed rows."""


@dataclass(frozen=True)
class ModelCurves:
    """A simulated trajectory for a picture.

    `times` (M,) are the times of the points. `values` are the curves (M,) by state; `lower` and `upper` are the bounds
    of the 95 % band, if standard errors are known. Entries are None at unknown values and between two pieces. `pieces`
    is the number of initial states of the simulation, None if it is not known.
    """

    times: Curve
    values: Mapping[str, Curve]
    lower: Mapping[str, Curve] | None = None
    upper: Mapping[str, Curve] | None = None
    pieces: int | None = None


@dataclass(frozen=True)
class _ListedRows:
    """The listed rows of a trajectory: ascending times (N,), and values (D, N) of the listed states."""

    states: tuple[str, ...]
    times: FloatArray
    values: FloatArray

    @property
    def sizes(self) -> FloatArray:
        """The range (D, 1) of each state, above 0."""
        low, high = np.nanmin(self.values, axis=1), np.nanmax(self.values, axis=1)
        sizes: FloatArray = np.maximum(high - low, 1e-9 * np.maximum(np.abs(low), np.abs(high)) + _TINY)
        return sizes[:, None]


def curves_of(model: "ModelCore | None", part: Simulated) -> ModelCurves:
    """Return the curves of a simulated trajectory of a result with this `model`.

    Without a model, or if the model cannot be simulated, these are the listed rows. It raises no errors.
    """
    listed = ModelCurves(part.times, part.values or {}, part.lower, part.upper)
    known = _listed_rows(part)
    if model is None or model.is_regression or known is None:
        return listed
    groups = model.result.groups if differing_groups(model.result) else ()
    own = next((model.of_group(group.group) for group in groups if part.name in group.trajectories), model)
    recorded = next((each for each in own.result.recorded if each.name == part.name), None)
    curves = {} if recorded is None else input_curves(own.result, recorded)
    try:
        inputs = inputs_along(own, None, known.times, curves)
        found = _from_start(own, part, known, inputs) or _between_rows(own, known, inputs)
    except AtollError:  # such as an input that was not recorded
        return listed
    return listed if found is None else _with_bands(known, part, *found)


def choose_trajectories(parts: Sequence[Simulated]) -> list[Simulated]:
    """Return the simulated trajectories; if there are more than `SHOWN`, a selection from the worst to the best fit."""
    known = [part for part in parts if part.values]
    if len(known) <= SHOWN:
        return known
    known.sort(key=lambda part: min((value for value in part.r2.values() if value is not None), default=0.0))
    return [known[index * (len(known) - 1) // (SHOWN - 1)] for index in range(SHOWN)]


def bends(values: FloatArray, times: FloatArray, tolerance: float = TOLERANCE) -> npt.NDArray[np.int64]:
    """Return the indices (M,) of points whose straight lines approximate curves (D, n) within a tolerance.

    The tolerance is a share of the range of each curve. It grows until at most `MOST_POINTS` points are needed. Times
    (n,) ascend, and all values must be finite.
    """
    sizes = np.ptp(values, axis=1, keepdims=True)
    scaled = values / np.where(sizes > 0.0, sizes, 1.0)
    kept = _corners(scaled, times, tolerance)
    while len(kept) > MOST_POINTS:
        tolerance *= 2.0
        kept = _corners(scaled, times, tolerance)
    return kept


def _corners(scaled: FloatArray, times: FloatArray, tolerance: float) -> npt.NDArray[np.int64]:
    """Return the indices (M,) of points by the method of Douglas and Peucker, with vertical distances."""
    last = len(times) - 1
    kept, waiting = {0, last}, [(0, last)]
    while waiting:
        first, end = waiting.pop()
        if end - first < 2:
            continue
        inner = slice(first + 1, end)
        share = (times[inner] - times[first]) / (times[end] - times[first])
        line = scaled[:, [first]] + share * (scaled[:, [end]] - scaled[:, [first]])
        distances = np.abs(scaled[:, inner] - line).max(axis=0)
        place = int(distances.argmax())
        if distances[place] > tolerance:
            corner = first + 1 + place
            kept.add(corner)
            waiting += [(first, corner), (corner, end)]
    return np.array(sorted(kept))


def _listed_rows(part: Simulated) -> _ListedRows | None:
    if not part.values:
        return None
    times, values = values_of_curve(part.times), np.array([values_of_curve(curve) for curve in part.values.values()])
    is_known = np.isfinite(times) & np.isfinite(values).all(axis=0)
    times, values = times[is_known], values[:, is_known]
    if len(times) < 2 or (np.diff(times) <= 0.0).any():
        return None
    return _ListedRows(tuple(part.values), times, values)


_SimulatedPieces = tuple[FloatArray, FloatArray, int]
"""Times (M,), values (D, M) of the listed states (NaN between pieces), and the number of pieces."""


def _from_start(
    model: "ModelCore", part: Simulated, known: _ListedRows, inputs: Inputs | None
) -> _SimulatedPieces | None:
    """Return the simulation from the fitted initial state; None if it differs from the listed rows."""
    columns = [model.result.columns_by_symbol[state] for state in model.states]
    start = np.array([(part.start or {}).get(column) for column in columns], dtype=np.float64)
    every = [*columns, *model.observed_columns]
    places = [every.index(state) for state in known.states if state in every]
    if not np.isfinite(start).all() or len(places) < len(known.states):
        return None
    offsets = np.array([part.offsets.get(state) or 0.0 for state in known.states])[:, None]
    first, last = known.times[0], known.times[-1]
    for points in _GRIDS:
        even = np.linspace(first, last, points)
        after = np.clip(np.searchsorted(known.times, even), 1, len(known.times) - 1)
        gaps = np.minimum(np.abs(even - known.times[after - 1]), np.abs(even - known.times[after]))
        grid = np.union1d(known.times, even[gaps > 1e-9 * (last - first)])
        simulation = simulate(model.field, start, grid, inputs, observed=model.observed)
        if len(simulation.t) < len(grid):
            return None
        values = np.array([curve.values for curve in simulation.curves.values()])[places] + offsets
        at_rows = values[:, np.searchsorted(grid, known.times)]
        if (np.abs(at_rows - known.values) > _AGREEMENT * known.sizes).any():
            return None
        if _is_fine(values / known.sizes, grid):
            break
    kept = bends(values, grid)
    return grid[kept], values[:, kept], 1


def _is_fine(scaled: FloatArray, grid: FloatArray) -> bool:
    """Tell whether straight lines between points are accurate enough: every second point is compared with a line."""
    before, middle, after = grid[:-2:2], grid[1:-1:2], grid[2::2]
    share = (middle - before) / (after - before)
    lines = scaled[:, :-2:2] + share * (scaled[:, 2::2] - scaled[:, :-2:2])
    return bool(
        (np.abs(scaled[:, 1:-1:2] - lines) <= 4.0 * TOLERANCE).all()
    )  # the error of lines of half the length is a quarter


def _between_rows(model: "ModelCore", known: _ListedRows, inputs: Inputs | None) -> _SimulatedPieces | None:
    """Integrate the model from each listed row to the next; a piece ends if the integration misses the next row.

    Return None if the rows do not list all states, for example for equations of second order.
    """
    columns = [model.result.columns_by_symbol[state] for state in model.states]
    if set(columns) != set(known.states):
        return None
    order = [known.states.index(column) for column in columns]
    back = [columns.index(state) for state in known.states]
    steps = np.diff(known.times)
    courses = _runge_kutta(model, known.values[order, :-1].T, known.times[:-1], steps, inputs)[:, :, back]
    with np.errstate(invalid="ignore"):
        missed = np.abs(courses[-1].T - known.values[:, 1:]) > _AGREEMENT * known.sizes
    ends = (missed | ~np.isfinite(courses).all(axis=0).T).any(axis=0)
    shares = np.arange(_SUBSTEPS + 1)[:, None] / _SUBSTEPS
    all_times = known.times[:-1] + shares * steps  # (substeps + 1, N - 1)
    begins = [0, *(np.flatnonzero(ends) + 1).tolist(), len(steps)]
    times, values = [], []
    for begin, end in pairwise(begins):
        if begin == end:
            continue
        own, course = all_times[:, begin:end].T.ravel(), courses[:, begin:end].transpose(2, 1, 0).reshape(len(back), -1)
        is_first = np.append(True, np.diff(own) > 0.0) & np.isfinite(course).all(axis=0)
        own, course = own[is_first], course[:, is_first]
        if len(own) < 2:
            continue
        kept = bends(course, own)
        times += [own[kept], own[-1:]]
        values += [course[:, kept], np.full((len(back), 1), np.nan)]
    if not times:
        return None
    return np.concatenate(times[:-1]), np.concatenate(values[:-1], axis=1), len(times) // 2


def _runge_kutta(
    model: "ModelCore", states: FloatArray, times: FloatArray, steps: FloatArray, inputs: Inputs | None
) -> FloatArray:
    """Return the states (S + 1, N, D) after S equal substeps of `steps` (N,) from `states` (N, D) at `times` (N,)."""

    def rates(at: FloatArray, x: FloatArray) -> FloatArray:
        given = None if inputs is None else np.array([inputs(time) for time in at.tolist()])
        return model.field.values(x, given)

    step, x, course = steps / _SUBSTEPS, states, [states]
    with np.errstate(all="ignore"):
        for number in range(_SUBSTEPS):
            at, h = times + number * step, step[:, None]
            end = np.nextafter(at + step, at)  # a held input changes only at the ends of intervals
            k1 = rates(at, x)
            k2 = rates(at + 0.5 * step, x + 0.5 * h * k1)
            k3 = rates(at + 0.5 * step, x + 0.5 * h * k2)
            k4 = rates(end, x + h * k3)
            x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
            course.append(x)
    return np.array(course)


def _with_bands(known: _ListedRows, part: Simulated, times: FloatArray, values: FloatArray, pieces: int) -> ModelCurves:
    """Return curves with a 95 % band, whose half width is interpolated between the listed rows."""
    from scipy.interpolate import PchipInterpolator

    by_state = {state: _curve(row) for state, row in zip(known.states, values, strict=True)}
    if not part.lower or not part.upper:
        return ModelCurves(_curve(times), by_state, None, None, pieces)
    bounds: tuple[dict[str, Curve], dict[str, Curve]] = ({}, {})
    for state, row in zip(known.states, values, strict=True):
        lower, upper = (values_of_curve((curves or {})[state]) for curves in (part.lower, part.upper))
        at, widths = values_of_curve(part.times), 0.5 * (upper - lower)
        is_known, half = np.isfinite(at) & np.isfinite(widths), np.full(len(times), np.nan)
        if np.count_nonzero(is_known) > 1:
            half = PchipInterpolator(at[is_known], widths[is_known], extrapolate=False)(times)
        for side, curves in zip((-1.0, 1.0), bounds, strict=True):
            curves[state] = _curve(row + side * half)
    return ModelCurves(_curve(times), by_state, *bounds, pieces)


def _curve(values: FloatArray) -> Curve:
    return tuple(value if math.isfinite(value) else None for value in values.tolist())
