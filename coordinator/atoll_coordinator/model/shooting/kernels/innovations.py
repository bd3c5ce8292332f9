"""Transform correlated errors of neighbouring rows into independent ones: the innovations of a Kalman filter.

The errors of a state are sigma (c + w). c is a correlated process with variance `share`; w is independent noise with
variance 1 - share. There are two models of c. A rough process describes errors of sensors: an Ornstein-Uhlenbeck
process with correlation `decay`^s between rows at a distance of s median steps (AR(1) if the rows are evenly spaced). A
smooth process describes errors of a law: its correlation is (1 + rate s + (rate s)^2/3) exp(-rate s), and it has two
derivatives (Matern 5/2; Hartikainen & Sarkka 2010, section 3). The filter gives the likelihood of all rows in one pass
(Harvey 1989, Forecasting, Structural Time Series Models and the Kalman Filter, section 3.4). Letters: N rows, G
segments; segments are independent.
"""

import math
from typing import Final

import numpy as np

from atoll_core.compilation.jit import inlined, kernel
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.kernels.tape import Ints

LEAST_VARIANCE: Final = 1e-12
"""Smallest variance of an innovation. If a smooth process is predicted to all digits, its variance is only rounding
errors and may be negative."""

_AT_REST: Final = np.array([[1.0, 0.0, -1.0 / 3.0], [0.0, 1.0 / 3.0, 0.0], [-1.0 / 3.0, 0.0, 1.0]])
"""Stationary covariance of a smooth process of variance 1, its first derivative divided by the rate, and its second
derivative divided by the square of the rate."""
_ONCE: Final = np.array([[1.0, 1.0, 0.0], [0.0, 1.0, 1.0], [-1.0, -3.0, -2.0]])
_TWICE: Final = _ONCE @ _ONCE
"""The transition matrix of this state over s steps is exp(-t) (1 + t `_ONCE` + t^2/2 `_TWICE`), t = rate * s; the third
power of `_ONCE` is 0."""


@inlined
def decayed(decay: float, step: float) -> float:
    """Return the correlation of two rows at a distance of `step` median steps."""
    if step == 1.0:
        return decay
    return math.exp(step * math.log(decay)) if decay > 0.0 else 0.0


@kernel
def innovate(segments: Ints, steps: FloatArray, residuals: FloatArray, weights: FloatArray, share: float,
             decay: float, sums: FloatArray, whitened: FloatArray) -> None:  # fmt: skip
    """Write the sums of the log-likelihood of the residuals of one state into `sums`, for a rough process.

    Args:
        segments: half-open row ranges, (G, 2).
        steps: time step from the row before, divided by the median time step, (N,).
        residuals: residuals of the state, (N,).
        weights: inverse variances of its rows up to the factor sigma^2, (N,); rows of weight 0 are left out.
        share: share of the variance that belongs to the correlated process, in [0, 1].
        decay: correlation of this process between rows at a distance of one median step, in [0, 1).
        sums: result, (2,): the sum of squared innovations divided by their variances, and the sum of the logarithms of
            these variances.
        whitened: result, (N,), unless it is empty: innovations divided by their standard deviations, in the units of
            residuals with these weights; 0 in rows that are left out.
    """
    squares, logarithms = 0.0, 0.0
    white = 1.0 - share
    for g in range(segments.shape[0]):
        expected, variance = 0.0, share
        for row in range(segments[g, 0], segments[g, 1]):
            if row > segments[g, 0] and share > 0.0:
                kept = decayed(decay, steps[row])
                expected *= kept
                variance = kept * kept * variance + share * (1.0 - kept * kept)
            w = weights[row]
            if w > 0.0:
                total = variance + white
                error = math.sqrt(w) * residuals[row] - expected
                squares += error * error / total
                if len(whitened):
                    whitened[row] = error / math.sqrt(w * total)
                if share > 0.0:
                    logarithms += math.log(total)
                    gain = variance / total
                    expected += gain * error
                    variance -= gain * variance
    sums[0] = squares
    sums[1] = logarithms


@kernel
def innovate_smooth(segments: Ints, steps: FloatArray, residuals: FloatArray, weights: FloatArray, share: float,
                    rate: float, sums: FloatArray, moved: FloatArray, spread: FloatArray, half: FloatArray,
                    means: FloatArray) -> None:  # fmt: skip
    """Write the same `sums` as `innovate`, for a smooth correlated process with this `rate` per median step.

    The state of the filter is the process, its first derivative divided by the rate, and its second derivative divided
    by the square of the rate. `moved`, `spread`, `half` (3, 3) and `means` (2, 3) are scratch.
    """
    squares, logarithms, taken = 0.0, 0.0, -1.0
    white = 1.0 - share
    for g in range(segments.shape[0]):
        for i in range(3):
            means[0, i] = 0.0
            for j in range(3):
                spread[i, j] = share * _AT_REST[i, j]
        for row in range(segments[g, 0], segments[g, 1]):
            if row > segments[g, 0]:
                if steps[row] != taken:
                    taken = steps[row]
                    turned = rate * taken
                    kept = math.exp(-turned)
                    for i in range(3):
                        for j in range(3):
                            own = 1.0 if i == j else 0.0
                            moved[i, j] = kept * (own + turned * _ONCE[i, j] + 0.5 * turned * turned * _TWICE[i, j])
                for i in range(3):
                    means[1, i] = moved[i, 0] * means[0, 0] + moved[i, 1] * means[0, 1] + moved[i, 2] * means[0, 2]
                    for j in range(3):
                        total = 0.0
                        for k in range(3):
                            total += moved[i, k] * (spread[k, j] - share * _AT_REST[k, j])
                        half[i, j] = total
                for i in range(3):
                    means[0, i] = means[1, i]
                    for j in range(3):
                        spread[i, j] = share * _AT_REST[i, j] + (
                            half[i, 0] * moved[j, 0] + half[i, 1] * moved[j, 1] + half[i, 2] * moved[j, 2]
                        )
            w = weights[row]
            if w > 0.0:
                variance = max(spread[0, 0] + white, LEAST_VARIANCE)
                error = math.sqrt(w) * residuals[row] - means[0, 0]
                squares += error * error / variance
                logarithms += math.log(variance)
                for i in range(3):
                    means[1, i] = spread[i, 0]
                for i in range(3):
                    means[0, i] += means[1, i] / variance * error
                    for j in range(3):
                        spread[i, j] -= means[1, i] * means[1, j] / variance
    sums[0] = squares
    sums[1] = logarithms
