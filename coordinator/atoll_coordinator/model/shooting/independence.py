"""How many independent numbers measured trajectories hold, and how large their independent errors are. Pure.

Letters: O measured states, N rows.
"""

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from atoll_core.data.dataset import FloatArray

if TYPE_CHECKING:  # it brings the kernels along, which the checks of a verdict do without
    from atoll_coordinator.model.shooting.measurements import Measurements

ROUGHNESS_VARIANCE: Final = 35.0 / 9.0
"""Relative variance of the variance that `roughness` estimates, times the rows: second differences of independent
errors have the correlations -2/3 and 1/6 (Gasser, Sroka & Jennen-Steinmetz 1986)."""

_ROUNDING: Final = 1e-9
"""Guard: sums of squares by transforms of 1e9 rows err by less than this share of the largest."""


def roughness(measurements: "Measurements", residuals: FloatArray) -> FloatArray:
    """Return the standard deviation (O,) of the independent part of `residuals` (O, N), from their second differences.

    What varies slowly along the rows leaves nearly nothing in these.
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
    measurements: "Measurements", residuals: FloatArray, pieces: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the share of the residuals' squares (O,) that slow waves explain, and that of independent errors.

    What a law leaves out moves a state no faster than its derivative varies, hence is a sum of about `pieces` (O,)
    cosines along the rows, and three more along each trajectory, whose initial state and constants take up the slowest.
    They explain their number over that of the rows of the squares of independent errors, on average.
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


def count_pieces(measurements: "Measurements") -> FloatArray:
    """Return how many independent numbers (O,) errors are that vary as the states' derivatives do.

    Rows over their correlation length, the lag at which the autocorrelation of the smoothed states' differences falls
    below 1/e; at most all rows.
    """
    counts = np.zeros(len(measurements.observed))
    pieces = list(_stretches(measurements))
    for place, state in enumerate(measurements.observed.tolist()):
        parts = [np.diff(measurements.smoothed[state, rows]) for rows in pieces]
        rows = float((measurements.weights[place] > 0.0).sum())
        counts[place] = max(rows / _correlation_length(parts), 1.0)
    return counts


def _correlation_length(parts: Sequence[FloatArray]) -> int:
    """Return the lag at which the autocorrelation of `parts`, all together, falls below 1/e; the longest where none is.

    Transforms tell at which lags that may be, up to their rounding errors; there it is summed up.
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


def _stretches(measurements: "Measurements") -> Iterator[slice]:
    """Yield the rows between which there is no gap, whatever pieces they are simulated in."""
    times = measurements.times
    steps = np.diff(times)
    usual = 1.5 * float(np.median(steps)) if len(steps) else 0.0
    begun, before = 0, -1
    for (first, _), owner in zip(measurements.bounds.tolist(), measurements.owners.tolist(), strict=True):
        if first and (owner != before or not 0.0 < steps[first - 1] <= usual):
            yield slice(begun, first)
            begun = first
        before = owner
    yield slice(begun, measurements.rows)
