"""The size of errors of measurement, estimated from the residuals of smoothing, before a law is known. Pure.

The variance of a row is a^2 + b^2 x^2 with the smoothed value x: the two-component model of analytical chemistry (Rocke
& Lorenzato 1995). The model is fitted to the residuals of smoothing. These residuals do not depend on any law.
``residual_noise`` estimates the errors from the residuals of a law.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from atoll_coordinator.data.recording import Recording, StateSmoothing
from atoll_coordinator.model.loess_matrix import residual_shares
from atoll_core.data.dataset import FloatArray

_SHARES: Final = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.98, 0.99)
"""Proportional shares that are tried. With the last share, errors of the value zero are a tenth of the errors of the
value `rms`."""
_EVIDENCE: Final = 1.0
"""Errors are treated as growing with the value if this saves at least this many nats. The limit was tested on decays
and waves of 8 to 200 rows, with 80 tables each. If errors have constant size, 0 to 5 % of the tables reach this gain by
chance. If errors are proportional to the value, 72 % of the tables with 21 rows reach it."""


@dataclass(frozen=True)
class VarianceModel:
    """Error variance of one state. A part of the variance is proportional to the square of the value: `proportional` is
    the share of this part, for the value `rms`.

    `mean` is the mean of inverse variances over the rows of the recording; weights are divided by it, so that they are
    1 on average. `scale` is the standard deviation of a row of weight 1, divided by the standard deviation for equal
    weights.
    """

    proportional: float = 0.0
    rms: float = 1.0
    mean: float = 1.0
    scale: float = 1.0

    def weights(self, values: FloatArray) -> FloatArray:
        """Return the inverse variances of rows with these smoothed values. Over the whole recording, their mean is
        1."""
        return np.asarray(_inverse(values / self.rms, self.proportional) / self.mean)


def estimate_variances(recording: Recording) -> list[VarianceModel]:
    """Return the error variance model of each state, estimated from the residuals of its smoothing.

    Errors grow with the value if this shortens the description by `_EVIDENCE` nats. This gain is computed for each
    state and for all states together, since states are usually measured in the same way. A state with negative evidence
    has constant errors.
    """
    found = [_estimate_state(recording, state) for state in range(len(recording.states))]
    together = sum(evidence for _, evidence in found)
    return [
        model if evidence >= _EVIDENCE or (evidence > 0.0 and together >= _EVIDENCE) else VarianceModel()
        for model, evidence in found
    ]


def _estimate_state(recording: Recording, state: int) -> tuple[VarianceModel, float]:
    """Return the best proportional share of one state (index), and the evidence for a proportional share: the nats that
    it saves compared with errors of equal size.

    A trajectory along which the state is always 0 is left out. Loess follows the errors of rows at the ends, so each
    row is weighted by the share of its error that remains in its residual. All proportional shares have the same prior
    probability. The evidence is 0 if the state was interpolated, if outliers have reduced weights, or if rows have
    weights.
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


def _residual_shares(smoothing: StateSmoothing, rows: int) -> FloatArray:
    """Return, for each row (R,), the variance of its residual divided by the variance of its error."""
    if smoothing.span is None or smoothing.degree is None:
        return np.ones(rows)
    return residual_shares(rows, smoothing.span, smoothing.degree)


def _inverse(relative: FloatArray, share: float) -> FloatArray:
    return np.asarray(1.0 / (1.0 - share + share * relative * relative))
