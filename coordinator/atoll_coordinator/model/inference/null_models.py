"""Evidence for an equation against null models without an equation: a constant and a random walk. Pure.

A search that tries thousands of structures on few rows always finds a structure that fits all rows. So
`log_bayes_factor` compares marginal likelihoods, with the constants and the variance of the errors integrated out: a
model with as many fitted numbers as rows gains nothing. `structure_price` is subtracted for the choice of the
structure. Chance can also make a description t nats shorter than the null model's description. By Markov's inequality,
the probability of this is at most exp(-t). The bound holds for any number of tried structures, since the length
includes the price of the structure.

Doubtful: the rows must be independent, so callers pass effective numbers of rows. The g prior (a = 3) and the prices of
structures are conventions. The evidence is computed for a linear regression; constants that enter nonlinearly are
treated like linear ones.

Letters: n rows, k fitted constants in addition to the location.
"""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from atoll_coordinator.model.description_length import structure_length
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.operators import VARIABLE
from atoll_core.expression.program import Program

_POINTS: Final = 4_001
_TAIL: Final = 60.0
"""Distance t from the knee of the integrand to the end of the integration: beyond the knee, the integrand decreases at
least like exp(-t/2)."""
_LEAVES: Final = 4.0
"""The number of different leaves that the price of a structure assumes."""
_LEAST_UNEXPLAINED: Final = 1e-30
"""Smallest share of a variance, to avoid the logarithm of zero."""


def log_bayes_factor(rows: float, constants: float, unexplained: float) -> float:
    """Return the log Bayes factor, in nats, of a regression with k constants against the mean of the n rows; 0 if k >=
    n - 1.

    A model without constants fits only the variance of its errors.

    For the hyper-g prior with a = 3 and an unknown variance of the errors, the Bayes factor is (Liang et al. 2008, J.
    Am. Stat. Assoc. 103:410, equation 17):

        1/2 int_0^inf (1 + g)^((n - 1 - k - 3)/2) (1 + g (1 - R2))^(-(n - 1)/2) dg

    Args:
        rows: n.
        constants: k.
        unexplained: 1 - R2, a ratio of sums of squares. The numerator is the sum over residuals. The denominator is the
            sum over differences from the mean, or over the steps of a random walk; both have n - 1 degrees of freedom.
    """
    if rows - 1.0 <= constants:
        return 0.0
    unexplained = max(unexplained, _LEAST_UNEXPLAINED)
    if constants <= 0.0:
        return -0.5 * (rows - 1.0) * math.log(unexplained)
    unexplained = min(unexplained, 1.0)
    places = np.linspace(0.0, -math.log(unexplained) + _TAIL, _POINTS)  # t = ln(1 + g)
    exponents = 0.5 * (rows - 2.0 - constants) * places - 0.5 * (rows - 1.0) * np.log1p(np.expm1(places) * unexplained)
    top = float(exponents.max())
    values = np.exp(exponents - top)
    step = float(places[1] - places[0])
    return top + math.log(0.5 * step * (float(values.sum()) - 0.5 * float(values[0] + values[-1])))


def squared_steps(series: Sequence[FloatArray], times: Sequence[FloatArray] | None = None) -> float:
    """Return the sum of squared differences of neighbouring rows, over all series (R,). These differences are the
    residuals of a random walk.

    If the `times` (R,) of each series are given, the walk has a drift, the same for all series.
    """
    steps = np.concatenate([np.diff(values) for values in series])
    if times is not None:
        gaps = np.concatenate([np.diff(moments) for moments in times])
        steps = steps - gaps * float(steps @ gaps) / max(float(gaps @ gaps), 1e-300)
    return float(steps @ steps)


def structure_price(program: Program, columns: int) -> float:
    """Return the price of a structure in nats (`structure_length`), corrected for the number of columns.

    `structure_length` assumes that each leaf is a choice from four. If there are more columns, each variable costs
    more.
    """
    leaves = int((program.operators == VARIABLE).sum())
    return structure_length(program) + leaves * max(math.log(max(columns, 1) / _LEAVES), 0.0)
