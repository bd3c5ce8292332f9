"""The end of the search for one equation: its conditions, and the cut, which is the state of the search at its end.

A search ends when it meets its target error, when regression has found a law, after too many epochs without
improvement, after its last allowed epoch, by `--max-time` or by cancellation. The cut is committed to the store.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field

from atoll_coordinator.model.pools import Pool
from atoll_core.config import Frozen
from atoll_core.search.commit_order import CommitOrder, Position
from atoll_core.search.pareto import FrontEntry

Why = Literal["target", "law", "stagnation", "max-epochs", "max-time", "cancelled"]


@dataclass(frozen=True, slots=True)
class Stagnation:
    """Number of `epochs` without improvement after which a search ends.

    If it `grows`, the number is at least as large as the number of epochs until the last improvement: a search that
    improves slowly gets more time.
    """

    epochs: int
    grows: bool = False

    def is_due(self, epoch: int, improved_at: int) -> bool:
        """Return whether a search ends after `epoch` if it last improved in epoch `improved_at`; both count from 0."""
        return epoch - improved_at >= (max(self.epochs, improved_at + 1) if self.grows else self.epochs)


@dataclass(frozen=True, slots=True)
class SearchLimits:
    """Limits of the search of one archipelago; `runners_up` is the number of runners-up kept for each complexity.

    `has_law`: regression has found a law, so one epoch, for comparison, is enough.
    """

    islands: int
    epochs: int
    stagnation: Stagnation
    commit_order: CommitOrder
    runners_up: int = 0
    has_law: bool = False


def end_of(limits: SearchLimits, epoch: int, improved_at: int, hit: Position | None, ordered: Why | None) -> Why | None:
    """Return why a search ends with `epoch`, which all islands have reported; None: the search continues.

    The front last improved in epoch `improved_at`. `hit` is where the target was met (None: not yet). `ordered` is an
    end by `--max-time` that had to wait for the first complete epoch.
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


class Improvement(Frozen):
    """A `generation`, counted from the start of the search, in which an island found a lower `error` than before."""

    generation: int
    error: float


class IslandConvergence(Frozen):
    """The improvements of one island, ordered by rising generation; their errors fall."""

    island: int
    improvements: tuple[Improvement, ...]

    @classmethod
    def of(cls, improvements: Mapping[int, tuple[Improvement, ...]]) -> "tuple[IslandConvergence, ...]":
        """Return the convergence of several islands, ordered by island."""
        return tuple(cls(island=island, improvements=improvements[island]) for island in sorted(improvements))


class Cut(Frozen):
    """The end of one archipelago, as it is stored.

    `epochs` is the number of epochs, so the last epoch is `epochs` - 1. `generation`, counted from the start of the
    search, is the generation that met the target (None: the target was not met, and the whole last epoch counts).
    `evaluations` are the point evaluations of all islands, by part. `seconds` is the time from the start of the first
    epoch to the end of the last slice that counts. `runners_up` are the next best entries, which are not in the front
    (`atoll_core.search.pareto.runners_up`).
    """

    variable: str
    epochs: Annotated[int, Field(ge=0)]
    generation: Annotated[int, Field(ge=0)] | None
    why: Why
    front: tuple[FrontEntry, ...]
    evaluations: dict[str, int]
    seconds: float
    runners_up: tuple[FrontEntry, ...] = ()
    convergence: tuple[IslandConvergence, ...] = ()

    @property
    def pool(self) -> Pool:
        """The front and the runners-up."""
        return Pool(self.front, self.runners_up)
