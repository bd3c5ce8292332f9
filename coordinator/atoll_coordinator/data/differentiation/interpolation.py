"""Local interpolation: derivatives of data without noise, missing values, and the noise by predicted rows. Pure.

Derivatives are slopes of polynomials through the 3 to 15 nearest rows. Each row takes the stencil that differs least
from the next narrower one (weights by Fornberg 1988, good for uneven steps); that difference between two orders is the
row's uncertainty. A state that is missing where another one was measured is interpolated between its own rows; before
the first and after the last of them it is not known.
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
"""Rows at each end of a trajectory whose interpolated derivatives are much worse than others: half of a half width."""
_AGREEMENT: Final = 2.0
"""Estimates of the noise by two stencils agree if they differ by at most this many standard errors. In simulations of
pure noise (even and uneven steps, 50 to 1,000 rows) the mean estimate is 1.03 to 1.09 times the truth."""
Rows = npt.NDArray[np.intp]
_LEAST_FREEDOM: Final = 1e-12
"""Guard: smallest 1 - leverage by which a residual is divided."""
_MEDIAN_ERROR: Final = 1.1664
"""Relative standard error of the median size of R normal errors, times sqrt(R): 1 / (2 m f(m)) with the median
m = 0.6745 and the density f of the size."""
_QUIET_DEVIATION: Final = 7.9579
"""A normal error's standard deviation over its size that a tenth of such errors stay below, 0.12566."""
_QUIET_ERROR: Final = 3.0156
"""Relative standard error of that size of R errors, times sqrt(R): sqrt(0.1 0.9) / (2 m f(m)), see `_MEDIAN_ERROR`."""


def mark_ends(lengths: Sequence[int]) -> FloatArray:
    """Return 1.0 at the rows at both ends of trajectories of which half the rows remain, else 0.0."""
    parts = [np.zeros(length) for length in lengths]
    for part in parts:
        if len(part) >= 4 * END_ROWS:
            part[:END_ROWS] = part[-END_ROWS:] = 1.0
    return np.concatenate(parts)


def predict_left_out(signals: Sequence[Signal]) -> tuple[FloatArray, FloatArray]:
    """Return errors of predicting each row from its neighbours, and their noise gains, both (R, H)."""
    pairs = [np.empty((2, len(signal.times), HALF_WIDTHS)) for signal in signals]
    for (errors, gains), signal in zip(pairs, signals, strict=True):
        left_out_into(errors, gains, signal.times, signal.values)
    errors, gains = np.concatenate(pairs, axis=1)
    return errors, gains


def is_interpolation_better(
    signals: Sequence[Signal], errors: FloatArray, smoothed: Sequence[SmoothedSignal], shares: Sequence[float]
) -> bool:
    """Tell whether interpolation predicts left-out rows better than loess does, which gave `smoothed`.

    `errors` are the errors of interpolation at measured rows, from `predict_left_out`. It is better if it is better by
    one of the `shares` of the rows with the smallest errors.
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
    """Return the root mean square of the smallest errors; infinite when not all of them are finite."""
    ordered = np.sort(np.abs(errors))[: max(1, int(share * len(errors)))]
    mean, deviation = moments(ordered)
    size = math.sqrt(mean * mean + deviation * deviation)
    return size if math.isfinite(size) else math.inf


def interpolate_derivative(
    signals: Sequence[Signal], order: int, noise: Sequence[FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Return the derivative of the given order and its uncertainty, both (R,), over the rows of all signals.

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
    """Return False for rows (R,) that belong to three or more of one value in sequence, NaN passed over.

    Such rows, like values of a sensor at the end of its range, are predicted without error and do not show the noise.
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
    """Return an estimate of the standard deviation of the values' errors that is not biased low.

    The left-out errors of one width over their gains have this standard deviation where the width follows the signal, a
    larger one elsewhere. Each width gives an estimate, the median size times `NORMAL_DEVIATION`, with the relative
    standard error `_MEDIAN_ERROR` / sqrt(R). The least of several such estimates is biased low, so the largest estimate
    is returned that sampling alone may have made larger than the least.

    Args:
        errors: of rows predicted from their neighbours, (R, H); NaN where a stencil does not fit.
        gains: their standard deviations for errors of standard deviation one, (R, H).
        is_quiet: by the tenth of the rows with the smallest errors instead of half: where a state changes too fast for
            the sampling in places, the others show its noise. The standard error is 2.6 times as large.
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
    """A signal without missing values: `signal`, and the errors of substitutes, all (R,) and 0 at measured rows.

    `steps` are differences between two orders of interpolation, infinite where the value is not known; `gains` the
    standard errors over the standard error of the measurements.
    """

    signal: Signal
    steps: FloatArray
    gains: FloatArray


def make_signal(times: FloatArray, values: FloatArray, inverse_variances: FloatArray | None = None) -> Signal:
    """Return the signal of `values` (R,); missing ones, NaN, are replaced on the line between their neighbours."""
    is_known = np.isfinite(values)
    if is_known.all():
        return Signal(times, values, inverse_variances=inverse_variances)
    return Signal(times, fill(times, values, is_known, 1)[0], None, inverse_variances, is_known.astype(np.float64))


def fill_missing(signal: Signal) -> Filled:
    """Return `signal` with missing values interpolated as well as its own rows allow."""
    if signal.is_measured is None:
        return Filled(signal, *np.zeros((2, len(signal.times))))
    values, steps, gains = fill(signal.times, signal.values, signal.measured_rows, HALF_WIDTHS)
    return Filled(replace(signal, values=values, is_measured=None), steps, gains)


def fill(
    times: FloatArray, values: FloatArray, is_known: npt.NDArray[np.bool_], pairs: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return values without missing ones, steps and gains, see `Filled`.

    A row between known rows takes the polynomial through 1 to `pairs` of them on either side that differs least from
    the next smaller one. Elsewhere the nearest known value is held, 0 where there is none.
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
    """Return values, steps and gains (M,) at `rows` (M,) by the best of the polynomials through 2, 4, … `nodes` (M, P).

    Sums run in the order of the nodes: the same bits everywhere.
    """
    nearest = values[nodes[:, 0]]
    best, least, gains, last = nearest, np.full(len(rows), math.inf), np.ones(len(rows)), nearest
    for count in range(2, nodes.shape[1] + 1, 2):
        value, square = nearest, np.zeros(len(rows))
        for place in range(count):
            weight, own = np.ones(len(rows)), times[nodes[:, place]]  # of Lagrange
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
