"""Shapes that an expression must have: positive, monotone in a variable, or with a limit. Pure.

A shape is read from a short text: ``positive``, ``increasing in S``, ``decreasing in S``, ``S -> 0: 0``, ``S -> inf:
0..2``. `Shapes.are_kept` tests an expression with its constants at measured rows and at points between them
(`shape_points`). The test is numerical: an expression may leave its shape between these points.

Letters: V variables, R points.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from atoll_core.data.dataset import FloatArray
from atoll_core.errors import UsageError
from atoll_core.expression.derivative import derivative
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.program import Program
from atoll_core.quoting import did_you_mean

_MONOTONE: Final = re.compile(r"(?P<way>increasing|decreasing)\s+in\s+(?P<name>\S+)")
_NUMBER: Final = r"[-+]?(?:\d+\.?\d*(?:[eE][-+]?\d+)?|\.\d+(?:[eE][-+]?\d+)?)"
_LIMIT: Final = re.compile(
    rf"(?P<name>\S+)\s*->\s*(?P<at>{_NUMBER}|[-+]?inf)\s*:\s*(?P<low>{_NUMBER})(?:\s*\.\.\s*(?P<high>{_NUMBER}))?"
)
FORMS: Final = "positive, increasing in S, decreasing in S, S -> 0: 0 or S -> inf: 0..2"
_MOST_ROWS: Final = 128
"""Most measured rows at which shapes are tested; there are as many points between them. Set by hand."""
_PRIMES: Final = (1, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31, 37, 41, 43, 47, 53)
_FAR: Final = 1e6
"""A variable that tends to infinity is tested at this multiple of its largest measured value. Set by hand, so that
S/(K + S) differs from its limit by less than the tolerance if K is at most 1,000 times the largest S."""
_TOLERANCE: Final = 1e-3
"""Share of the largest value by which an expression may miss its shape: constants are fitted with errors, and smaller
differences do not matter in predictions. Set by hand."""


@dataclass(frozen=True)
class Limit:
    """The expression is within `low` and `high` where the variable of index `column` is `at` (may be infinite)."""

    column: int
    at: float
    low: float
    high: float


@dataclass(frozen=True)
class Shapes:
    """All shapes of one expression. `monotone` has the index of a variable and the sign (1, -1) of the slope by it."""

    is_positive: bool = False
    monotone: tuple[tuple[int, int], ...] = ()
    limits: tuple[Limit, ...] = ()

    def with_all(self, other: "Shapes") -> "Shapes":
        """Return the shapes of both."""
        return Shapes(
            self.is_positive or other.is_positive, (*self.monotone, *other.monotone), (*self.limits, *other.limits)
        )

    def are_kept(self, program: Program, points: FloatArray) -> bool:
        """Tell whether `program` has these shapes at the points (V, R); points without a finite value do not count."""
        values = values_of(program, points)
        is_finite = np.isfinite(values)
        if not is_finite.any():
            return True
        allowed = _TOLERANCE * float(np.abs(values[is_finite]).max())
        if self.is_positive and float(values[is_finite].min()) < -allowed:
            return False
        return all(self._is_monotone(program, points, *one, allowed) for one in self.monotone) and all(
            self._has_limit(program, points, limit, allowed) for limit in self.limits
        )

    def _is_monotone(self, program: Program, points: FloatArray, column: int, sign: int, allowed: float) -> bool:
        slopes = sign * values_of(derivative(program, column), points)
        slopes = slopes[np.isfinite(slopes)]
        width = max(float(np.ptp(points[column])), 1e-300)
        return not len(slopes) or float(slopes.min()) >= -allowed / width

    def _has_limit(self, program: Program, points: FloatArray, limit: Limit, allowed: float) -> bool:
        moved = points.copy()
        largest = float(np.abs(points[limit.column]).max()) or 1.0
        moved[limit.column] = math.copysign(_FAR * largest, limit.at) if math.isinf(limit.at) else limit.at
        values = values_of(program, moved)
        if not np.isfinite(values).all():
            return False
        return bool(values.min() >= limit.low - allowed and values.max() <= limit.high + allowed)


def shape_points(inputs: FloatArray) -> FloatArray:
    """Return measured rows of `inputs` (V, R), and as many points whose variables come from different rows (V, G).

    So the points fill the box of the measured values, also where no row was measured. No random numbers are drawn.
    """
    rows = inputs.shape[1]
    known = inputs[:, np.arange(min(rows, _MOST_ROWS)) * rows // max(min(rows, _MOST_ROWS), 1)]
    count = known.shape[1]
    places = [(np.arange(count) * _PRIMES[v % len(_PRIMES)] + v) % max(count, 1) for v, _ in enumerate(known)]
    between = np.stack([row[place] for row, place in zip(known, places, strict=True)]) if places else known
    return np.ascontiguousarray(np.concatenate([known, between], axis=1))


def read_shapes(texts: Sequence[str], names: Sequence[str], option: str) -> Shapes:
    """Return the shapes of these texts over the variables `names`.

    Raises:
        UsageError: a text is no shape, or names no variable; the message begins with `option`.
    """
    is_positive, monotone, limits = False, list[tuple[int, int]](), list[Limit]()
    for text in texts:
        if text.strip() == "positive":
            is_positive = True
        elif match := _MONOTONE.fullmatch(text.strip()):
            monotone.append((_column(match["name"], names, option), 1 if match["way"] == "increasing" else -1))
        elif match := _LIMIT.fullmatch(text.strip()):
            low = float(match["low"])
            high = float(match["high"] or match["low"])
            if high < low:
                raise UsageError(f"{option}: {text!r} has the limit {low:g}..{high:g}; write the smaller number first")
            limits.append(Limit(_column(match["name"], names, option), float(match["at"]), low, high))
        else:
            raise UsageError(f"{option} must be of the form {FORMS}, but {text!r} was given")
    return Shapes(is_positive, tuple(monotone), tuple(limits))


def _column(name: str, names: Sequence[str], option: str) -> int:
    if name not in names:
        known = ", ".join(names)
        raise UsageError(f"{option} names {name}, but the variables are {known}{did_you_mean(name, names)}")
    return names.index(name)
