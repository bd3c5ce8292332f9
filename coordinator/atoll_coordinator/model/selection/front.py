"""Which member of a front is the equation: the one of least description length (Rissanen 1978; ADR 0009).

    n/2 ln(max(MSE, floor^2)) + size ln 8 + k/2 ln n

with n rows, k constants and the floor in the target's units. The choice decides what a user is shown and takes part in
the digest, so it is computed with + - * / alone: the same bits everywhere.
"""

import math
from collections.abc import Sequence
from typing import Final

from atoll.data.dataset import Target
from atoll.expression.operators import CONSTANT
from atoll.expression.program import Program
from atoll.expression.text.infix import PRINTABLE_SIZE, tree_size
from atoll.search.pareto import FrontEntry

SMALLEST_FLOOR: Final = 1e-12
"""Errors below this share of the target's standard deviation are rounding, not merit."""

_LN2: Final = 0.6931471805599453
_LN8: Final = 2.0794415416798357
_SQRT_HALF: Final = 0.7071067811865476
_SMALLEST: Final = 2.2250738585072014e-308


def select(front: Sequence[FrontEntry], rows: int, target: Target, target_error: float | None = None) -> int:
    """Return the index of the member of least description length, the first of equals.

    When members meet the error at which an equation counts as found, only those are considered, so that a search which
    ended because its target was met never shows an equation that misses it.

    Raises:
        ValueError: the front is empty.
    """
    limit = target.convergence_error(target_error)
    met = [index for index, entry in enumerate(front) if entry.error <= limit]
    return min(met or range(len(front)), key=lambda index: (_length(front[index], rows, target), index))


def may_be_shown(program: Program, largest: int | None) -> bool:
    """Tell whether a program is not larger than the user allows (None: any size), and can be printed."""
    return len(program) <= (largest or math.inf) and tree_size(program) <= PRINTABLE_SIZE


def _length(entry: FrontEntry, rows: int, target: Target) -> float:
    return description_length(
        entry, rows, target.uncertainty, target.standard_deviation, count_constants(entry.program)
    )


def description_length(entry: FrontEntry, rows: int, floor: float, deviation: float, constants: int) -> float:
    """Return the description length of one front member in nats, up to a term common to all members.

    Args:
        entry: complexity and mean squared error are read from it.
        rows: n, number of rows on which the error was measured.
        floor: mean uncertainty of the target over its standard deviation.
        deviation: standard deviation of the target, in its units.
        constants: k, number of constants.
    """
    limit = max(floor, SMALLEST_FLOOR) * deviation
    misfit = max(entry.mse, limit * limit, _SMALLEST)
    return 0.5 * rows * _log(misfit) + entry.complexity * _LN8 + 0.5 * constants * _log(float(rows))


def count_constants(program: bytes) -> int:
    """Return the number of constants in the canonical bytes of a program."""
    return program[1 : 1 + program[0]].count(CONSTANT)


def _log(value: float) -> float:
    """Return ln(value), value > 0, by the series of artanh; equal on every machine, unlike the C library's."""
    mantissa, exponent = math.frexp(value)
    if mantissa < _SQRT_HALF:
        mantissa, exponent = 2.0 * mantissa, exponent - 1
    ratio = (mantissa - 1.0) / (mantissa + 1.0)
    square = ratio * ratio
    series = 0.0
    for odd in range(23, 0, -2):
        series = series * square + 1.0 / odd
    return exponent * _LN2 + 2.0 * ratio * series
