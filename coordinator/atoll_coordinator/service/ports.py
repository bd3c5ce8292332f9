"""What the service needs from outside itself, beside the bus: a store, a place for slow work, the time of day."""

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from atoll.config import JobConfig
from atoll.wire.messages.views import StoreView
from atoll.wire.state_transfer import State
from atoll_coordinator.data.recording import Preparation
from atoll_coordinator.model.inference.refinement import Pools, Refinement
from atoll_coordinator.service.background.interface import HERE, Errands
from atoll_coordinator.service.store.deaths import Death
from atoll_coordinator.service.store.events import EventRecord
from atoll_coordinator.service.store.jobs import JobRecord


class StorePort(Protocol):
    """The part of `atoll_coordinator.service.store.store.Store` that the service uses; it describes its promises."""

    @property
    def realm(self) -> str:
        """Random name of the store."""

    @property
    def incarnation(self) -> int:
        """How often the store has been opened."""

    def add_job(self, job: JobRecord, submitter: str | None = None) -> bool: ...

    def job(self, job: str) -> JobRecord | None: ...

    def jobs(self) -> tuple[JobRecord, ...]: ...

    def update_job(self, job: str, only_in: Collection[str] | None = None, **changes: str | float | None) -> bool: ...

    def commit_result(
        self, job: str, state: str, result: str | None, reason: str | None = None, finished: str | None = None,
        *, keeps_checkpoints: bool = False,
    ) -> bool: ...  # fmt: skip

    def add_deaths(self, deaths: Sequence[Death]) -> None: ...

    def deaths(self, job: str) -> tuple[Death, ...]: ...

    def take_back_deaths(self, worker: str, instance: str) -> None: ...

    def result(self, job: str) -> str | None: ...

    def submitter(self, job: str) -> str | None: ...

    def begin_terms(self, archipelagos: Sequence[tuple[str, str]], place: Callable[[int, int], bytes]) -> None: ...

    def commit_cuts(self, job: str, cuts: Mapping[str, bytes]) -> bool: ...

    def cuts(self, job: str) -> dict[str, bytes]: ...

    def add_events(self, events: Iterable[EventRecord]) -> None: ...

    def events(self, job: str | None, after: int, limit: int) -> tuple[EventRecord, ...]: ...

    def commit_checkpoint(
        self, job: str, variable: str, epoch: int, progress: bytes, states: Mapping[int, State], elapsed: float
    ) -> bool: ...

    def checkpoints(self, job: str) -> dict[str, tuple[int, bytes]]: ...

    def state(self, job: str, variable: str, epoch: int, island: int) -> State: ...

    def check(self) -> None: ...

    def timing(self) -> StoreView: ...

    def put_blob(self, data: bytes) -> str: ...

    def has_blob(self, digest: str) -> bool: ...

    def get_blob(self, digest: str) -> bytes: ...

    def get_chunk(self, digest: str, index: int) -> bytes: ...

    def missing_chunks(self, digest: str, size: int) -> tuple[int, ...]: ...

    def put_chunk(self, digest: str, size: int, index: int, data: bytes) -> bool: ...

    def blob_bytes(self) -> int: ...


Preparer = Callable[[bytes, JobConfig], Preparation]
"""Turns an uploaded table into regression problems and a recording; raises DataError or UsageError with a sentence for
the user."""

Refiner = Callable[[Preparation, JobConfig, Pools], Refinement]
"""Makes the equations that are shown from the search's pools; see `atoll_coordinator.model.pipeline.refine_all`."""

WarmUp = Callable[[], None]
"""Makes ready what refining needs, while a job is searched."""

Background = Callable[[Callable[[], None]], None]
"""Has a piece of work done elsewhere than on the caller's thread, and returns at once."""


def refine(preparation: Preparation, config: JobConfig, pools: Pools) -> Refinement:
    """See `atoll_coordinator.model.pipeline.refine_all`, whose kernels are loaded no sooner."""
    from atoll_coordinator.model.pipeline import refine_all

    return refine_all(preparation, config, pools)


def _nothing() -> None:
    """Have nothing to make ready."""


def at_once(work: Callable[[], None]) -> None:
    """Do a piece of work on the caller's thread."""
    work()


@dataclass(frozen=True, slots=True)
class Ports:
    """The outside world of a service. `clock` gives the time of day as ISO text.

    `errands` does what `preparer`, `refiner` and `warm_up` say, for threads of `background`. `writer` does what it is
    given in the order in which it came, one piece at a time.
    """

    preparer: Preparer
    background: Background
    clock: Callable[[], str]
    refiner: Refiner = refine
    warm_up: WarmUp = _nothing
    writer: Background = at_once
    errands: Errands = HERE
