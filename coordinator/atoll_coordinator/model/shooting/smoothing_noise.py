"""The size of errors of measurement from the residuals of smoothing, before a law is known. Pure.

The variance of a row is a^2 + b^2 x^2 with the smoothed value x, the two-component model of analytical chemistry
(Rocke & Lorenzato 1995); it is fitted to the residuals of smoothing, which do not depend on any law. ``residual_noise``
estimates the errors from the residuals of a law.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from atoll_coordinator.data.recording import Recording, Smoothing
from atoll_coordinator.model.loess_matrix import residual_shares
from atoll_core.data.dataset import FloatArray

_SHARES: Final = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.98, 0.99)
"""Proportional shares that are tried; at the last, errors at zero are a tenth of the errors at the root mean square."""
_EVIDENCE: Final = 1.0
"""Nats by which errors that grow with the value must be the better description. Measured on equal errors, decays and
waves of 8 to 200 rows, 80 tables each: that much comes about by chance in 0 to 5 %; of errors in proportion to the
value it is there in 72 % of tables of 21 rows."""


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
