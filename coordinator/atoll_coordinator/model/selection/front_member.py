"""Which member of a front is shown while the search runs: the member with the shortest description length.

The same length decides whether the search stagnates. Refining chooses again: `model_selection`, `regression.equation`.
"""

from collections.abc import Sequence
from typing import Final

from atoll_coordinator.model.description_length import SMALLEST_UNCERTAINTY, log
from atoll_coordinator.settings import SETTINGS
from atoll_core.data.dataset import Target
from atoll_core.expression.operators import CONSTANT
from atoll_core.search.pareto import FrontEntry

_SMALLEST: Final = 2.2250738585072014e-308


def front_length(
    entry: FrontEntry, rows: float, uncertainty: float, standard_deviation: float, constants: int
) -> float:
    """Return the description length of a front member in nats, up to a term common to all members (ADR 0009).

        n/2 ln(max(MSE, u^2)) + nodes ln 8 + k/2 ln n

    with the uncertainty u in the target's unit; a constant costs as in Schwarz (1978). The length decides which
    equation is shown and is part of the digest. So it is computed with + - * / alone, which give the same bits on every
    machine.

    Args:
        entry: the member, with its complexity and mean squared error.
        rows: n, number of rows on which the error was measured, or number of rows with independent errors.
        uncertainty: mean uncertainty of the target, divided by the standard deviation of the target.
        standard_deviation: standard deviation of the target, in its unit.
        constants: k.
    """
    limit = max(uncertainty, SMALLEST_UNCERTAINTY) * standard_deviation
    misfit = max(entry.mse, limit * limit, _SMALLEST)
    return 0.5 * rows * log(misfit) + entry.complexity * SETTINGS.criterion.node + 0.5 * constants * log(float(rows))


def select_shortest_description(
    front: Sequence[FrontEntry], rows: int, target: Target, target_error: float | None = None
) -> int:
    """Return the index of the member with the least description length; if several lengths are equal, the first of
    them.

    If some members reach the error at which an equation counts as found, only these members are considered. So if a
    search ended because it reached its target error, the shown equation also has at most this error.

    Raises:
        ValueError: the front is empty.
    """
    limit = target.convergence_error(target_error)
    met = [index for index, entry in enumerate(front) if entry.error <= limit]
    return min(met or range(len(front)), key=lambda index: (_member_length(front[index], rows, target), index))


def _member_length(entry: FrontEntry, rows: int, target: Target) -> float:
    return front_length(entry, rows, target.uncertainty, target.standard_deviation, count_constants(entry.program))


def count_constants(program: bytes) -> int:
    """Return the number of constants in the canonical bytes of a program."""
    return program[1 : 1 + program[0]].count(CONSTANT)
