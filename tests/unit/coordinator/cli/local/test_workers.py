"""The worker processes of a local run."""

import subprocess
import sys
from pathlib import Path
from typing import ClassVar

import pytest

from atoll.errors import DataError
from atoll_coordinator.cli.local import workers as local
from atoll_coordinator.cli.local.workers import LocalWorkers

DEAF = """
import os, signal, sys
signal.signal(signal.SIGTERM, signal.SIG_IGN)
open(sys.argv[1], "w").close()
signal.pause()
"""


def test_after_an_error_a_worker_that_hears_nothing_is_not_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A worker that is loading its libraries answers a SIGTERM late; bad data must be refused at once."""
    command = [sys.executable, "-c", DEAF]
    monkeypatch.setattr(local, "worker_command", lambda endpoint, name: [*command, str(tmp_path / name)])
    monkeypatch.setattr(local, "_STOP_LIMIT_S", 1e6)
    monkeypatch.setattr(local, "become_subreaper", lambda: False)
    workers = LocalWorkers("tcp/127.0.0.1:1", 2, tmp_path / "log").__enter__()
    processes = list(workers._processes.values())
    while not all((tmp_path / name).exists() for name in ("w-0", "w-1")):
        assert all(process.poll() is None for process in processes)
    workers.__exit__(DataError, DataError("no data"), None)
    assert [process.returncode for process in processes] == [-9, -9]


def test_a_worker_that_the_system_cannot_end_is_waited_for_within_a_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Such as one that hangs in a driver: it is killed, and stays."""

    class Hung:
        waits: ClassVar[list[float | None]] = []

        def terminate(self) -> None:
            pass

        def kill(self) -> None:
            pass

        def wait(self, timeout: float | None = None) -> int:
            self.waits.append(timeout)
            raise subprocess.TimeoutExpired("worker", timeout or 0.0)

    workers = LocalWorkers("tcp/127.0.0.1:1", 1, tmp_path / "log")
    workers._processes["w-0"] = Hung()  # type: ignore[assignment]
    workers.stop()
    assert len(Hung.waits) == 2
    assert all(limit is not None and 0.0 <= limit <= local._STOP_LIMIT_S for limit in Hung.waits)
