"""Everything that ``run`` starts on this machine: router and coordinator in a thread, workers as processes.

Workers start before the router listens, and connect as soon as it does; their log is one file. Several of them are
forked by one process that has loaded everything once, where the system allows it (see `adoption`). Whatever happens,
the workers end: they are told to, then killed; and they watch this process themselves, should it be killed.
"""

import contextlib
import os
import subprocess
import sys
import threading
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import IO, Final, Self

from atoll.errors import AtollError, UnreachableError
from atoll.wire.addresses import bindable, parse_address
from atoll_coordinator.cli.local.subreaper import Adopted, Nursery, adopt_orphans, plain_environment

_STOP_LIMIT_S: Final = 5.0
_OPEN_LIMIT_S: Final = 20.0


def free_endpoint() -> str:
    """Return an address of this machine, for this machine alone, on which nobody listens."""
    return str(bindable(parse_address("tcp/127.0.0.1:0")))


class NoWorkerLeftError(AtollError):
    """Raised when the last worker of a local run has ended before its job."""


class Workers:
    """Worker processes of this machine; a context manager that leaves none behind, and kills them after an error."""

    def __init__(self, endpoint: str, number: int, log: Path) -> None:
        self.log = log
        self._endpoint = endpoint
        self.number = number
        self._processes: dict[str, subprocess.Popen[bytes] | Adopted] = {}
        self._nursery: Nursery | None = None
        self._file: IO[bytes] | None = None

    def __enter__(self) -> Self:
        self._file = self.log.open("ab")
        try:
            if self.number > 1 and adopt_orphans():
                self._nursery = Nursery(nursery_command(self._endpoint, self.number), self._file)
            else:
                for index in range(self.number):
                    self._start(f"w-{index}")
        except BaseException:
            self.stop()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is not None:  # one that is starting may hear nothing for seconds, and nothing is lost with it
            self._kill()
        self.stop()

    def check(self) -> list[str]:
        """Return a sentence for each worker that died since the last check; raise NoWorkerLeftError without any."""
        sentences = self._take_in()
        for name, process in list(self._processes.items()):
            if (code := process.poll()) is not None:
                del self._processes[name]
                sentences.append(f"worker {name} ended with {_ending(code)}; its log is {self.log}")
        if not self._processes and self._nursery is None:
            raise NoWorkerLeftError(f"every worker has ended; the reason is in {self.log}{self._last_line()}")
        return sentences

    def dismiss(self) -> None:
        """Tell all workers to end, without waiting for it."""
        if self._nursery is not None:
            self._nursery.terminate()
        for process in self._processes.values():
            process.terminate()

    def stop(self) -> None:
        """End all workers, in three steps of rising force. An interrupt goes straight to the last."""
        try:
            self.dismiss()
            if self._nursery is not None:
                self._nursery.wait(_STOP_LIMIT_S)
                self._take_in()
                self.dismiss()
            for process in self._processes.values():
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(_STOP_LIMIT_S)
        finally:
            self._kill()
            for process in self._processes.values():
                process.wait()
            self._processes.clear()
            if self._file is not None:
                self._file.close()

    def _take_in(self) -> list[str]:
        """Adopt the workers once all of them are there; return a sentence when there are fewer than there should be."""
        if self._nursery is None or not self._nursery.is_left:
            return []
        self._processes.update(self._nursery.workers())
        self._nursery = None
        missing = self.number - len(self._processes)
        return [f"{missing} of {self.number} workers could not be started; their log is {self.log}"] if missing else []

    def _kill(self) -> None:
        if self._nursery is not None:
            self._nursery.kill()
            self._nursery.wait(_STOP_LIMIT_S)
            self._take_in()
        for process in self._processes.values():
            process.kill()

    def _start(self, name: str) -> None:
        self._processes[name] = subprocess.Popen(
            worker_command(self._endpoint, name),
            stdin=subprocess.DEVNULL,
            stdout=self._file,
            stderr=self._file,
            env=plain_environment(),
            start_new_session=True,  # a Ctrl-C on the terminal is ours alone to handle
        )

    def _last_line(self) -> str:
        lines = self.log.read_text("utf-8", "replace").strip().splitlines()
        return f": {lines[-1]}" if lines else ""


def worker_command(endpoint: str, name: str) -> Sequence[str]:
    """Return the command of one worker process, which ends when this process does."""
    return _command(endpoint, name, 1)


def nursery_command(endpoint: str, number: int) -> Sequence[str]:
    """Return the command of the process that forks so many workers, w-0, w-1 and so on, and leaves them to this one."""
    return [*_command(endpoint, "w", number), "--leave"]


def _command(endpoint: str, name: str, number: int) -> Sequence[str]:
    options = ["--connect", endpoint, "--processes", str(number), "--name", name, "--wait", "30", "--grace", "0"]
    return [sys.executable, "-m", "atoll_island_worker", *options, "--parent", str(os.getpid())]


def _ending(code: int) -> str:
    return f"exit code {code}" if code >= 0 else f"signal {-code}"


class Coordinator:
    """Router and service in a thread of their own, the store in memory; a context manager."""

    def __init__(self, endpoint: str, workers: int) -> None:
        """`workers` is how many are expected to join."""
        self._endpoint = endpoint
        self._workers = workers
        self._stop = threading.Event()
        self._listening = threading.Event()
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._work, name="coordinator", daemon=True)

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

    def _work(self) -> None:
        try:
            self._serve()
        except BaseException as error:  # handed to the main thread, which raises it
            self._error = error
        finally:
            self._listening.set()

    def _serve(self) -> None:
        from atoll_coordinator.service.background.child_main import load_preparation
        from atoll_coordinator.service.background.process_pool import ProcessPool

        with contextlib.closing(ProcessPool()) as pool:
            pool.preload(load_preparation)  # loads while the rest of this is loaded
            from atoll.wire.bus.zenoh_bus import open_router
            from atoll_coordinator.service.background.ports import Ports
            from atoll_coordinator.service.service import Service
            from atoll_coordinator.service.store.store import Store

            with Store.open(None) as store, open_router(self._endpoint) as bus:
                ports = Ports(pool)
                service = Service(bus, store, expected_workers=self._workers, dismisses_workers=True, ports=ports)
                self._listening.set()
                service.run(self._stop)
