"""The size of errors of measurement, estimated from the residuals of a law. Pure.

Errors of measurement are rough, and errors of a law are slow. So second differences give the size of the errors of
measurement (`roughness`), and a fit of cosines along the rows gives the share of the errors of the law (`slow_shares`).
`count_pieces` returns the number of independent numbers in slow errors. Doubt: correlated errors of a sensor are slow
as well; `error_model` must remove them first. Letters: O measured states, N rows, R rows of some trajectories.
"""

import math
from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from atoll_coordinator.model.shooting.measurements import TrajectoryMeasurements
from atoll_core.data.dataset import FloatArray

ROUGHNESS_VARIANCE: Final = 35.0 / 9.0
"""Relative variance of the variance that `roughness` estimates, times the number of rows. It follows from the
correlations of the second differences of independent errors, -2/3 and 1/6 (Gasser, Sroka & Jennen-Steinmetz 1986)."""

_ROUNDING: Final = 1e-9
"""Guard: upper limit of the relative rounding error of sums of squares by Fourier transforms, for 1e9 rows."""


def roughness(measurements: TrajectoryMeasurements, residuals: FloatArray) -> FloatArray:
    """Return the standard deviation (O,) of the independent part of `residuals` (O, N), from their second differences.

    Slow errors have nearly no second differences.
    """
    deviations = np.zeros(len(residuals))
    for state, (values, weights) in enumerate(zip(residuals, measurements.weights, strict=True)):
        squares, count = 0.0, 0
        for first, end in measurements.bounds.tolist():
            known = weights[first:end] > 0.0
            scaled = (values[first:end] * np.sqrt(weights[first:end]))[known]
            differences = scaled[2:] - 2.0 * scaled[1:-1] + scaled[:-2]
            squares += float(differences @ differences)
            count += len(differences)
        deviations[state] = np.sqrt(squares / 6.0 / max(count, 1))
    return deviations


def slow_shares(
    measurements: TrajectoryMeasurements, residuals: FloatArray, pieces: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the share of the residuals' squares (O,) that slow cosines explain, and its expected value for independent
    errors.

    The errors of a law move a state no faster than its derivative varies. So errors of a law are a sum of about
    `pieces` (O,) cosines along the rows. Three more cosines are used along each trajectory, because the fit of the
    initial state and of the constants absorbs the slowest cosines. The share of the squares of independent errors that
    the cosines explain on average is the number of cosines divided by the number of rows.
    """
    shares, expected = np.zeros(len(residuals)), np.zeros(len(residuals))
    for state, (values, weights) in enumerate(zip(residuals, measurements.weights, strict=True)):
        explained, total, taken, rows = 0.0, 0.0, 0, 0
        for first, end in measurements.bounds.tolist():
            known = weights[first:end] > 0.0
            roots, count = np.sqrt(weights[first:end])[known], int(known.sum())
            waves = min(count, 3 + round(float(pieces[state]) * (end - first) / measurements.rows))
            places = (np.arange(end - first) + 0.5)[known] * (math.pi / (end - first))
            basis = np.linalg.qr(roots[:, None] * np.cos(places[:, None] * np.arange(waves)))[0]
            scaled = values[first:end][known] * roots
            explained += float(((scaled @ basis) ** 2).sum())
            total += float(scaled @ scaled)
            taken, rows = taken + waves, rows + count
        shares[state] = explained / total if total > 0.0 else 0.0
        expected[state] = taken / max(rows, 1)
    return shares, expected


def count_pieces(measurements: TrajectoryMeasurements) -> FloatArray:
    """Return the number of independent numbers (O,) in errors that vary as slowly as the derivatives of the states.

    This is the number of rows divided by their correlation length. The correlation length is the lag at which the
    autocorrelation of the differences of the smoothed states falls below 1/e; it is at least one row.
    """
    counts = np.zeros(len(measurements.observed))
    pieces = list(_ranges_without_gaps(measurements))
    for place, smoothed in enumerate(measurements.smoothed_columns):
        parts = [np.diff(smoothed[rows]) for rows in pieces]
        rows = float((measurements.weights[place] > 0.0).sum())
        counts[place] = max(rows / _correlation_length(parts), 1.0)
    return counts


def _correlation_length(parts: Sequence[FloatArray]) -> int:
    """Return the lag at which the autocorrelation of all `parts` falls below 1/e; the largest lag if it never does.

    Sums computed by Fourier transforms have rounding errors, so they only show which lags are possible. At these lags
    the sums are then computed directly.
    """
    least = sum(float(part @ part) for part in parts) / math.e
    sums = np.zeros(max(map(len, parts), default=0))
    for part in parts:
        size = 1 << (2 * len(part)).bit_length()
        sums[: len(part)] += np.fft.irfft(np.abs(np.fft.rfft(part, size)) ** 2, size)[: len(part)]
    for lag in (np.flatnonzero(~(sums[1:] > (1.0 + _ROUNDING) * least)) + 1).tolist():
        if not sum(float(part[:-lag] @ part[lag:]) for part in parts if len(part) > lag) > least:
            return int(lag)
    return max(len(sums), 1)


def _ranges_without_gaps(measurements: TrajectoryMeasurements) -> Iterator[slice]:
    """Yield ranges of rows without a gap between them, regardless of the pieces of simulations."""
    times = measurements.times
    steps = np.diff(times)
    usual = 1.5 * float(np.median(steps)) if len(steps) else 0.0
    start, before = 0, -1
    for (first, _), owner in zip(measurements.bounds.tolist(), measurements.owners.tolist(), strict=True):
        if first and (owner != before or not 0.0 < steps[first - 1] <= usual):
            yield slice(start, first)
            start = first
        before = owner
    yield slice(start, measurements.rows)
