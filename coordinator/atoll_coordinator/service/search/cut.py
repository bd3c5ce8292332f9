"""A cut: where the search of one equation ended and what it had found there. Durable once it is committed."""

from collections.abc import Mapping
from typing import Annotated

from pydantic import Field

from atoll_coordinator.model.pools import Pool
from atoll_coordinator.service.search.ending import Why
from atoll_core.config import Frozen
from atoll_core.search.pareto import FrontEntry


class CutEntry(Frozen):
    """A `atoll_core.search.pareto.FrontEntry` as it is stored."""

    complexity: int
    error: float
    mse: float
    epoch: int
    generation: int
    island: int
    program: bytes


class Improvement(Frozen):
    """A `generation`, counted from the start of the search, in which an island found a lower `error` than before."""

    generation: int
    error: float


class Convergence(Frozen):
    """The improvements of one island, by rising generation and falling error."""

    island: int
    improvements: tuple[Improvement, ...]

    @classmethod
    def of(cls, improvements: Mapping[int, tuple[Improvement, ...]]) -> "tuple[Convergence, ...]":
        """Return those of several islands, by their numbers."""
        return tuple(cls(island=island, improvements=improvements[island]) for island in sorted(improvements))


class Cut(Frozen):
    """The end of one archipelago.

    `epochs` are counted, so the last one is `epochs` - 1; `generation`, counted from the start of the search, is the
    one that met the target (None: it was not met, and the last epoch counts to its end); `evaluations` are point
    evaluations by part of all islands up to the cut; `seconds` run from the first epoch's start to the end of the last
    slice that counts; `runners_up` are what was kept beside the front (`atoll_core.search.pareto.runners_up`);
    `convergence` is that of each island.
    """

    variable: str
    epochs: Annotated[int, Field(ge=0)]
    generation: Annotated[int, Field(ge=0)] | None
    why: Why
    front: tuple[CutEntry, ...]
    evaluations: dict[str, int]
    seconds: float
    runners_up: tuple[CutEntry, ...] = ()
    convergence: tuple[Convergence, ...] = ()

    def entries(self) -> tuple[FrontEntry, ...]:
        """Return the front."""
        return entries(self.front)

    def pool(self) -> Pool:
        """Return the front and the runners-up."""
        return Pool(entries(self.front), entries(self.runners_up))


def entries(stored: tuple[CutEntry, ...]) -> tuple[FrontEntry, ...]:
    """Return front members that were stored."""
    return tuple(FrontEntry(**entry.model_dump()) for entry in stored)


def stored(entry: FrontEntry) -> CutEntry:
    """Return a front member as it is stored."""
    return CutEntry(
        complexity=entry.complexity,
        error=entry.error,
        mse=entry.mse,
        epoch=entry.epoch,
        generation=entry.generation,
        island=entry.island,
        program=entry.program,
    )
