"""Inputs between their measured rows: the curve that fits, simulations, reports and exports all use. Pure.

The curve is the piecewise cubic with given values and slopes at the rows. A held input keeps the value of a row until
the next row, and its slopes are NaN. The search uses inputs at rows only. scipy is imported in the functions that use
it, because most data have no inputs.

Letters: N rows.
"""

import math
from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np

from atoll_coordinator.data.recording import InputKind
from atoll_core.data.dataset import FloatArray

_LEAST_SMOOTH: Final = 4
"""Fewest rows for a cubic spline with continuous second derivatives. If there are fewer rows, the curve is
shape-preserving."""
_BETWEEN_SMOOTH: Final = 1.0 / 16.0
"""A ratio of two errors of a cubic spline: its error between rows, divided by its error at left-out rows if every
second row is left out."""
_Sample = tuple[FloatArray, FloatArray]


@dataclass(frozen=True, eq=False)
class InputCurve:
    """An input along one trajectory as a function of the time: `values` and `slopes` (N,) at ascending `times` (N,).

    It is constant before the first time and after the last time.
    """

    times: FloatArray
    values: FloatArray
    slopes: FloatArray

    @classmethod
    def through(cls, times: FloatArray, values: FloatArray, kind: InputKind | None = None) -> "InputCurve":
        """Return the curve of a kind through finite `values` (N,) at `times` (N,).

        If the kind is None, the kind that fits better is chosen.
        """
        kind = choose_input_kind([times], [values]) if kind is None else kind
        return cls(times, values, estimate_input_slopes([times], [values], kind)[0])

    def __call__(self, t: float) -> float:
        """Return the input at a time."""
        times, rows = self._listed
        if t <= times[0]:
            return rows[0][0]
        if t >= times[-1]:
            return rows[-1][0]
        row = bisect_right(times, t) - 1
        p, m, c2, c3 = rows[row]
        s = t - times[row]
        return p + s * (m + s * (c2 + s * c3))

    @property
    def is_held(self) -> bool:
        """Whether each value holds until the next row."""
        return bool(np.isnan(self.slopes).any())

    @cached_property
    def pieces(self) -> FloatArray:
        """Cubics (N - 1, 5): the time at which each begins, then the coefficients of the powers 0 to 3 of time.

        The time in these powers is the time since the beginning of the cubic. A held input has N pieces; the last one
        begins at the last row.
        """
        times, values, slopes = self.times, self.values, self.slopes
        if self.is_held or len(times) < 2:
            return np.column_stack([times, values, np.zeros((len(times), 3))])
        width, rise = np.diff(times), np.diff(values)
        m, n = slopes[:-1], slopes[1:]
        c2, c3 = (3.0 * rise / width - 2.0 * m - n) / width, (m + n - 2.0 * rise / width) / width**2
        return np.column_stack([times[:-1], values[:-1], m, c2, c3])

    @property
    def until(self) -> float:
        """The time up to which the `pieces` are valid."""
        last = self.times[-1] - self.times[-2] if self.is_held and len(self.times) > 1 else 0.0
        return float(self.times[-1] + last)

    @cached_property
    def jumps(self) -> FloatArray:
        """The times at which a held input changes."""
        is_jump = self.values[1:] != self.values[:-1]
        return np.asarray(self.times[1:][is_jump & self.is_held])

    @cached_property
    def _listed(self) -> tuple[list[float], list[list[float]]]:
        pieces = self.pieces[:, 1:].tolist()
        if len(pieces) < len(self.times):
            pieces.append([float(self.values[-1]), 0.0, 0.0, 0.0])
        return self.times.tolist(), pieces


def choose_input_kind(times: Sequence[FloatArray], values: Sequence[FloatArray]) -> InputKind:
    """Return the kind of curve for one input, smooth or shape-preserving: the kind that predicts left-out rows better.

    Args:
        times: The times of each trajectory, strictly ascending.
        values: The values of the input at these times, finite.
    """
    samples, _ = _samples(times, values)
    if not samples:
        return "shape-preserving"
    kinds: tuple[InputKind, ...] = ("smooth", "shape-preserving")
    return min(kinds, key=lambda kind: math.fsum(map(abs, _left_out_errors(kind, samples))))


def estimate_input_slopes(
    times: Sequence[FloatArray], values: Sequence[FloatArray], kind: InputKind
) -> list[FloatArray]:
    """Return the slopes of one input at the rows of each trajectory. The slopes of a held input are NaN.

    For an input that is linear in time, the slopes are exact up to rounding. Arguments are as in `choose_input_kind`.
    """
    if kind == "held":
        return [np.full(len(part), np.nan) for part in times]
    exponent = _exponent(values)
    with np.errstate(over="ignore", under="ignore"):
        slopes = [
            _slopes(kind, part_times, np.ldexp(part, -exponent)) for part_times, part in zip(times, values, strict=True)
        ]
        return [np.ldexp(part, exponent) for part in slopes]


def relative_curve_error(times: Sequence[FloatArray], values: Sequence[FloatArray], kind: InputKind) -> float:
    """Return the root mean square error of a smooth curve between rows, divided by the standard deviation of the input.

    The error of a cubic spline grows as the fourth power of the step. If every second row is left out, the step
    doubles; so the error between rows is a sixteenth of the error at the left-out rows. The result is 0 for inputs of
    other kinds, because the time of a switch between two rows is not known.
    """
    samples, _ = _samples(times, values)
    if kind != "smooth" or not samples:
        return 0.0
    numbers = [value for _, part in samples for value in part.tolist()]
    mean = math.fsum(numbers) / len(numbers)
    spread = math.fsum((value - mean) ** 2 for value in numbers) / len(numbers)
    return _BETWEEN_SMOOTH * math.sqrt(_left_out_variance(kind, samples) / spread) if spread > 0.0 else 0.0


def unknown_variance(times: Sequence[FloatArray], values: Sequence[FloatArray], kind: InputKind | None) -> float | None:
    """Return the variance of the difference between an input and its curve, midway between rows. None if there are too
    few rows.

    For a smooth curve this is the square of its error. Other inputs are modelled as random walks; between two rows,
    such a walk is a Brownian bridge. If every second row is left out, the variance at the left-out rows is twice the
    variance midway between rows. A held input is known everywhere. If an input is not smooth, the result includes the
    noise of the input, since the curve passes through the noisy values.
    """
    if kind == "held":
        return 0.0
    samples, exponent = _samples(times, values)
    if not samples:
        return None
    kind = choose_input_kind(times, values) if kind is None else kind
    share = _BETWEEN_SMOOTH**2 if kind == "smooth" else 0.5
    return math.ldexp(_left_out_variance(kind, samples) * share, 2 * exponent)


def _exponent(values: Sequence[FloatArray]) -> int:
    """Return the exponent of a power of two: values divided by this power are about one."""
    return math.frexp(max((float(np.max(np.abs(part))) for part in values if len(part)), default=0.0))[1]


def _samples(times: Sequence[FloatArray], values: Sequence[FloatArray]) -> tuple[list[_Sample], int]:
    """Return times and scaled values of the trajectories with enough rows, and the exponent of the scale."""
    exponent = _exponent(values)
    scaled = [np.ldexp(part, -exponent) for part in values]
    return [pair for pair in zip(times, scaled, strict=True) if len(pair[0]) > _LEAST_SMOOTH], exponent


def _slopes(kind: InputKind, times: FloatArray, values: FloatArray) -> FloatArray:
    from scipy.interpolate import CubicSpline, PchipInterpolator

    if len(times) < 2:
        return np.zeros(len(times))
    make: Callable[..., Any] = CubicSpline if kind == "smooth" and len(times) >= _LEAST_SMOOTH else PchipInterpolator
    return np.asarray(make(times, values)(times, 1))


def _left_out_variance(kind: InputKind, samples: Sequence[_Sample]) -> float:
    errors = _left_out_errors(kind, samples)
    return math.fsum(error * error for error in errors) / len(errors)


def _left_out_errors(kind: InputKind, samples: Sequence[_Sample]) -> list[float]:
    """Return the errors at inner rows. Every second row is left out: first the odd rows, then the even rows."""
    errors = list[float]()
    for times, values in samples:
        for first in (0, 1):
            kept, left_out = slice(first, None, 2), slice(first + 1, len(times) - 1, 2)
            curve = InputCurve(times[kept], values[kept], _slopes(kind, times[kept], values[kept]))
            errors += [curve(t) - v for t, v in zip(times[left_out].tolist(), values[left_out].tolist(), strict=True)]
    return errors
