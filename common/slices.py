"""The slices of an epoch, the order in which they count, and where a hit cuts them off. Pure.

A *slice* is what an island computes from one look at its front to the next: `stride` generations, fewer at an epoch's
end. Only at the end of a slice can the target be met. Slices count in the order (epoch, generation, island), in
whatever order they are computed: the search of an archipelago ends with the first slice that met the target, and what
comes after that slice is uncounted. So the end depends on the islands alone, never on who computed them when.
"""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, order=True)
class Position:
    """The end of one slice: `generation` (1-based within the epoch) of one island. Ordered as slices count."""

    epoch: int
    generation: int
    island: int

    def needed(self, island: int, stride: int) -> int:
        """Return up to which generation of this epoch `island` counts if the search ends here; 0: none at all.

        Islands that come before this one, and itself, count up to the same generation; the others to the slice before.
        """
        return self.generation if island <= self.island else slice_start(self.generation, stride)


def slice_start(generation: int, stride: int) -> int:
    """Return the generation at which the slice that holds or ends with `generation` (at least 1) began."""
    return (generation - 1) // stride * stride


def slice_ends(generations: int, stride: int, last: int) -> tuple[int, ...]:
    """Return the ends of all slices that are over after `generations` of an epoch that has `last`."""
    ends = tuple(range(stride, generations + 1, stride))
    return (*ends, last) if generations == last and last % stride else ends
