"""What ends the search of one equation: its target, a law, epochs without improvement, their number, or an order.

The end itself, and what had been found there, is a `cut`.
"""

from dataclasses import dataclass
from typing import Literal

from atoll_core.search.commit_order import CommitOrder, Position

Why = Literal["target", "law", "stagnation", "max-epochs", "max-time", "cancelled"]


@dataclass(frozen=True, slots=True)
class Stagnation:
    """After how many epochs without improvement a search ends.

    These are `epochs`; if it `grows`, as many as had gone by with the last improvement, where that is more: what takes
    the longer to get better is waited for the longer.
    """

    epochs: int
    grows: bool = False

    def is_due(self, epoch: int, improved_at: int) -> bool:
        """Tell whether a search ends with `epoch` that has last improved in the epoch `improved_at`, both from 0."""
        return epoch - improved_at >= (max(self.epochs, improved_at + 1) if self.grows else self.epochs)


@dataclass(frozen=True, slots=True)
class Limits:
    """When an archipelago ends by itself: epochs at most, epochs without improvement; and what counts at a hit.

    `runners_up` are kept of each complexity. `has_law` ends it after the first epoch, which is for comparison.
    """

    islands: int
    epochs: int
    stagnation: Stagnation
    commit_order: CommitOrder
    runners_up: int = 0
    has_law: bool = False


def end_of(limits: Limits, epoch: int, improved_at: int, hit: Position | None, ordered: Why | None) -> Why | None:
    """Return why a search ends with `epoch`, which all islands have reported; None if it goes on.

    The front last improved in the epoch `improved_at`, and the target was met at `hit`, if at all. `ordered` is an end
    from outside, by time, that waited for a first epoch.
    """
    if hit is not None:
        return "target"
    if limits.has_law:
        return "law"
    if limits.stagnation.is_due(epoch, improved_at):
        return "stagnation"
    if epoch + 1 >= limits.epochs:
        return "max-epochs"
    return ordered
