"""The course of hidden states if parts of their law are unknown: a Kalman smoother with free forces. Pure.

How it works. Each unknown part of a law is what is known of it, plus a force that changes with time as a random walk.
States and forces together are smoothed along each trajectory: forward by the extended Kalman filter, backward by the
recursion of Rauch, Tung and Striebel (1965, AIAA Journal 3:1445). So measured columns pull the hidden course away from
the law where the law is wrong, and only there where it is unknown. The variance of the random walks is the one with the
largest likelihood of the measured values; it is one factor for all forces, in units of their equations.

The transition from one row to the next, and its derivatives, are integrated by the Runge-Kutta method of fourth order,
with differences of neighbouring states for the derivatives.

Doubts. The filter is linear around its own states: where the course is far from the truth, it is only better than
before. Several forces in the equations of one measured column are told apart only by their equal variances.

Letters: D states, U forces, S = D + U, I inputs, O measured columns, R rows of one trajectory, M points.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from atoll_core.data.dataset import FloatArray

Rates = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]
"""The derivatives (D, M) of states (D, M) with inputs (I, M) and forces (U, M)."""
Columns = Callable[[FloatArray, FloatArray], FloatArray]
"""The measured columns (O, M) of states (D, M) with inputs (I, M)."""

_DIFFERENCE: Final = 1e-6
"""Step of a difference, in units of the scale: its error is about as large as rounding errors over it."""
_MOST_STEPS: Final = 64
"""Most steps of an integration between two rows, set by hand: a stiffer system has no course by this smoother."""
_STEP: Final = 0.3
"""Step of an integration, in units of the fastest time of the linear system. Set by hand: errors of a step are then
below 1e-4 of its change."""
_DECADES: Final = (-8.0, 4.0)
"""Range of the factor's logarithm to base 10: a force that hardly moves, and one that is free at each row. Set by
hand."""
_TRIALS: Final = 8
"""Evaluations of the likelihood: the factor is then known within about half a decade."""
_ROWS_OF_TRIALS: Final = 512
"""Rows, of all trajectories together, whose likelihood chooses the factor. Set by hand, to bound the time."""


@dataclass(frozen=True, eq=False)
class Series:
    """Measured values of one trajectory: `times` (R,), `inputs` (I, R), `measured` (O, R) with NaN where nothing was
    measured; the first guess of the state `start` (D,), and its standard deviation `spread` (D,).

    In the time `duration`, the variance of a random walk grows by the factor times its squared scale.
    """

    times: FloatArray
    inputs: FloatArray
    measured: FloatArray
    start: FloatArray
    spread: FloatArray
    duration: float

    def first_rows(self, count: int) -> "Series":
        """Return the first rows."""
        return replace(self, times=self.times[:count], inputs=self.inputs[:, :count], measured=self.measured[:, :count])


@dataclass(frozen=True, eq=False)
class SmoothedCourse:
    """One trajectory: the course of `states` (D, R) and `forces` (U, R), and the `variances` (D, R) of the states."""

    states: FloatArray
    forces: FloatArray
    variances: FloatArray


@dataclass(frozen=True, eq=False)
class KalmanSmoother:
    """A law with forces: `rates`, `columns`, the number of `states` D, scales of states and forces (S,), and the
    standard deviations (O,) of measured values."""

    rates: Rates
    columns: Columns
    states: int
    scales: FloatArray
    noise: FloatArray

    def smooth(self, several: Sequence[Series], *, is_free: bool = False) -> list[SmoothedCourse] | None:
        """Return the smoothed course of each trajectory; None if the filter fails.

        With `is_free`, the forces are so free that the law says nothing where it is unknown.
        """
        from scipy.optimize import minimize_scalar

        short = [one.first_rows(max(_ROWS_OF_TRIALS // len(several), 2)) for one in several]

        def misfit(exponent: float) -> float:
            return math.fsum(self._filter(series, 10.0**exponent).misfit for series in short)

        with np.errstate(all="ignore"):
            exponent = _DECADES[1]
            if not is_free:
                options = {"maxiter": _TRIALS}
                exponent = float(minimize_scalar(misfit, bounds=_DECADES, method="bounded", options=options).x)
            filtered = [self._filter(series, 10.0**exponent) for series in several]
            if not all(math.isfinite(one.misfit) for one in filtered):
                return None
            return [self._smooth(one) for one in filtered]

    def _filter(self, series: Series, factor: float) -> "_Filtered":
        variances = factor * self.scales**2
        variances[: self.states] = 0.0
        mean = np.concatenate([series.start, np.zeros(len(self.scales) - self.states)])
        covariance = np.diag(np.concatenate([series.spread**2, variances[self.states :]]))
        means, covariances, predicted, ahead, transitions, misfit = [], [], [], [], [], 0.0
        for row, time in enumerate(series.times.tolist()):
            if row:
                span = time - float(series.times[row - 1])
                mean, transition = self._move(mean, series.inputs[:, row - 1 : row + 1], span)
                covariance = transition @ covariance @ transition.T + np.diag(variances * (span / series.duration))
                transitions.append(transition)
            predicted.append(mean)
            ahead.append(covariance)
            mean, covariance, nats = self._update(mean, covariance, series, row)
            misfit += nats
            if not (math.isfinite(misfit) and np.isfinite(mean).all()):
                return _Filtered([], [], [], [], [], math.inf)
            means.append(mean)
            covariances.append(covariance)
        return _Filtered(means, covariances, predicted, ahead, transitions, misfit)

    def _smooth(self, filtered: "_Filtered") -> SmoothedCourse:
        mean, covariance = filtered.means[-1], filtered.covariances[-1]
        courses, variances = [mean], [np.diag(covariance)]
        for row in range(len(filtered.means) - 2, -1, -1):
            crossed = filtered.transitions[row] @ filtered.covariances[row]
            gain = _solve(filtered.ahead[row + 1], crossed).T
            mean = filtered.means[row] + gain @ (mean - filtered.predicted[row + 1])
            covariance = filtered.covariances[row] + gain @ (covariance - filtered.ahead[row + 1]) @ gain.T
            courses.append(mean)
            variances.append(np.diag(covariance))
        course, of_course = np.array(courses[::-1]).T, np.array(variances[::-1]).T
        states = self.states
        return SmoothedCourse(np.ascontiguousarray(course[:states]), course[states:], of_course[:states])

    def _update(
        self, mean: FloatArray, covariance: FloatArray, series: Series, row: int
    ) -> tuple[FloatArray, FloatArray, float]:
        """Return mean and covariance after the measurements of a row, and their misfit in nats."""
        measured = series.measured[:, row]
        known = np.flatnonzero(np.isfinite(measured))
        if not len(known):
            return mean, covariance, 0.0
        states, points = self.states, self._points(mean, self.states)
        inputs = np.repeat(series.inputs[:, row : row + 1], points.shape[1], axis=1)
        columns = self.columns(points[:states], inputs)[known]
        slopes = np.zeros((len(known), len(mean)))
        slopes[:, :states] = (columns[:, 1:] - columns[:, :1]) / (_DIFFERENCE * self.scales[:states])
        errors = measured[known] - columns[:, 0]
        crossed = slopes @ covariance
        spread = crossed @ slopes.T + np.diag(self.noise[known] ** 2)
        gain = _solve(spread, crossed).T
        misfit = 0.5 * float(errors @ _solve(spread, errors) + np.linalg.slogdet(spread)[1])
        kept = np.eye(len(mean)) - gain @ slopes
        # Joseph's form stays symmetric and positive
        covariance = kept @ covariance @ kept.T + (gain * self.noise[known] ** 2) @ gain.T
        return mean + gain @ errors, covariance, misfit

    def _points(self, mean: FloatArray, count: int) -> FloatArray:
        """Return a point (S, 1 + count), and points beside it along each of the first `count` axes."""
        points = np.repeat(mean[:, None], 1 + count, axis=1)
        points[np.arange(count), 1 + np.arange(count)] += _DIFFERENCE * self.scales[:count]
        return points

    def _move(self, mean: FloatArray, inputs: FloatArray, span: float) -> tuple[FloatArray, FloatArray]:
        """Return the state and the forces after a time, and their derivatives (S, S) by the state before."""
        size, states = len(mean), self.states
        points = self._points(mean, size)
        first = self.rates(points[:states], np.repeat(inputs[:, :1], 1 + size, axis=1), points[states:])
        slopes = (first[:, 1 : 1 + states] - first[:, :1]) / (_DIFFERENCE * self.scales[:states])
        fastest = float(np.abs(slopes).sum(axis=1).max(initial=0.0))
        steps = min(_MOST_STEPS, max(1, math.ceil(span * fastest / _STEP))) if math.isfinite(fastest) else 1
        moved, step = points[:states], span / steps
        for number in range(steps):
            at = [inputs[:, :1] + (inputs[:, 1:] - inputs[:, :1]) * ((number + share) / steps) for share in (0, 0.5, 1)]
            there = [np.repeat(one, 1 + size, axis=1) for one in at]
            forces = points[states:]
            one = self.rates(moved, there[0], forces)
            two = self.rates(moved + 0.5 * step * one, there[1], forces)
            three = self.rates(moved + 0.5 * step * two, there[1], forces)
            four = self.rates(moved + step * three, there[2], forces)
            moved = moved + step / 6.0 * (one + 2.0 * two + 2.0 * three + four)
        after = np.concatenate([moved, points[states:]])
        return after[:, 0], (after[:, 1:] - after[:, :1]) / (_DIFFERENCE * self.scales)


@dataclass(frozen=True, eq=False)
class _Filtered:
    """By row: means and covariances after and before the measurements of the row; transitions to the next row."""

    means: list[FloatArray]
    covariances: list[FloatArray]
    predicted: list[FloatArray]
    ahead: list[FloatArray]
    transitions: list[FloatArray]
    misfit: float


def _solve(matrix: FloatArray, sides: FloatArray) -> FloatArray:
    """Return the solution for a covariance that may be singular; NaN if it is not finite."""
    if not np.isfinite(matrix).all():
        return np.full_like(sides, np.nan)
    sizes = np.sqrt(np.maximum(np.diag(matrix), np.finfo(np.float64).tiny))
    scaled = matrix / np.outer(sizes, sizes) + 1e-12 * np.eye(len(matrix))
    by_row = sizes if sides.ndim == 1 else sizes[:, None]
    return np.asarray(np.linalg.solve(scaled, sides / by_row) / by_row)
