"""Checkpoints as the coordinator sees them: what is stored of one, and its states on their way here. Pure."""

import math
from typing import Annotated, Final

from pydantic import Field

from atoll_coordinator.service.search.collector import SearchState
from atoll_coordinator.service.search.cut import Convergence, CutEntry, entries, stored
from atoll_core import ENGINE_REVISION
from atoll_core.config import Frozen
from atoll_core.wire.messages.epochs import PullStates, States
from atoll_core.wire.messages.workers import Placement
from atoll_core.wire.state_pieces import Assembly, IslandState


class Counted(Frozen):
    """Cumulative point evaluations of one island by part."""

    island: int
    evaluations: dict[str, int]


class StoredSearchState(Frozen):
    """A `SearchState` as it is stored beside the states of the islands.

    `search_seconds` is how long the job had been searched by then. `engine` is the revision under which it came about;
    under another one the states mean something else.
    """

    engine: int
    epochs: Annotated[int, Field(ge=0)]
    front: tuple[CutEntry, ...]
    runners_up: tuple[CutEntry, ...]
    counted: tuple[Counted, ...]
    evaluations: dict[str, int]
    best_length: float | None
    improved_at: int
    seconds: float
    search_seconds: float
    convergence: tuple[Convergence, ...] = ()

    @classmethod
    def of(cls, state: SearchState, search_seconds: float) -> "StoredSearchState":
        """Return what is stored of a search state."""
        return cls(
            engine=ENGINE_REVISION,
            epochs=state.epochs,
            front=tuple(stored(entry) for entry in state.front),
            runners_up=tuple(stored(entry) for entry in state.runners_up),
            counted=tuple(Counted(island=k, evaluations=evaluations) for k, evaluations in state.counted.items()),
            evaluations=state.evaluations,
            best_length=state.best_length if math.isfinite(state.best_length) else None,
            improved_at=state.improved_at,
            seconds=state.seconds,
            search_seconds=search_seconds,
            convergence=Convergence.of(state.convergence),
        )

    def search_state(self) -> SearchState:
        """Return it as the collector goes on from it."""
        return SearchState(
            epochs=self.epochs,
            front=entries(self.front),
            runners_up=entries(self.runners_up),
            evaluations=dict(self.evaluations),
            counted={counted.island: dict(counted.evaluations) for counted in self.counted},
            convergence={convergence.island: convergence.improvements for convergence in self.convergence},
            best_length=self.best_length if self.best_length is not None else math.inf,
            improved_at=self.improved_at,
            seconds=self.seconds,
        )


class Gathering:
    """The states of one checkpoint on their way from the workers, one question to each at a time."""

    def __init__(self, placement: Placement, epoch: int) -> None:
        self.epoch: Final = epoch
        self._placement = placement
        self._assemblies = {name: Assembly(placement.islands_of(name)) for name in dict.fromkeys(placement.workers)}
        self._asked: set[str] = set()

    @property
    def is_complete(self) -> bool:
        """Whether the states of all islands are here."""
        return all(assembly.is_complete for assembly in self._assemblies.values())

    @property
    def size(self) -> int:
        """Bytes that are here."""
        return sum(assembly.size for assembly in self._assemblies.values())

    @property
    def states(self) -> dict[int, IslandState]:
        """The states that are here, by island."""
        return {island: state for assembly in self._assemblies.values() for island, state in assembly.states.items()}

    def next_pulls(self, most: int) -> list[tuple[str, PullStates]]:
        """Return at most so many pulls, each with its worker; they count as under way."""
        waiting = [
            name for name, assembly in self._assemblies.items() if name not in self._asked and not assembly.is_complete
        ]
        pulls = [(name, self._pull(self._assemblies[name])) for name in waiting[: max(0, most)]]
        self._asked.update(name for name, _ in pulls)
        return pulls

    def add(self, worker: str, body: States | None) -> None:
        """Take in a worker's answer; None: there was none, and it is asked again.

        Raises:
            RemoteProtocolError: A state was damaged on its way, and is asked for again.
        """
        self._asked.discard(worker)
        if body is not None and worker in self._assemblies:
            self._assemblies[worker].take(body.pieces)

    def _pull(self, assembly: Assembly) -> PullStates:
        placed = self._placement
        return PullStates(
            job=placed.job,
            variable=placed.variable,
            term=placed.term,
            epoch=self.epoch,
            islands=assembly.wanted,
            offset=assembly.offset,
        )
