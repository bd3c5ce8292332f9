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
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray

END_ROWS = SETTINGS.interpolation.end_rows
_LEAST_FREEDOM: Final = 1e-12
"""Guard: smallest 1 - leverage by which a residual is divided."""


def mark_ends(lengths: Sequence[int]) -> FloatArray:
    """Return 1.0 at rows that stand at the ends of trajectories of which half the rows remain, else 0.0."""
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
    """Say whether interpolation predicts rows that are left out better than loess does, which gave `smoothed`.

    `errors` are those by which interpolation misses the rows that were measured, from `predict_left_out`. It is better
    where it is by one of the `shares` of the rows, those with the smallest errors.
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
    pairs = [np.empty((2, len(signal.times))) for signal in signals]
    for (derivative, uncertainty), signal, errors in zip(pairs, signals, noise, strict=True):
        slopes, gains = np.empty((2, len(signal.times), HALF_WIDTHS))
        differences_into(slopes, gains, signal.times, signal.values, order)
        rounding = np.maximum(errors, 2.0**-53 * np.abs(signal.values))
        best_stencil_into(derivative, uncertainty, slopes, gains, rounding)
    derivative, uncertainty = np.concatenate(pairs, axis=1)
    return derivative, uncertainty


def _loess_errors(signals: Sequence[Signal], smoothed: Sequence[SmoothedSignal]) -> FloatArray:
    """Return the leave-one-out errors of loess, residual / (1 - leverage), of all rows that were measured."""
    errors = [
        (signal.values - fit.fits[0]) / np.maximum(1.0 - fit.gains[3], _LEAST_FREEDOM)
        for signal, fit in zip(signals, smoothed, strict=True)
    ]
    return np.concatenate([part[signal.measured_rows] for part, signal in zip(errors, signals, strict=True)])


def _typical_size(errors: FloatArray, share: float) -> float:
    """Return the root mean square of the smallest errors; infinite when not all of them are finite."""
    ordered = np.sort(np.abs(errors))[: max(1, int(share * len(errors)))]
    mean, deviation = moments(ordered)
    size = math.sqrt(mean * mean + deviation * deviation)
    return size if math.isfinite(size) else math.inf
