"""The size of errors of measurement: from smoothing, before a law is known, and from residuals of a law. Pure.

*By smoothing* (`estimate_variances`). The variance of a row is a^2 + b^2 x^2 with the smoothed value x, the
two-component model of analytical chemistry (Rocke & Lorenzato 1995); it is fitted to the residuals of smoothing, which
do not depend on any law. *By residuals* (`roughness`, `slow_shares`). Errors of measurement are rough, the errors of a
law are slow: second differences give the size of errors of measurement, cosines along the rows the share of errors of
the law. `count_pieces` returns the number of independent numbers in slow errors. Letters: O measured states, N rows, R
rows of some trajectories.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from atoll_coordinator.data.recording import Recording, Smoothing
from atoll_coordinator.model.loess_matrix import residual_shares
from atoll_core.data.dataset import FloatArray

if TYPE_CHECKING:
    from atoll_coordinator.model.shooting.measurements import Measurements

_SHARES: Final = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.98, 0.99)
"""Proportional shares that are tried; at the last, errors at zero are a tenth of the errors at the root mean square."""
_EVIDENCE: Final = 1.0
"""Nats by which errors that grow with the value must be the better description. Measured on equal errors, decays and
waves of 8 to 200 rows, 80 tables each: that much comes about by chance in 0 to 5 %; of errors in proportion to the
value it is there in 72 % of tables of 21 rows."""
ROUGHNESS_VARIANCE: Final = 35.0 / 9.0
"""Relative variance of the variance that `roughness` estimates, times the rows: second differences of independent
errors have the correlations -2/3 and 1/6 (Gasser, Sroka & Jennen-Steinmetz 1986)."""

_ROUNDING: Final = 1e-9
"""Guard: sums of squares by transforms of 1e9 rows err by less than this share of the largest."""


@dataclass(frozen=True)
class VarianceModel:
    """Errors of one state: the `proportional` share of their variance where the state is as large as its `rms`.

    `mean` is the mean of inverse variances over the rows of the recording, so that weights are 1 on average. `scale` is
    the standard deviation in a row of weight 1 over the one for equal weights.
    """

    proportional: float = 0.0
    rms: float = 1.0
    mean: float = 1.0
    scale: float = 1.0

    def weights(self, values: FloatArray) -> FloatArray:
        """Return the inverse variances of rows with these smoothed values, 1 on average over the recording."""
        return np.asarray(_inverse(values / self.rms, self.proportional) / self.mean)


def estimate_variances(recording: Recording) -> list[VarianceModel]:
    """Return the variances of the errors of each state, by the residuals of its smoothing.

    Errors are proportional to the value where that is the better description by `_EVIDENCE`, of a state alone or of all
    states together, since they are usually measured in one way; not where a state speaks against it.
    """
    found = [_estimate(recording, state) for state in range(len(recording.states))]
    together = sum(evidence for _, evidence in found)
    return [
        model if evidence >= _EVIDENCE or (evidence > 0.0 and together >= _EVIDENCE) else VarianceModel()
        for model, evidence in found
    ]


def _estimate(recording: Recording, state: int) -> tuple[VarianceModel, float]:
    """Return the best proportional share of one state (index), and the evidence for any: nats over equal errors.

    A trajectory along which the state is 0 throughout says nothing. Loess follows the errors of rows at the ends, so
    that each row counts by the share of its error that is in its residual. All proportional shares are as likely
    beforehand. There is no evidence where the state was interpolated, where outliers have lost their weight, or where
    rows have weights.
    """
    searched = [trajectory for trajectory in recording.trajectories if not trajectory.held_out]
    parts = [trajectory for trajectory in searched if np.nan_to_num(trajectory.measured[state]).any()] or searched
    is_given, smoothing = any(part.weights is not None for part in parts), recording.smoothing[state]
    if is_given or smoothing.method != "loess":
        return VarianceModel(), 0.0
    residuals = np.concatenate([part.measured[state] - part.smoothed[state] for part in parts])
    values = np.concatenate([part.smoothed[state] for part in parts])
    shares = np.concatenate([_residual_shares(smoothing, len(part.times)) for part in parts])
    known = np.isfinite(residuals)
    residuals, values, shares = residuals[known], values[known], shares[known]
    rms, square = float(np.sqrt(np.mean(values**2))), float(np.sum(residuals**2))
    count = float(shares.sum())
    if not (rms > 0.0 and square > 0.0 and count > 0.0):
        return VarianceModel(), 0.0
    gains, models = [], []
    for share in _SHARES:
        inverse = _inverse(values / rms, share)
        weighted, mean = float(np.sum(inverse * residuals**2)), float(inverse.mean())
        gains.append(0.5 * count * math.log(square / weighted) + 0.5 * float(shares @ np.log(inverse)))
        models.append(VarianceModel(share, rms, mean, math.sqrt(weighted / mean / square)))
    best = max(range(len(gains)), key=lambda place: gains[place])
    evidence = gains[best] + math.log(sum(math.exp(gain - gains[best]) for gain in gains) / len(gains))
    return models[best], evidence


def _residual_shares(smoothing: Smoothing, rows: int) -> FloatArray:
    """Return the variance (R,) of the residual of each row over the variance of its error."""
    if smoothing.span is None or smoothing.degree is None:
        return np.ones(rows)
    return residual_shares(rows, smoothing.span, smoothing.degree)


def _inverse(relative: FloatArray, share: float) -> FloatArray:
    return np.asarray(1.0 / (1.0 - share + share * relative * relative))


def roughness(measurements: "Measurements", residuals: FloatArray) -> FloatArray:
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
    measurements: "Measurements", residuals: FloatArray, pieces: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the share of the residuals' squares (O,) that slow waves explain, and the expected share.

    The errors of a law move a state no faster than its derivative varies. Hence they are a sum of about `pieces` (O,)
    cosines along the rows, and three more along each trajectory, whose initial state and constants take up the slowest.
    Of the squares of independent errors, the cosines explain on average their number over the number of rows.
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

    Fourier transforms give the possible lags up to rounding errors; the sums are computed at these.
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
    """Yield ranges of rows without a gap between them, regardless of the pieces of simulations."""
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
