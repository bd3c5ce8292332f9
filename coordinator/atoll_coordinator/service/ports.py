"""What the service needs from outside itself, beside the bus: a store, a pool of processes, the time of day."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Protocol

from atoll.wire.messages.views import StoreView
from atoll.wire.state_transfer import State
from atoll_coordinator.service.background.process_pool import ProcessPool, T
from atoll_coordinator.service.background.tasks import Preparer, Refiner, prepare_table, refine
from atoll_coordinator.service.store.deaths import Death
from atoll_coordinator.service.store.events import EventRecord
from atoll_coordinator.service.store.jobs import JobRecord
from atoll_coordinator.service.store.retention import KEEP_ALL, Retention


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

    def update_job(self, job: str, **changes: str | float | None) -> None: ...

    def commit_result(
        self, job: str, state: str, result: str | None, reason: str | None = None, finished: str | None = None,
        *, keeps_checkpoints: bool = False,
    ) -> bool: ...  # fmt: skip

    def add_deaths(self, deaths: Sequence[Death]) -> None: ...

    def deaths(self, job: str) -> tuple[Death, ...]: ...

    def take_back_deaths(self, worker: str, instance: str) -> None: ...

    def result(self, job: str) -> str | None: ...

    def submitter(self, job: str) -> str | None: ...

    def oldest_ended_job(self) -> JobRecord | None: ...

    def delete_job(self, job: str) -> None: ...

    def used_bytes(self) -> int: ...

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

    def delete_unused_blobs(self, but: str) -> None: ...


class TaskPool(Protocol):
    """The part of `atoll_coordinator.service.background.process_pool.ProcessPool` that the service uses."""

    def submit(
        self, job: str, function: Callable[[], T], on_result: Callable[[T], None], on_failure: Callable[[str], None],
        *, is_queued: bool = False,
    ) -> None: ...  # fmt: skip

    def preload(self, function: Callable[[], None]) -> None: ...

    def cancel(self, job: str) -> None: ...

    def close(self) -> None: ...


def iso_now() -> str:
    """Return the time of day, UTC, to the millisecond."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")


@dataclass(frozen=True, slots=True)
class Ports:
    """The outside world of a service, beside its bus and its store.

    `pool` runs tasks, `writer` does what it is given in the order in which it came, one piece at a time, and `clock`
    gives the time of day as ISO text; `retention` says which ended jobs are kept. Tests replace `preparer` and
    `refiner` as well.
    """

    pool: TaskPool = field(default_factory=ProcessPool)
    clock: Callable[[], str] = iso_now
    preparer: Preparer = prepare_table
    refiner: Refiner = refine
    retention: Retention = KEEP_ALL
    writer: Callable[[Callable[[], None]], object] = field(
        default_factory=lambda: ThreadPoolExecutor(1, "writing checkpoints").submit
    )
