"""An island's runners-up: beside its front the next best of each complexity, distinct in function.

Nothing here measures anything. Which individuals deserve to be measured on all rows follows from what is kept: one that
is worse than all of the complexities it may come to would have no place (`RunnersUp.limits`).
"""

import math
from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

from atoll_core.search.pareto import FrontEntry, runners_up
from atoll_island_worker.evolution.structures import MOST_TERMS

KNOWN = 4096
"""Places for structures that were offered before, a power of two; see `kernels_offers.choose_near`."""

_WRITTEN = 2 * MOST_TERMS + 2
"""Nodes by which a program may grow when its coefficients are worked into it."""


class RunnersUp:
    """At most `most` entries of each complexity beside the front, by complexity and error.

    `known` are the structures that were offered before; empty when no runners-up are kept.
    """

    def __init__(self, most: int) -> None:
        self.most = most
        self.known = np.zeros(KNOWN if most else 0, np.uint64)
        self._worst: dict[int, float] = {}
        self._entries: tuple[FrontEntry, ...] = ()

    @property
    def entries(self) -> tuple[FrontEntry, ...]:
        """The entries that there are."""
        return self._entries

    def replace(self, entries: Iterable[FrontEntry]) -> None:
        """Take over entries that were saved."""
        self._entries = tuple(entries)
        self._note_worst()

    def take(
        self, front: tuple[FrontEntry, ...], candidates: Iterable[FrontEntry], reported: Iterable[FrontEntry]
    ) -> list[FrontEntry]:
        """Keep what belongs beside `front`; return what is new, apart from what has been `reported` already."""
        seen = {entry.key for entry in (*self._entries, *reported)}
        self._entries = runners_up(front, (*self._entries, *candidates), self.most)
        self._note_worst()
        return [entry for entry in self._entries if entry.key not in seen]

    def limits(self, sizes: int) -> npt.NDArray[np.float64]:
        """Return, for programs of each size below `sizes` before their coefficients are written, the useful loss.

        One with a loss above it comes behind `most` others, however large it becomes.
        """
        worst = [self._worst.get(complexity, math.inf) for complexity in range(sizes + _WRITTEN + 1)]
        return np.array([max(worst[size : size + _WRITTEN + 1]) for size in range(sizes)])

    def limit(self, complexity: int) -> float:
        """Return the useful loss of a program of that complexity."""
        return self._worst.get(complexity, math.inf)

    def _note_worst(self) -> None:
        """Note the largest error of each complexity that is full."""
        taken: dict[int, int] = {}
        self._worst = {}
        for entry in self._entries:
            taken[entry.complexity] = taken.get(entry.complexity, 0) + 1
            if taken[entry.complexity] == self.most:
                self._worst[entry.complexity] = entry.error
