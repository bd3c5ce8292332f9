"""Errors of neighbouring rows that go together, made independent: the innovations of a Kalman filter.

The errors of a state are sigma (c + w) with c of variance `share` and w independent, of variance 1 - share. What goes
together is rough, as errors of sensors are: an Ornstein-Uhlenbeck process, of correlation `decay`^s between rows s
median steps apart (AR(1) where rows are even). Or it is smooth, as the errors of a law are: of correlation
(1 + rate s + (rate s)^2/3) exp(-rate s), which has two derivatives (Matern 5/2; Hartikainen & Sarkka 2010, section 3).
The filter gives the likelihood of all rows in one pass (Harvey 1989, Forecasting, Structural Time Series Models and
the Kalman Filter, section 3.4). Letters: N rows, G segments; segments are independent.
"""

import math
from typing import Final

import numpy as np

from atoll_core.compilation.jit import inlined, kernel
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.kernels.tape import Ints

LEAST_VARIANCE: Final = 1e-12
"""Guard: the variance of a smooth process that is known to all digits is rounding errors."""

_AT_REST: Final = np.array([[1.0, 0.0, -1.0 / 3.0], [0.0, 1.0 / 3.0, 0.0], [-1.0 / 3.0, 0.0, 1.0]])
"""Covariance of a smooth process and its derivatives, these over the rate and its square."""
_ONCE: Final = np.array([[1.0, 1.0, 0.0], [0.0, 1.0, 1.0], [-1.0, -3.0, -2.0]])
_TWICE: Final = _ONCE @ _ONCE
"""It moves by exp(-t) (1 + t `_ONCE` + t^2/2 `_TWICE`) in the time t over the rate; the next power is 0."""


@inlined
def decayed(decay: float, step: float) -> float:
    """Return the correlation of rows that are `step` median steps apart."""
    if step == 1.0:
        return decay
    return math.exp(step * math.log(decay)) if decay > 0.0 else 0.0


@kernel
def innovate(segments: Ints, steps: FloatArray, residuals: FloatArray, weights: FloatArray, share: float,
             decay: float, sums: FloatArray, whitened: FloatArray) -> None:  # fmt: skip
    """Write into `sums` (2,) the sum of squared innovations over their variance, and of the variances' logarithms.

    Args:
        segments: row ranges (G, 2).
        steps: from the row before, (N,), over their median.
        residuals: of one state, (N,).
        weights: inverse variances of its rows, (N,), up to sigma; of zero: the row is left out.
        share: of the variance that goes together, in [0, 1].
        decay: correlation of this share between rows one median step apart, in [0, 1).
        sums: what is written.
        whitened: what is written, too, unless it is empty: the innovations (N,) over the roots of their variance, as
            residuals of these weights, 0 in rows that are left out.
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
    """Write what `innovate` does where the share that goes together is smooth, of this `rate` per median step.

    The state is the process, its first derivative over the rate and its second over the rate's square. `moved`,
    `spread`, `half` (3, 3) and `means` (2, 3) are written as well.
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
