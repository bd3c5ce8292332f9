"""Checkpoints of an archipelago: at which epochs they are taken, how states are gathered, their stored form. Pure."""

import math
from collections.abc import Iterable
from typing import Annotated, Final

from pydantic import Field

from atoll_coordinator.service.search.collector import SearchState
from atoll_coordinator.service.search.ending import IslandConvergence
from atoll_core import ENGINE_REVISION
from atoll_core.config import Frozen
from atoll_core.search.pareto import FrontEntry
from atoll_core.wire.messages.epochs import PullStates, States
from atoll_core.wire.messages.workers import Placement, Schedule
from atoll_core.wire.state_pieces import Assembly, IslandState

FIRST_INTERVAL: Final = 8
"""Epochs before the first checkpoint, when no time has been measured yet; a short search ends earlier."""

LEAST_INTERVAL: Final = 4
MOST_INTERVAL: Final = 1 << 16
MOST_GROWTH: Final = 8
"""An interval is at most this multiple of the previous one: measurements of a few epochs are uncertain."""

PAUSE_S: Final = 1.0
"""Intended seconds between two checkpoints; about this time is computed again when a worker is lost."""

SHARE: Final = 0.03
"""Share of all work that checkpoints may cost."""

COST_S: Final = 0.01
COST_S_PER_BYTE: Final = 5e-8
"""Seconds of work for one checkpoint, in all processes: to take, copy, hash twice, send and write the states."""


def interval_of(epoch_s: float, size: int, former: int) -> int:
    """Return the number of epochs until the next checkpoint.

    Args:
        epoch_s: Seconds that an epoch of the archipelago takes.
        size: Bytes of all states of the archipelago.
        former: The previous interval.
    """
    pause_s = max(PAUSE_S, (COST_S + COST_S_PER_BYTE * size) / SHARE)
    most = min(MOST_INTERVAL, MOST_GROWTH * former)
    return max(LEAST_INTERVAL, min(most, round(pause_s / epoch_s) if epoch_s > 0.0 else most))


def schedule_after(schedule: Schedule, epoch: int, interval: int, wants_barrier: bool) -> Schedule:
    """Return the schedule that follows when the checkpoint of `epoch` is durable.

    The checkpoint that workers already know does not change. The new checkpoint is `interval` epochs after it, or, for
    a barrier, one epoch after it: no island can have passed a checkpoint that no worker knows.
    """
    if schedule.holds:
        return Schedule(next=schedule.last, last=schedule.last, holds=True)
    is_known = epoch < schedule.last
    if wants_barrier:
        return Schedule(next=schedule.last if is_known else schedule.last + 1, last=schedule.last + 1, holds=True)
    following = schedule.last if is_known else schedule.last + interval
    return Schedule(next=following, last=following + interval)


def common_epoch(snapshots: Iterable[Iterable[int]], beyond: int) -> int | None:
    """Return the latest epoch after `beyond` for which every worker has snapshots; None: no such epoch."""
    sets = [set(epochs) for epochs in snapshots]
    shared = set.intersection(*sets) if sets else set()
    return max((epoch for epoch in shared if epoch > beyond), default=None)


class Counted(Frozen):
    """Cumulative point evaluations of one island, by part of the search."""

    island: int
    evaluations: dict[str, int]


class StoredSearchState(Frozen):
    """A `SearchState` as it is stored together with the states of the islands.

    `search_seconds` is the duration of the job's search so far. `engine` is the engine revision; states of another
    revision cannot be continued.
    """

    engine: int
    epochs: Annotated[int, Field(ge=0)]
    front: tuple[FrontEntry, ...]
    runners_up: tuple[FrontEntry, ...]
    counted: tuple[Counted, ...]
    evaluations: dict[str, int]
    best_length: float | None
    improved_at: int
    seconds: float
    search_seconds: float
    convergence: tuple[IslandConvergence, ...] = ()

    @classmethod
    def of(cls, state: SearchState, search_seconds: float) -> "StoredSearchState":
        """Return the stored form of a search state."""
        return cls(
            engine=ENGINE_REVISION,
            epochs=state.epochs,
            front=state.front,
            runners_up=state.runners_up,
            counted=tuple(Counted(island=k, evaluations=evaluations) for k, evaluations in state.counted.items()),
            evaluations=state.evaluations,
            best_length=state.best_length if math.isfinite(state.best_length) else None,
            improved_at=state.improved_at,
            seconds=state.seconds,
            search_seconds=search_seconds,
            convergence=IslandConvergence.of(state.convergence),
        )

    def search_state(self) -> SearchState:
        """Return the state from which the collector continues."""
        return SearchState(
            epochs=self.epochs,
            front=self.front,
            runners_up=self.runners_up,
            evaluations=dict(self.evaluations),
            counted={counted.island: dict(counted.evaluations) for counted in self.counted},
            convergence={convergence.island: convergence.improvements for convergence in self.convergence},
            best_length=self.best_length if self.best_length is not None else math.inf,
            improved_at=self.improved_at,
            seconds=self.seconds,
        )


class Gathering:
    """Gathers the states of one checkpoint from the workers, with one pull per worker at a time."""

    def __init__(self, placement: Placement, epoch: int) -> None:
        self.epoch: Final = epoch
        self._placement = placement
        self._assemblies = {name: Assembly(placement.islands_of(name)) for name in dict.fromkeys(placement.workers)}
        self._asked: set[str] = set()

    @property
    def is_complete(self) -> bool:
        """Whether the states of all islands have arrived."""
        return all(assembly.is_complete for assembly in self._assemblies.values())

    @property
    def size(self) -> int:
        """Bytes that have arrived."""
        return sum(assembly.size for assembly in self._assemblies.values())

    @property
    def states(self) -> dict[int, IslandState]:
        """The states that have arrived, by island."""
        return {island: state for assembly in self._assemblies.values() for island, state in assembly.states.items()}

    @property
    def unasked(self) -> list[str]:
        """The workers from which states are missing and are not being pulled."""
        return [
            name for name, assembly in self._assemblies.items() if name not in self._asked and not assembly.is_complete
        ]

    def next_pulls(self, most: int) -> list[tuple[str, PullStates]]:
        """Return at most `most` pulls, each with its worker; they count as sent."""
        waiting = self.unasked[: max(0, most)]
        self._asked.update(waiting)
        placed = self._placement
        return [
            (
                name,
                PullStates(
                    job=placed.job, variable=placed.variable, term=placed.term, epoch=self.epoch,
                    islands=self._assemblies[name].wanted, offset=self._assemblies[name].offset,
                ),
            )
            for name in waiting
        ]  # fmt: skip

    def add(self, worker: str, body: States | None) -> None:
        """Add a worker's answer (None: there was no answer); missing states are pulled again.

        Raises:
            RemoteProtocolError: A state was damaged in transit; it is pulled again.
        """
        self._asked.discard(worker)
        if body is not None and worker in self._assemblies:
            self._assemblies[worker].take(body.pieces)
