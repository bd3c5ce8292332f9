"""The processes of a local run: workers and a coordinator. Workers are started first, since their start takes a second.

One process, ``island-worker --supervise``, loads everything once, forks the workers where the system allows it,
restarts workers that die, and ends them with itself (ADR 0062). Workers connect as soon as the router listens; they
share one log file. The workers always end: the supervising process gets a signal and, after a time limit, is killed; it
also ends if this process is killed.
"""

import contextlib
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, Self

from atoll_core.command_line import TLS_OPTIONS
from atoll_core.errors import AtollError, UnreachableError
from atoll_core.wire.addresses import own_address

_STOP_LIMIT_S: Final = 7.0
"""Time limit for the end of the supervisor, in seconds; longer than the supervisor's own limit for the workers."""

_ENDED: Final = "the supervisor process of the workers has ended, and with it all workers"
_SPEAKER: Final = b"island-worker: "
"""Prefix of log lines that are messages for the user."""


def start_in_new_session(
    command: Sequence[str], given: Mapping[str, str] = MappingProxyType({}), **streams: Any
) -> "subprocess.Popen[bytes]":
    """Start a program in a new session, because only this process should handle Ctrl-C on the terminal.

    It gets our environment variables and the `given` ones, but no certificates, because local traffic is not encrypted.
    """
    certificates = {variable for variable, _ in TLS_OPTIONS.values()}
    environment = {name: value for name, value in os.environ.items() if name not in certificates}
    environment |= given
    return subprocess.Popen[bytes](command, env=environment, start_new_session=True, **streams)


class NoWorkerLeftError(AtollError):
    """Raised when the supervisor of the workers of a local run has ended before the job."""


class LocalWorkers:
    """Worker processes on this machine; a context manager that ends all of them, and kills them after an error."""

    def __init__(self, endpoint: str, number: int, log: Path) -> None:
        self.log = log
        self.number = number
        self._command = supervisor_command(endpoint, number)
        self._begin = self._read = 0

    def __enter__(self) -> Self:
        with self.log.open("ab") as log:
            self._begin = self._read = log.tell()
            self._process = start_in_new_session(self._command, stdin=subprocess.DEVNULL, stdout=log, stderr=log)
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is not None:  # a starting process may ignore SIGTERM for seconds, and has no work to lose
            self._process.kill()
        self.stop()

    def check(self) -> list[str]:
        """Return new messages about workers that died in this run.

        Raises NoWorkerLeftError if the supervisor has ended; then all workers have ended, too.
        """
        has_ended = self._process.poll() is not None
        sentences = self._new_messages()
        if has_ended:
            lines = self.log.read_bytes()[self._begin :].decode("utf-8", "replace").strip().splitlines()
            last = f": {lines[-1]}" if lines else ""
            raise NoWorkerLeftError(f"{_ENDED}; the reason is in {self.log}{last}")
        return sentences

    def dismiss(self) -> None:
        """Tell all workers to end, without waiting."""
        self._process.terminate()

    def stop(self) -> None:
        """End all workers: terminate, wait within a limit, kill. Ctrl-C kills them at once."""
        try:
            self.dismiss()
            self._wait()
        finally:
            self._process.kill()
            self._wait()

    def _wait(self) -> None:
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(_STOP_LIMIT_S)

    def _new_messages(self) -> list[str]:
        """Return the messages for users that this run has added to the log since the last call."""
        with self.log.open("rb") as log:
            log.seek(self._read)
            *lines, rest = log.read().split(b"\n")
            self._read = log.tell() - len(rest)
        return [line.removeprefix(_SPEAKER).decode("utf-8", "replace") for line in lines if line.startswith(_SPEAKER)]


def supervisor_command(endpoint: str, number: int) -> Sequence[str]:
    """Return the command of a supervisor of `number` workers, w-0, w-1 and so on; it ends with this process."""
    return [*worker_command(endpoint, "w", number), "--supervise"]


def worker_command(
    endpoint: str, name: str | None, number: int = 1, *, wait_s: float = 30.0, grace_s: float = 0.0
) -> Sequence[str]:
    """Return the command of worker processes that end with this process.

    By default a worker is named after host and process; see ``island-worker --help`` for the other options.
    """
    options = ["--connect", endpoint, "--processes", str(number), *(["--name", name] if name is not None else [])]
    options += ["--wait", f"{wait_s:g}", "--grace", f"{grace_s:g}"]
    return [sys.executable, "-m", "atoll_island_worker", *options, "--parent", str(os.getpid())]


_COORDINATOR_STOP_S: Final = 5.0
_OPEN_LIMIT_S: Final = 20.0


@contextlib.contextmanager
def local_processes(number: int, log: Path) -> Iterator[tuple[str, LocalWorkers]]:
    """Start workers; yield the address to which they connect, and the workers."""
    with own_address() as address, LocalWorkers(str(address), number, log) as workers:
        yield str(address), workers


class LocalCoordinator:
    """A coordinator in its own thread, with its store in memory; a context manager."""

    def __init__(self, endpoint: str, workers: int) -> None:
        """`workers` is the expected number of workers."""
        self._endpoint = endpoint
        self._workers = workers
        self._stop = threading.Event()
        self._listening = threading.Event()
        self._wake: Callable[[], object] = lambda: None
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="coordinator", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._wake()
        self._thread.join(_COORDINATOR_STOP_S)

    def wait(self) -> None:
        """Wait until the coordinator answers; raises the error that prevented it."""
        if not self._listening.wait(_OPEN_LIMIT_S):
            raise UnreachableError(f"the router did not listen on {self._endpoint} within {_OPEN_LIMIT_S:.0f} s")
        self.check()

    def check(self) -> None:
        """Raise an error if the coordinator has ended: its own error, or AtollError."""
        if self._error is not None:
            raise self._error
        if not self._thread.is_alive():
            raise AtollError("the coordinator has ended unexpectedly; see its log")

    def _run(self) -> None:
        try:
            from atoll_coordinator.service.service_loop import Service
            from atoll_coordinator.service.store.store import Store
            from atoll_core.wire.bus.zenoh_bus import open_router

            with Store.open(None) as store, open_router(self._endpoint) as bus:
                service = Service(bus, store, expected_workers=self._workers, dismisses_workers=True)
                self._wake = service.wake
                service.start()
                self._listening.set()  # only now a client's greeting is answered
                service.work(self._stop)
        except BaseException as error:  # the main thread raises it
            self._error = error
        finally:
            self._listening.set()
