"""What the service needs from outside itself, beside bus and store: a pool of processes, a writer, the time of day."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Protocol

from atoll_coordinator.service.background.job_tasks import Preparer, Refiner, prepare_table, refine
from atoll_coordinator.service.background.process_pool import ProcessPool, T
from atoll_coordinator.service.store.retention import KEEP_ALL, Retention


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
class Dependencies:
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
