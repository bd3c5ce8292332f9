"""Errors of neighbouring rows that go together, made independent: the innovations of a Kalman filter.

The errors of a state are sigma (c + w) with c of variance `share` and correlation `decay`^s between rows s median steps
apart (an Ornstein-Uhlenbeck process, AR(1) where rows are even) and w independent, of variance 1 - share. The filter
gives the likelihood of all rows in one pass (Harvey 1989, Forecasting, Structural Time Series Models and the Kalman
Filter, section 3.4). Letters: N rows, G segments; segments do not know of each other.
"""

import math

from atoll_core.compilation.jit import inlined, kernel
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.kernels.tape import Ints


@inlined
def decayed(decay: float, step: float) -> float:
    """Return the correlation of rows that are `step` median steps apart."""
    if step == 1.0:
        return decay
    return math.exp(step * math.log(decay)) if decay > 0.0 else 0.0


@kernel
def innovate(segments: Ints, steps: FloatArray, residuals: FloatArray, weights: FloatArray, share: float,
             decay: float, sums: FloatArray) -> None:  # fmt: skip
    """Write into `sums` (2,) the sum of squared innovations over their variance, and of the variances' logarithms.

    Args:
        segments: row ranges (G, 2).
        steps: from the row before, (N,), over their median.
        residuals: of one state, (N,).
        weights: inverse variances of its rows, (N,), up to sigma; of zero: the row is left out.
        share: of the variance that goes together, in [0, 1].
        decay: correlation of that of rows one median step apart, in [0, 1).
        sums: what is written.
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
                if share > 0.0:
                    logarithms += math.log(total)
                    gain = variance / total
                    expected += gain * error
                    variance -= gain * variance
    sums[0] = squares
    sums[1] = logarithms
