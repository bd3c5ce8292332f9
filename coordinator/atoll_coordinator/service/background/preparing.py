"""From an uploaded table to regression problems, away from the service's loop."""

import queue
import threading
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from typing import Final

from atoll.config import JobConfig
from atoll_coordinator.data.recording import Preparation
from atoll_coordinator.service.background.process_pool import Children
from atoll_coordinator.service.ports import Ports


def prepare_table(table: bytes, config: JobConfig) -> Preparation:
    """Smooth and differentiate an uploaded table.

    Raises:
        DataError: The measurements cannot be used as they are.
        UsageError: Options contradict each other or name columns that are not there.
        RemoteProtocolError: The bytes are not those of a table.
    """
    from atoll.data.table import Table
    from atoll_coordinator.data.prepare import prepare

    return prepare(Table.from_bytes(table), config)


def make_refining_ready() -> None:
    """Load what refining needs; its kernels are compiled if need be."""
    import scipy.special  # noqa: F401

    import atoll_coordinator.model.pipeline  # noqa: F401
    from atoll_coordinator.model.shooting.warmup import warm_up

    warm_up()


def in_thread(work: Callable[[], None]) -> None:
    """Have `work` done in a thread that keeps no process alive."""
    threading.Thread(target=work, name="preparing", daemon=True).start()


class Writer:
    """One thread, begun when there is first something to do, that keeps no process alive."""

    def __init__(self) -> None:
        self._works: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None

    def __call__(self, work: Callable[[], None]) -> None:
        """Have `work` done after all that came before it."""
        self._works.put(work)
        if self._thread is None:
            self._thread = threading.Thread(target=self._work, name="writing", daemon=True)
            self._thread.start()

    def _work(self) -> None:
        while True:
            self._works.get()()


def iso_now() -> str:
    """Return the time of day, UTC, to the millisecond."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")


REAL: Final = Ports(prepare_table, in_thread, iso_now, warm_up=make_refining_ready, writer=Writer())
"""Everything in this process."""


def with_children(children: Children | None = None) -> Ports:
    """Return the same with child processes, which prepare and refine; new ones unless given."""
    return replace(REAL, errands=children or Children())
