"""Which member of a front is the equation: the one of least description length (ADR 0009)."""

import math
from collections.abc import Sequence

from atoll.data.dataset import Target
from atoll.expression.operators import CONSTANT
from atoll.expression.program import Program
from atoll.expression.text.infix import PRINTABLE_SIZE, tree_size
from atoll.search.pareto import FrontEntry
from atoll_coordinator.model.criteria import front_length


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
    return front_length(entry, rows, target.uncertainty, target.standard_deviation, count_constants(entry.program))


def count_constants(program: bytes) -> int:
    """Return the number of constants in the canonical bytes of a program."""
    return program[1 : 1 + program[0]].count(CONSTANT)
