"""The noise of a state: from what loess leaves, or from rows that are predicted by their neighbours (pure)."""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from atoll_coordinator.data.differentiation.smoothing import Signal, Smoother, smooth
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import FloatArray

NORMAL_DEVIATION: Final = 1.4826
"""Standard deviation of normal errors over the median of their size: 1 / 0.6745."""
MEDIAN_ERROR: Final = 1.1664
"""Relative standard error of the median size of R normal errors, times sqrt(R): 1 / (2 m f(m)) with the median
m = 0.6745 and the density f of the size."""
QUIET_DEVIATION: Final = 7.9579
"""A normal error's standard deviation over its size that a tenth of such errors stay below, 0.12566."""
QUIET_ERROR: Final = 3.0156
"""Relative standard error of that size of R errors, times sqrt(R): sqrt(0.1 0.9) / (2 m f(m)), see `MEDIAN_ERROR`."""


def estimate_noise(signals: Sequence[Signal], smoother: Smoother) -> float:
    """Return the estimated standard deviation of the errors in a row of inverse variance 1, by what `smoother` leaves.

    Squared residuals over degrees of freedom (Cleveland & Devlin 1988, section 3): rows minus twice the trace of the
    smoother plus the trace of its square. Rows without weight do not count.
    """
    squares, degrees_of_freedom = 0.0, 0.0
    for signal in signals:
        fit, inverse_variances = smooth(signal, smoother), signal.filled_inverse_variances
        residuals, weights = (signal.values - fit.fits[0]).tolist(), signal.weights.tolist()
        row_degrees_of_freedom = (1.0 - 2.0 * fit.gains[3] + inverse_variances * fit.gains[0] * fit.gains[0]).tolist()
        rows = zip(residuals, weights, inverse_variances.tolist(), row_degrees_of_freedom, strict=True)
        for residual, weight, inverse_variance, free in rows:
            if weight > 0.0:
                squares += inverse_variance * residual * residual
                degrees_of_freedom += free
    return math.sqrt(squares / max(degrees_of_freedom, 1.0))


def are_moving(parts: Sequence[FloatArray]) -> npt.NDArray[np.bool_]:
    """Return which rows (R,) of trajectories are none of three or more with one value, NaN passed over.

    Such rows, as of a sensor that ends at 0, are predicted without an error, and say nothing of the noise.
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
    agreement = 1.0 + SETTINGS.interpolation.agreement * error * math.sqrt(2.0 / rows)
    return float(np.max(noises[noises <= agreement * np.min(noises)]))
