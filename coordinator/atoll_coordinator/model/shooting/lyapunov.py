"""How fast errors of a state grow along a fitted system: its largest Lyapunov exponent, from fitted pieces.

The sensitivities to a piece's initial state say what becomes of a small error by its end. Their largest singular value
averages, in logarithm over all pieces, to the largest exponent times the length of a piece, beyond the first steps of
which it is a little too large (Benettin et al. 1980).
"""

import math

import numpy as np

from atoll_coordinator.model.shooting.trajectory_fit import TrajectoryFit


def growth_rate(fit: TrajectoryFit) -> float:
    """Return the rate at which errors grow, in e-folds per unit of time, on average along all segments of `fit`.

    Negative where they shrink; NaN without a segment of two rows.
    """
    fitted, states = len(fit.system.places), len(fit.system.outputs)
    times = fit.estimator.measurements.times
    sensitivities = fit.integrated_sensitivities()[:, :, fitted : fitted + states]
    scales = fit.estimator.measurements.scales
    logarithms = duration = 0.0
    for first, end in fit.segments.tolist():
        if end - first > 1:
            unit = sensitivities[end - 1] * scales[None, :] / scales[:, None]
            logarithms += math.log(max(float(np.linalg.norm(unit, 2)), 1e-300))
            duration += float(times[end - 1] - times[first])
    return logarithms / duration if duration > 0.0 else math.nan
