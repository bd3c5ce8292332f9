"""Local interpolation: derivatives of noise-free data, missing values, and an estimate of the noise from predicted
rows. Pure.

Derivatives are slopes of polynomials through the 3 to 15 nearest rows. Their weights, by Fornberg 1988, allow uneven
steps. Each row uses the stencil whose result differs least from the next narrower stencil. This difference between two
orders is the uncertainty of the row. It is an estimate of the truncation error, not an upper limit. A missing value of
a state is interpolated from the other values of this state. Before its first and after its last measured row, the state
is not known.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from atoll_coordinator.data.differentiation.kernels.stencils import (
    HALF_WIDTHS,
    best_stencil_into,
    differences_into,
    left_out_into,
    moments,
)
from atoll_coordinator.data.differentiation.smoothing import NORMAL_DEVIATION, Signal, SmoothedSignal
from atoll_core.data.dataset import FloatArray

END_ROWS: Final = (HALF_WIDTHS + 1) // 2
"""Number of rows at each end of a trajectory whose interpolated derivatives are much less accurate: half of a half
width."""
_AGREEMENT: Final = 2.0
"""Noise estimates from two stencils agree if they differ by at most this many standard errors. In simulations of pure
noise (even and uneven steps, 50 to 1,000 rows) the mean estimate is 1.03 to 1.09 times the true value."""
Rows = npt.NDArray[np.intp]
_LEAST_FREEDOM: Final = 1e-12
"""Guard: smallest value of 1 - leverage by which a residual is divided."""
_MEDIAN_ERROR: Final = 1.1664
"""Relative standard error of the median absolute value of R normal errors, times sqrt(R). It is 1 / (2 m f(m)), where m
= 0.6745 is the median and f is the density of the absolute value."""
_QUIET_DEVIATION: Final = 7.9579
"""Standard deviation of normal errors, divided by the 10 % quantile of their absolute values, which is 0.12566."""
_QUIET_ERROR: Final = 3.0156
"""Relative standard error of the 10 % quantile of R errors, times sqrt(R): sqrt(0.1 0.9) / (2 m f(m)), where m is this
quantile and f the density as in `_MEDIAN_ERROR`."""


def mark_ends(lengths: Sequence[int]) -> FloatArray:
    """Return 1.0 at rows near an end of a trajectory, and 0.0 at other rows. In trajectories shorter than 4 `END_ROWS`,
    return 0.0 at all rows."""
    parts = [np.zeros(length) for length in lengths]
    for part in parts:
        if len(part) >= 4 * END_ROWS:
            part[:END_ROWS] = part[-END_ROWS:] = 1.0
    return np.concatenate(parts)


def predict_left_out(signals: Sequence[Signal]) -> tuple[FloatArray, FloatArray]:
    """Predict each row from its neighbours by H stencils. Return the errors of the predictions and their noise gains,
    both (R, H)."""
    pairs = [np.empty((2, len(signal.times), HALF_WIDTHS)) for signal in signals]
    for (errors, gains), signal in zip(pairs, signals, strict=True):
        left_out_into(errors, gains, signal.times, signal.values)
    errors, gains = np.concatenate(pairs, axis=1)
    return errors, gains


def is_interpolation_better(
    signals: Sequence[Signal], errors: FloatArray, smoothed: Sequence[SmoothedSignal], shares: Sequence[float]
) -> bool:
    """Tell whether interpolation predicts left-out rows better than loess (with the result `smoothed`) does.

    `errors` are the errors of interpolation at measured rows, from `predict_left_out`. Both methods are compared on
    several `shares` of the rows, each time on the rows with the smallest errors. It is enough if interpolation is
    better on one of these shares.
    """
    inner = mark_ends([len(signal.measured.times) for signal in signals]) == 0.0
    left_out = [
        ((signal.values - fit.fits[0]) / np.maximum(1.0 - fit.gains[3], _LEAST_FREEDOM))[signal.measured_rows]
        for signal, fit in zip(signals, smoothed, strict=True)
    ]
    by_loess = np.concatenate(left_out)[inner]
    for share in shares:
        by_interpolation = min(_typical_size(errors[inner, width], share) for width in range(HALF_WIDTHS))
        if by_interpolation < _typical_size(by_loess, share):
            return True
    return False


def _typical_size(errors: FloatArray, share: float) -> float:
    """Return the root mean square of the smallest errors. The result is infinite if one of these errors is not
    finite."""
    ordered = np.sort(np.abs(errors))[: max(1, int(share * len(errors)))]
    mean, deviation = moments(ordered)
    size = math.sqrt(mean * mean + deviation * deviation)
    return size if math.isfinite(size) else math.inf


def interpolate_derivative(
    signals: Sequence[Signal], order: int, noise: Sequence[FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Return the derivative of this order, and the uncertainty of the derivative, both (R,), at the rows of all
    signals.

    `noise` has the standard errors of the values of each signal.
    """
    pairs = [np.empty((2, len(signal.times))) for signal in signals]
    for (derivative, uncertainty), signal, errors in zip(pairs, signals, noise, strict=True):
        slopes, gains = np.empty((2, len(signal.times), HALF_WIDTHS))
        differences_into(slopes, gains, signal.times, signal.values, order)
        rounding = np.maximum(errors, 2.0**-53 * np.abs(signal.values))
        best_stencil_into(derivative, uncertainty, slopes, gains, rounding)
    derivative, uncertainty = np.concatenate(pairs, axis=1)
    return derivative, uncertainty


# --------------------------------------------------------------------------------------------- noise by predicted rows


def are_moving(parts: Sequence[FloatArray]) -> npt.NDArray[np.bool_]:
    """Return False for rows (R,) that belong to three or more consecutive equal values; NaN is ignored.

    Such rows, for instance of a sensor at the end of its range, are predicted without error. So they do not show the
    noise.
    """
    moving = []
    for values in parts:
        known = np.flatnonzero(np.isfinite(values))
        same = np.diff(values[known]) == 0.0
        in_three = np.zeros(len(known), dtype=bool)
        for first in np.flatnonzero(same[1:] & same[:-1]).tolist():
            in_three[first : first + 3] = True
        flags = np.ones(len(values), dtype=bool)
        flags[known[in_three]] = False
        moving.append(flags)
    return np.concatenate(moving)


def estimate_value_noise(errors: FloatArray, gains: FloatArray, *, is_quiet: bool = False) -> float:
    """Return an estimate of the standard deviation of the measurement errors that is not systematically too small.

    Each stencil width gives an estimate: the median absolute value of (prediction error / gain) times
    `NORMAL_DEVIATION`, with the relative standard error `_MEDIAN_ERROR` / sqrt(R). If the polynomials of a width follow
    the signal, the estimate is unbiased; otherwise it is too large. The smallest of several estimates is too small on
    average. So the result is the largest estimate that agrees with the smallest estimate within the sampling error.

    Args:
        errors: Errors of rows predicted from their neighbours, (R, H); NaN where a stencil does not fit.
        gains: Standard deviations of `errors` for measurement errors of standard deviation one, (R, H).
        is_quiet: Use the 10 % quantile instead of the median. This is for a state that changes too fast for the
            sampling at some rows: the other rows still show its noise. The standard error of this estimate is 2.6 times
            as large.
    """
    rows = len(errors)
    share, deviation, error = (0.5, NORMAL_DEVIATION, _MEDIAN_ERROR)
    if is_quiet:
        share, deviation, error = (0.1, _QUIET_DEVIATION, _QUIET_ERROR)
    quantiles = np.sort(np.abs(errors) / gains, axis=0)[int(share * rows)]
    noises = deviation * quantiles[~np.isnan(quantiles)]
    agreement = 1.0 + _AGREEMENT * error * math.sqrt(2.0 / rows)
    return float(np.max(noises[noises <= agreement * np.min(noises)]))


# ------------------------------------------------------------------------------------------------------ missing values


@dataclass(frozen=True, eq=False)
class Filled:
    """A signal with its missing values filled, and two kinds of errors of the substitutes, (R,) each and 0 at measured
    rows.

    `steps` are the differences between two orders of interpolation; a difference is infinite if the value is not known.
    `gains` are the standard errors of the substitutes, divided by the standard error of a measurement.
    """

    signal: Signal
    steps: FloatArray
    gains: FloatArray


def make_signal(times: FloatArray, values: FloatArray, inverse_variances: FloatArray | None = None) -> Signal:
    """Return the signal of `values` (R,); missing values, NaN, are interpolated linearly between their neighbours."""
    is_known = np.isfinite(values)
    if is_known.all():
        return Signal(times, values, inverse_variances=inverse_variances)
    return Signal(times, fill(times, values, is_known, 1)[0], None, inverse_variances, is_known.astype(np.float64))


def fill_missing(signal: Signal) -> Filled:
    """Return `signal` with missing values interpolated from its own rows, as accurately as possible."""
    if signal.is_measured is None:
        return Filled(signal, *np.zeros((2, len(signal.times))))
    values, steps, gains = fill(signal.times, signal.values, signal.measured_rows, HALF_WIDTHS)
    return Filled(replace(signal, values=values, is_measured=None), steps, gains)


def fill(
    times: FloatArray, values: FloatArray, is_known: npt.NDArray[np.bool_], pairs: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the values with missing values filled, the steps and the gains; see `Filled`.

    For a row between known rows, polynomials through 1 to `pairs` known rows on each side are compared. The polynomial
    is used that differs least from the polynomial with one pair less. Other rows get the nearest known value; 0 if no
    value is known.
    """
    filled, steps, gains = values.copy(), np.zeros(len(times)), np.zeros(len(times))
    known, missing = np.flatnonzero(is_known), np.flatnonzero(~is_known)
    following = np.searchsorted(known, missing)
    counts = np.minimum(np.minimum(following, len(known) - following), pairs)
    for count in range(1, pairs + 1):
        rows, after = missing[counts == count], following[counts == count, None] + np.arange(count)
        before = following[counts == count, None] - 1 - np.arange(count)
        nodes = known[np.stack([before, after], axis=2).reshape(len(rows), 2 * count)]
        filled[rows], steps[rows], gains[rows] = _interpolate(times, values, rows, nodes)
    beyond = missing[counts == 0]
    steps[beyond] = math.inf
    filled[beyond] = values[known[np.maximum(following[counts == 0] - 1, 0)]] if len(known) else 0.0
    return filled, steps, gains


def _interpolate(
    times: FloatArray, values: FloatArray, rows: Rows, nodes: Rows
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return values, steps and gains (M,) at `rows` (M,) by the best polynomial through 2, 4, … of the `nodes` (M, P).

    Numbers are added in the order of the nodes, so that results have the same bits on every machine.
    """
    nearest = values[nodes[:, 0]]
    best, least, gains, last = nearest, np.full(len(rows), math.inf), np.ones(len(rows)), nearest
    for count in range(2, nodes.shape[1] + 1, 2):
        value, square = nearest, np.zeros(len(rows))
        for place in range(count):
            weight, own = np.ones(len(rows)), times[nodes[:, place]]  # Lagrange weights
            for other in range(count):
                if other != place:
                    node = times[nodes[:, other]]
                    weight *= (times[rows] - node) / (own - node)
            value = value + weight * (values[nodes[:, place]] - nearest)
            square += weight * weight
        step = np.abs(value - last)
        is_better = step < least
        best, least = np.where(is_better, value, best), np.where(is_better, step, least)
        gains = np.where(is_better, np.sqrt(square), gains)
        last = value
    return best, least, gains
