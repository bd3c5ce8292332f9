"""Is an equation a better description than having no equation? Evidence against a constant and a random walk. Pure.

A search that tries thousands of structures on few rows finds one that passes through all of them. The evidence of the
rows for it is the marginal likelihood, with the variance of the errors and the constants integrated out: n rows minus
the numbers fitted to them count, so that a model with as many numbers as rows gains nothing. By the inequality of
Markov a description that is shorter than without an equation by t nats comes about by chance with a probability of at
most exp(-t), however many structures were tried, as these are part of its length.

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
"""Nats beyond its knee to which the integrand is followed: it falls as exp(-t/2) there at least."""
_LEAVES: Final = 4.0
"""Number of leaves to choose from, according to the price of a structure."""
_LEAST_LEFT: Final = 1e-30
"""Guard: smallest share of a variance that counts as more than zero."""


def log_bayes_factor(rows: float, constants: float, left: float) -> float:
    """Return the nats for a regression with k constants against the mean alone, n rows; 0 where k >= n - 1.

    A model without constants has errors of a size of its own, and nothing else is fitted.

    The hyper-g prior with a = 3 (Liang et al. 2008, J. Am. Stat. Assoc. 103:410, equation 17), with the variance of the
    errors unknown:

        1/2 int_0^inf (1 + g)^((n - 1 - k - 3)/2) (1 + g (1 - R2))^(-(n - 1)/2) dg

    Args:
        rows: n.
        constants: k.
        left: 1 - R2, the squared residuals over the squared differences from the mean; over the squared steps of a
            random walk, which have one number less than there are rows as well.
    """
    if rows - 1.0 <= constants:
        return 0.0
    left = max(left, _LEAST_LEFT)
    if constants <= 0.0:
        return -0.5 * (rows - 1.0) * math.log(left)
    left = min(left, 1.0)
    places = np.linspace(0.0, -math.log(left) + _TAIL, _POINTS)  # t = ln(1 + g)
    exponents = 0.5 * (rows - 2.0 - constants) * places - 0.5 * (rows - 1.0) * np.log1p(np.expm1(places) * left)
    top = float(exponents.max())
    values = np.exp(exponents - top)
    step = float(places[1] - places[0])
    return top + math.log(0.5 * step * (float(values.sum()) - 0.5 * float(values[0] + values[-1])))


def squared_steps(series: Sequence[FloatArray], times: Sequence[FloatArray] | None = None) -> float:
    """Return the sum of squared steps from row to row of all series (R,): the residuals of a random walk.

    With the `times` (R,) of each series the walk has a drift, the same for all.
    """
    steps = np.concatenate([np.diff(values) for values in series])
    if times is not None:
        gaps = np.concatenate([np.diff(moments) for moments in times])
        steps = steps - gaps * float(steps @ gaps) / max(float(gaps @ gaps), 1e-300)
    return float(steps @ steps)


def structure_price(program: Program, columns: int) -> float:
    """Return the nats of a structure (`structure_length`), each of its variables one of this many columns.

    That price counts a leaf as one of four, regardless of the number of columns.
    """
    leaves = int((program.operators == VARIABLE).sum())
    return structure_length(program) + leaves * max(math.log(max(columns, 1) / _LEAVES), 0.0)
