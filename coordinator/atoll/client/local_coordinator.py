"""A service on this machine: the processes of a local run, and its coordinator in a thread of this one."""

import contextlib
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Final, Self

from atoll.client.local_workers import LocalWorkers
from atoll_core.errors import AtollError, UnreachableError
from atoll_core.wire.addresses import own_address

_STOP_LIMIT_S: Final = 5.0
_OPEN_LIMIT_S: Final = 20.0


@contextlib.contextmanager
def local_processes(number: int, log: Path) -> Iterator[tuple[str, LocalWorkers]]:
    """Start what is to load first: workers, which dial the address that is yielded."""
    with own_address() as address, LocalWorkers(str(address), number, log) as workers:
        yield str(address), workers


class LocalCoordinator:
    """Router and service in a thread of their own, the store in memory; a context manager."""

    def __init__(self, endpoint: str, workers: int) -> None:
        """`workers` is how many are expected to join."""
        self._endpoint = endpoint
        self._workers = workers
        self._stop = threading.Event()
        self._listening = threading.Event()
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="coordinator", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join(_STOP_LIMIT_S)

    def wait(self) -> None:
        """Wait until the router listens; raises what kept it from doing so."""
        if not self._listening.wait(_OPEN_LIMIT_S):
            raise UnreachableError(f"the router did not listen on {self._endpoint} within {_OPEN_LIMIT_S:.0f} s")
        self.check()

    def check(self) -> None:
        """Raise what has ended the coordinator, if it has ended."""
        if self._error is not None:
            raise self._error
        if not self._thread.is_alive():
            raise AtollError("the coordinator ended by itself, which it never should")

    def _run(self) -> None:
        try:
            from atoll_coordinator.service.service_loop import Service
            from atoll_coordinator.service.store.store import Store
            from atoll_core.wire.bus.zenoh_bus import open_router

            with Store.open(None) as store, open_router(self._endpoint) as bus:
                service = Service(bus, store, expected_workers=self._workers, dismisses_workers=True)
                self._listening.set()
                service.run(self._stop)
        except BaseException as error:  # handed to the main thread, which raises it
            self._error = error
        finally:
            self._listening.set()
