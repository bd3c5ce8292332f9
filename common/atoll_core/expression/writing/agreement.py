"""Whether two writings have the same values over the box of the data."""

from typing import Final

import numpy as np

from atoll_core.data.dataset import FloatArray
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.program import Program
from atoll_core.expression.writing.shortest import shortest

_MOST_ROWS: Final = 500
_POINTS: Final = 250
_TOLERANCE: Final = 1e-6


def shortest_over(program: Program, inputs: FloatArray) -> Program:
    """Return the shortest writing of `program`, or itself where the values differ over the box of `inputs` (V, R)."""
    short = shortest(program)
    return short if short == program or agree(program, short, points_of(inputs)) else program


def agree(before: Program, after: Program, points: FloatArray) -> bool:
    """Tell whether `after` has the values of `before` wherever there are any, up to rounding."""
    old, new = values_of(before, points), values_of(after, points)
    defined = np.isfinite(old)
    if not defined.any():
        return True
    size = float(np.median(_TOLERANCE * np.abs(old[defined])))  # the mean of two values may be beyond all numbers
    return bool(np.allclose(new[defined], old[defined], rtol=_TOLERANCE, atol=size))


def points_of(inputs: FloatArray) -> FloatArray:
    """Return rows of `inputs` (V, R >= 1), spread evenly, and points that fill the box around them (V, P).

    The points are an additive recurrence (Roberts 2018): no two of a coordinate are equal.
    """
    variables, rows = inputs.shape
    count = min(rows, _MOST_ROWS)
    chosen = inputs[:, np.arange(count) * rows // count]
    root = 2.0
    for _ in range(30):
        root = (1.0 + root) ** (1.0 / (variables + 1))
    steps = root ** -np.arange(1.0, variables + 1.0)
    low, high = inputs.min(axis=1), inputs.max(axis=1)
    unit = np.outer(steps, np.arange(1.0, _POINTS + 1.0)) % 1.0
    return np.ascontiguousarray(np.concatenate([chosen, low[:, None] + unit * (high - low)[:, None]], axis=1))
