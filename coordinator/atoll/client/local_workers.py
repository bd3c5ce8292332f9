"""The worker processes of a local run: started first of all, since loading takes them a second.

One process, ``island-worker --supervise``, loads everything once, forks them where the system allows it, starts again
those that die, and ends them with itself (ADR 0062). They connect as soon as the router listens; their log is one file.
Whatever happens, the workers end: that process is told to, then killed, and it watches this one, should that be killed.
"""

import contextlib
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, Self

from atoll_core.command_line import TLS_OPTIONS
from atoll_core.errors import AtollError

_STOP_LIMIT_S: Final = 7.0
"""Longer than the process that watches over the workers gives these."""

_ENDED: Final = "the process that watches over the workers has ended, and they with it"
_SPEAKER: Final = b"island-worker: "
"""Begins lines of the log that are for people."""


def start_apart(
    command: Sequence[str], given: Mapping[str, str] = MappingProxyType({}), **streams: Any
) -> "subprocess.Popen[bytes]":
    """Start a program in a session of its own, since a Ctrl-C on the terminal is ours alone to handle.

    Its environment is ours without certificates, since on this machine alone nothing is encrypted, and what is `given`.
    """
    certificates = {variable for variable, _ in TLS_OPTIONS.values()}
    environment = {name: value for name, value in os.environ.items() if name not in certificates}
    environment |= given
    return subprocess.Popen[bytes](command, env=environment, start_new_session=True, **streams)


class NoWorkerLeftError(AtollError):
    """Raised when the process that watches over the workers of a local run has ended before the job."""


class LocalWorkers:
    """Worker processes of this machine; a context manager that leaves none behind, and kills them after an error."""

    def __init__(self, endpoint: str, number: int, log: Path) -> None:
        self.log = log
        self.number = number
        self._command = supervisor_command(endpoint, number)
        self._begin = self._read = 0

    def __enter__(self) -> Self:
        with self.log.open("ab") as log:
            self._begin = self._read = log.tell()
            self._process = start_apart(self._command, stdin=subprocess.DEVNULL, stdout=log, stderr=log)
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is not None:  # one that is starting may hear nothing for seconds, and nothing is lost with it
            self._process.kill()
        self.stop()

    def check(self) -> list[str]:
        """Return what was said since the last check of workers that died, in this run.

        Raises NoWorkerLeftError when the process that watches over them has ended, and they with it.
        """
        has_ended = self._process.poll() is not None
        sentences = self._said()
        if has_ended:
            lines = self.log.read_bytes()[self._begin :].decode("utf-8", "replace").strip().splitlines()
            last = f": {lines[-1]}" if lines else ""
            raise NoWorkerLeftError(f"{_ENDED}; the reason is in {self.log}{last}")
        return sentences

    def dismiss(self) -> None:
        """Tell all workers to end, without waiting for it."""
        self._process.terminate()

    def stop(self) -> None:
        """End all workers, in steps of rising force and each within a limit. An interrupt goes straight to the last."""
        try:
            self.dismiss()
            self._wait()
        finally:
            self._process.kill()
            self._wait()

    def _wait(self) -> None:
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(_STOP_LIMIT_S)

    def _said(self) -> list[str]:
        """Return the sentences for people that this run has added to the log since the last time."""
        with self.log.open("rb") as log:
            log.seek(self._read)
            *lines, rest = log.read().split(b"\n")
            self._read = log.tell() - len(rest)
        return [line.removeprefix(_SPEAKER).decode("utf-8", "replace") for line in lines if line.startswith(_SPEAKER)]


def supervisor_command(endpoint: str, number: int) -> Sequence[str]:
    """Return the command of the process that keeps so many workers, w-0, w-1 and so on, and ends when this one does."""
    return [*worker_command(endpoint, "w", number), "--supervise"]


def worker_command(
    endpoint: str, name: str | None, number: int = 1, *, wait_s: float = 30.0, grace_s: float = 0.0
) -> Sequence[str]:
    """Return the command of so many worker processes, which end when this process does.

    Without a `name` theirs are those of host and process; see ``island-worker --help`` for the other options.
    """
    options = ["--connect", endpoint, "--processes", str(number), *(["--name", name] if name is not None else [])]
    options += ["--wait", f"{wait_s:g}", "--grace", f"{grace_s:g}"]
    return [sys.executable, "-m", "atoll_island_worker", *options, "--parent", str(os.getpid())]
