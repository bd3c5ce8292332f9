"""The slices of an epoch, the order in which they count, and where a hit cuts them off. Pure.

A *slice* is what an island computes from one look at its front to the next: `stride` generations, fewer at an epoch's
end. Only at the end of a slice can the target be met. Slices count in an order of their own, in whatever order they are
computed: the search of an archipelago ends with the first slice that met the target, and what comes after that slice is
uncounted. So the end depends on the islands alone, never on who computed them when.

The order is (epoch, generation, island), but for epoch 0: there the islands begin in groups, and a group counts after
all of the one before it. What the first islands find early, the others need not even begin to look for.
"""

from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from atoll_core.config import Frozen

Positive = Annotated[int, Field(ge=1)]


@dataclass(frozen=True, slots=True)
class Position:
    """The end of one slice: `generation` (1-based within the epoch) of one island."""

    epoch: int
    generation: int
    island: int


class CommitOrder(Frozen):
    """How the slices of an archipelago follow each other.

    An epoch has `generations`, a slice `stride` of them; in epoch 0 islands begin in groups of `joining`.
    """

    generations: Positive
    stride: Positive
    joining: Positive

    def rank(self, at: Position) -> tuple[int, int, int, int]:
        """Return by what slices are ordered: the smaller counts first."""
        return (at.epoch, self._group(at.epoch, at.island), at.generation, at.island)

    def needed(self, hit: Position, island: int) -> int:
        """Return up to which generation of the epoch of `hit` an island counts when the search ends there; 0: not."""
        group, hits = self._group(hit.epoch, island), self._group(hit.epoch, hit.island)
        if group != hits:
            return self.generations if group < hits else 0
        return hit.generation if island <= hit.island else (hit.generation - 1) // self.stride * self.stride

    def ends(self, generations: int) -> tuple[int, ...]:
        """Return the ends of all slices of an epoch that are over after `generations` of it."""
        ends = tuple(range(self.stride, generations + 1, self.stride))
        is_cut_short = generations == self.generations and generations % self.stride > 0
        return (*ends, generations) if is_cut_short else ends

    def _group(self, epoch: int, island: int) -> int:
        return island // self.joining if epoch == 0 else 0
