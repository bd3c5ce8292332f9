"""Fronts of error against complexity: the total order, dominance and merging (PROTOCOL rule 6)."""

import math
from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class FrontEntry:
    """One equation as it was measured on all rows, tagged with where and when it was found.

    `error` is the loss and `mse` the mean squared error, both in the target's units; `program` holds the canonical
    bytes of `common.expression.program.Program`.
    """

    complexity: int
    error: float
    mse: float
    epoch: int
    generation: int
    island: int
    program: bytes

    @property
    def key(self) -> tuple[int, float, int, int, int, bytes]:
        """The total order in which entries are compared and kept."""
        return (self.complexity, self.error, self.epoch, self.generation, self.island, self.program)


def merge(front: Iterable[FrontEntry], additions: Iterable[FrontEntry]) -> tuple[FrontEntry, ...]:
    """Return the non-dominated entries of both, by rising complexity and falling error. Pure; order-independent."""
    kept: list[FrontEntry] = []
    for entry in sorted((*front, *additions), key=lambda each: each.key):
        if math.isfinite(entry.error) and (not kept or entry.error < kept[-1].error):
            kept.append(entry)
    return tuple(kept)
