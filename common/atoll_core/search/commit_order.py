"""The slices of an epoch, the order in which they count, and the end of a search after a hit. Pure.

A *slice* is `stride` generations of an island between two updates of its front, fewer at an epoch's end. An island can
reach the target only at the end of a slice. The search of an archipelago ends with the first slice in the commit order
that reached the target; later slices do not count. The commit order does not depend on the order of computing. So the
end of a search depends only on its islands, and not on the workers or the time of computing.

The commit order is (epoch, generation, island), except in epoch 0: there the islands begin in groups, and all slices of
a group count after all slices of the group before it. If the first islands reach the target early, the others need not
be computed.
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
    """The order of the slices of an archipelago.

    An epoch has `generations` generations, and a slice `stride`; in epoch 0 islands begin in groups of `joining`.
    """

    generations: Positive
    stride: Positive
    joining: Positive

    def rank(self, at: Position) -> tuple[int, int, int, int]:
        """Return the sort key of slices: the smaller one counts first."""
        return (at.epoch, self._group(at.epoch, at.island), at.generation, at.island)

    def needed(self, hit: Position, island: int) -> int:
        """Return the last generation of an island that counts in the epoch of the final `hit`; 0: none."""
        group, hits = self._group(hit.epoch, island), self._group(hit.epoch, hit.island)
        if group != hits:
            return self.generations if group < hits else 0
        return hit.generation if island <= hit.island else (hit.generation - 1) // self.stride * self.stride

    def ends(self, generations: int) -> tuple[int, ...]:
        """Return the ends of all slices of an epoch that end within its first `generations`."""
        ends = tuple(range(self.stride, generations + 1, self.stride))
        is_cut_short = generations == self.generations and generations % self.stride > 0
        return (*ends, generations) if is_cut_short else ends

    def _group(self, epoch: int, island: int) -> int:
        return island // self.joining if epoch == 0 else 0
