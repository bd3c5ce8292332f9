"""A Dask cluster on this machine as its users start it: a scheduler and workers, each a program of its own."""

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, Self

from atoll_core.errors import AtollError, UsageError
from benchmarks.harness.accounts import status

START_LIMIT_S: Final = 60.0
STOP_LIMIT_S: Final = 10.0
ANSWER_LIMIT_S: Final = 120.0
ONE_THREAD: Final = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
"""Set by Dask's own nanny by default, and not by its worker alone."""


def check_installed() -> None:
    """Raise UsageError where ``distributed`` is not installed."""
    try:
        import distributed  # noqa: F401
    except ImportError:
        raise UsageError(
            "distributed is not installed, which the trial of it needs; pip install -e '.[bench]'"
        ) from None


class Cluster:
    """One scheduler and workers of one thread each; a context manager that leaves no process behind."""

    def __init__(self, workers: int) -> None:
        self._made = TemporaryDirectory(prefix="atoll-dask-")
        self.folder: Final = Path(self._made.name)
        self.port = _free_port()
        self.wanted: Final = workers
        self.scheduler: subprocess.Popen[bytes] | None = None
        self.workers: list[subprocess.Popen[bytes]] = []

    @property
    def address(self) -> str:
        """Where the scheduler listens."""
        return f"tcp://127.0.0.1:{self.port}"

    def __enter__(self) -> Self:
        self.start_scheduler()
        for _ in range(self.wanted):
            self.start_worker()
        return self

    def __exit__(self, *_: object) -> None:
        for process in (*self.workers, self.scheduler):
            if process is not None:
                end(process)
        self._made.cleanup()

    def start_scheduler(self) -> None:
        """Start the scheduler, again at the same port."""
        self.scheduler = self._start("scheduler", "--port", str(self.port), "--no-dashboard", "--host", "127.0.0.1")

    def start_worker(self, contact: str | None = None) -> "subprocess.Popen[bytes]":
        """Start a worker, without the second process that would start it again.

        It has others dial the address `contact`, unless that is None where it listens.
        """
        place = ["--host", "127.0.0.1"]
        if contact is not None:
            place = ["--listen-address", "tcp://127.0.0.1:0", "--contact-address", contact]
        options = ["--no-nanny", "--nthreads", "1", "--no-dashboard", "--local-directory", str(self.folder)]
        process = self._start("worker", self.address, *options, *place)
        self.workers.append(process)
        return process

    def _start(self, program: str, *words: str) -> "subprocess.Popen[bytes]":
        command = [sys.executable, "-m", f"distributed.cli.dask_{program}", *words]
        with (self.folder / f"{program}.log").open("ab") as log:
            return subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True,
                env={**os.environ, **ONE_THREAD},
            )  # fmt: skip

    def client(self, workers: int | None = None) -> Any:
        """Return a client once so many workers have come."""
        from distributed import Client

        client = Client(self.address, timeout=START_LIMIT_S, set_as_default=False)
        client.wait_for_workers(self.wanted if workers is None else workers, timeout=START_LIMIT_S)
        return client


def end(process: "subprocess.Popen[bytes]") -> None:
    """End a process, in steps of rising force."""
    with suppress(ProcessLookupError):
        process.send_signal(signal.SIGCONT)
    process.terminate()
    try:
        process.wait(STOP_LIMIT_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait(STOP_LIMIT_S)


def megabytes(pid: int) -> float:
    """Return the memory that a process holds, in MB."""
    return status(pid, "VmRSS") / 1e6


def listening(pid: int) -> int:
    """Return at how many TCP ports a process listens."""
    import psutil

    return len({one.laddr for one in psutil.Process(pid).net_connections("tcp") if one.status == psutil.CONN_LISTEN})


def waited(is_so: Callable[[], bool], limit_s: float, look_s: float = 0.02) -> float | None:
    """Return after how many seconds something is so, None when it takes longer than the limit."""
    began = time.monotonic()
    while time.monotonic() - began < limit_s:
        if is_so():
            return time.monotonic() - began
        time.sleep(look_s)
    return None


def worker_pid(client: Any, address: str) -> int:
    """Return the process of the worker at an address."""
    return int(client.run(os.getpid, workers=[address])[address])


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def check(is_so: bool, otherwise: str) -> None:
    """Raise AtollError unless something is so."""
    if not is_so:
        raise AtollError(otherwise)
