"""The worker processes of a local run: started first of all, since loading takes them a second.

They connect as soon as the router listens; their log is one file. Several of them are forked by one process that has
loaded everything once, where the system allows it (see `subreaper`). Whatever happens, the workers end: they are told
to, then killed; and they watch this process themselves, should it be killed.
"""

import contextlib
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import IO, Final, Self

from atoll.errors import AtollError
from atoll.wire.addresses import bindable, parse_address
from atoll_coordinator.cli.local.subreaper import AdoptedProcess, ForkServer, become_subreaper, plain_environment

_STOP_LIMIT_S: Final = 5.0


def free_endpoint() -> str:
    """Return an address of this machine, for this machine alone, on which nobody listens."""
    return str(bindable(parse_address("tcp/127.0.0.1:0")))


class NoWorkerLeftError(AtollError):
    """Raised when the last worker of a local run has ended before its job."""


class LocalWorkers:
    """Worker processes of this machine; a context manager that leaves none behind, and kills them after an error."""

    def __init__(self, endpoint: str, number: int, log: Path, *, are_replaced: bool = False) -> None:
        """`are_replaced`: a worker that dies is started again, by a process that watches over all of them."""
        self.log = log
        self._are_replaced = are_replaced
        self.number = number
        self._endpoint = endpoint
        self._processes: dict[str, subprocess.Popen[bytes] | AdoptedProcess] = {}
        self._fork_server: ForkServer | None = None
        self._file: IO[bytes] | None = None

    def __enter__(self) -> Self:
        self._file = self.log.open("ab")
        try:
            if self._are_replaced:
                self._start("w", supervisor_command(self._endpoint, self.number))
            elif self.number > 1 and become_subreaper():
                self._fork_server = ForkServer(fork_server_command(self._endpoint, self.number), self._file)
            else:
                for index in range(self.number):
                    self._start(f"w-{index}", worker_command(self._endpoint, f"w-{index}"))
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
        sentences = self._adopt()
        for name, process in list(self._processes.items()):
            if (code := process.poll()) is not None:
                del self._processes[name]
                sentences.append(f"worker {name} ended with {_ending(code)}; its log is {self.log}")
        if not self._processes and self._fork_server is None:
            raise NoWorkerLeftError(f"every worker has ended; the reason is in {self.log}{self._last_line()}")
        return sentences

    def dismiss(self) -> None:
        """Tell all workers to end, without waiting for it."""
        if self._fork_server is not None:
            self._fork_server.terminate()
        for process in self._processes.values():
            process.terminate()

    def stop(self) -> None:
        """End all workers, in steps of rising force and each within a limit. An interrupt goes straight to the last."""
        try:
            self.dismiss()
            if self._fork_server is not None:
                self._fork_server.wait(_STOP_LIMIT_S)
                self._adopt()
                self.dismiss()
            self._wait()
        finally:
            self._kill()
            self._wait()
            self._processes.clear()
            if self._file is not None:
                self._file.close()

    def _wait(self) -> None:
        """Wait, within a limit for all of them together, until the processes have ended."""
        end = time.monotonic() + _STOP_LIMIT_S
        for process in self._processes.values():
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(max(0.0, end - time.monotonic()))

    def _adopt(self) -> list[str]:
        """Adopt the workers once all of them are there; return a sentence when there are fewer than there should be."""
        if self._fork_server is None or not self._fork_server.poll():
            return []
        self._processes.update(self._fork_server.workers())
        self._fork_server = None
        missing = self.number - len(self._processes)
        return [f"{missing} of {self.number} workers could not be started; their log is {self.log}"] if missing else []

    def _kill(self) -> None:
        if self._fork_server is not None:
            self._fork_server.kill()
            self._fork_server.wait(_STOP_LIMIT_S)
            self._adopt()
        for process in self._processes.values():
            process.kill()

    def _start(self, name: str, command: Sequence[str]) -> None:
        self._processes[name] = subprocess.Popen(
            command,
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


def supervisor_command(endpoint: str, number: int) -> Sequence[str]:
    """Return the command of the process that keeps so many workers, w-0, w-1 and so on, and ends when this one does."""
    return [*_command(endpoint, "w", number), "--supervise"]


def fork_server_command(endpoint: str, number: int) -> Sequence[str]:
    """Return the command of the process that forks so many workers, w-0, w-1 and so on, and leaves them to this one."""
    return [*_command(endpoint, "w", number), "--detach"]


def _command(endpoint: str, name: str, number: int) -> Sequence[str]:
    options = ["--connect", endpoint, "--processes", str(number), "--name", name, "--wait", "30", "--grace", "0"]
    return [sys.executable, "-m", "atoll_island_worker", *options, "--parent", str(os.getpid())]


def _ending(code: int) -> str:
    return f"exit code {code}" if code >= 0 else f"signal {-code}"
