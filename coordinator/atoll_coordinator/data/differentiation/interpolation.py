"""Derivatives of data without noise: polynomials through the 3 to 15 nearest rows, for one state at a time (pure).

Each row takes the stencil whose step from the next narrower one is least (weights by Fornberg 1988, good for uneven
steps). That difference between two orders is the row's uncertainty.
"""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from atoll_coordinator.data.differentiation.kernels.stencils import (
    HALF_WIDTHS,
    best_stencil_into,
    differences_into,
    left_out_into,
    moments,
)
from atoll_coordinator.data.differentiation.smoothing import Signal, SmoothedSignal
from atoll_coordinator.data.differentiation.standard_deviation import NORMAL_DEVIATION
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray

LIMITS = SETTINGS.interpolation
END_ROWS = LIMITS.end_rows
_LEAST_FREEDOM: Final = 1e-12
"""Guard: smallest 1 - leverage by which a residual is divided."""
MEDIAN_ERROR: Final = 1.1664
"""Relative standard error of the median size of R normal errors, times sqrt(R): 1 / (2 m f(m)) with the median
m = 0.6745 and the density f of the size."""
QUIET_DEVIATION: Final = 7.9579
"""A normal error's standard deviation over its size that a tenth of such errors stay below, 0.12566."""
QUIET_ERROR: Final = 3.0156
"""Relative standard error of that size of R errors, times sqrt(R): sqrt(0.1 0.9) / (2 m f(m)), see `MEDIAN_ERROR`."""


def mark_ends(lengths: Sequence[int]) -> FloatArray:
    """Return 1.0 at rows that stand at the ends of trajectories of which half the rows remain, else 0.0."""
    ends = np.zeros(sum(lengths))
    first = 0
    for length in lengths:
        if length >= 4 * END_ROWS:
            ends[first : first + END_ROWS] = 1.0
            ends[first + length - END_ROWS : first + length] = 1.0
        first += length
    return ends


def predict_left_out(signals: Sequence[Signal]) -> tuple[FloatArray, FloatArray]:
    """Return errors of predicting each row from its neighbours, and their noise gains, both (R, H)."""
    errors, gains = [], []
    for signal in signals:
        shape = (len(signal.times), HALF_WIDTHS)
        errors.append(np.empty(shape))
        gains.append(np.empty(shape))
        left_out_into(errors[-1], gains[-1], signal.times, signal.values)
    return np.concatenate(errors), np.concatenate(gains)


def estimate_value_noise(errors: FloatArray, gains: FloatArray, *, is_quiet: bool = False) -> float:
    """Return an estimate of the standard deviation of the values' errors that is not biased low.

    The left-out errors of one width over their gains have the standard deviation sought where the width follows the
    signal, a larger one elsewhere. Each width gives an estimate, the median size times `NORMAL_DEVIATION`, whose
    relative standard error is `MEDIAN_ERROR` / sqrt(R). The least of several such estimates is biased low, so the
    largest one of those is returned that sampling alone may have made larger than the least.

    Args:
        errors: of rows predicted from their neighbours, (R, H); NaN where a stencil does not fit.
        gains: their standard deviations for errors of deviation one, (R, H).
        is_quiet: by the tenth of the rows with the smallest errors instead of half: where a state changes too fast for
            the sampling in places, the others tell its noise. The standard error is 2.6 times as large.
    """
    rows = len(errors)
    share, deviation, error = (0.1, QUIET_DEVIATION, QUIET_ERROR) if is_quiet else (0.5, NORMAL_DEVIATION, MEDIAN_ERROR)
    quantiles = np.sort(np.abs(errors) / gains, axis=0)[int(share * rows)]
    noises = deviation * quantiles[~np.isnan(quantiles)]
    agreement = 1.0 + LIMITS.agreement * error * math.sqrt(2.0 / rows)
    return float(np.max(noises[noises <= agreement * np.min(noises)]))


def is_interpolation_better(
    signals: Sequence[Signal], errors: FloatArray, smoothed: Sequence[SmoothedSignal], shares: Sequence[float]
) -> bool:
    """Say whether interpolation predicts rows that are left out better than loess does.

    Args:
        signals: one state along each trajectory.
        errors: by which interpolation misses the rows that were measured, from `predict_left_out`.
        smoothed: loess of each of `signals`.
        shares: of the rows, those with the smallest errors; it is better where it is by one of these.
    """
    inner = mark_ends([len(signal.measured.times) for signal in signals]) == 0.0
    by_loess = _loess_errors(signals, smoothed)[inner]
    for share in shares:
        by_interpolation = min(_typical_size(errors[inner, width], share) for width in range(HALF_WIDTHS))
        if by_interpolation < _typical_size(by_loess, share):
            return True
    return False


def interpolate_derivative(
    signals: Sequence[Signal], order: int, noise: Sequence[FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Return the derivative of the given order and its uncertainty, both (R,), over the rows of all signals.

    `noise` has the standard errors of the values of each signal.
    """
    derivatives, uncertainties = [], []
    for signal, errors in zip(signals, noise, strict=True):
        rows = len(signal.times)
        slopes, gains = np.empty((rows, HALF_WIDTHS)), np.empty((rows, HALF_WIDTHS))
        differences_into(slopes, gains, signal.times, signal.values, order)
        derivatives.append(np.empty(rows))
        uncertainties.append(np.empty(rows))
        rounding = np.maximum(errors, 2.0**-53 * np.abs(signal.values))
        best_stencil_into(derivatives[-1], uncertainties[-1], slopes, gains, rounding)
    return np.concatenate(derivatives), np.concatenate(uncertainties)


def _loess_errors(signals: Sequence[Signal], smoothed: Sequence[SmoothedSignal]) -> FloatArray:
    """Return the leave-one-out errors of loess, residual / (1 - leverage), of all rows that were measured."""
    values = np.concatenate([signal.values for signal in signals])
    fits = np.concatenate([signal.fits[0] for signal in smoothed])
    leverages = np.concatenate([signal.gains[3] for signal in smoothed])
    if any(signal.is_measured is not None for signal in signals):
        ones = [np.ones(len(signal.times)) if signal.is_measured is None else signal.is_measured for signal in signals]
        rows = np.concatenate(ones) > 0.0
        values, fits, leverages = values[rows], fits[rows], leverages[rows]
    errors: FloatArray = (values - fits) / np.maximum(1.0 - leverages, _LEAST_FREEDOM)
    return errors


def _typical_size(errors: FloatArray, share: float) -> float:
    """Return the root mean square of the smallest errors; infinite when not all of them are finite."""
    ordered = np.sort(np.abs(errors))[: max(1, int(share * len(errors)))]
    mean, deviation = moments(ordered)
    size = math.sqrt(mean * mean + deviation * deviation)
    return size if math.isfinite(size) else math.inf
