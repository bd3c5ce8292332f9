"""The worker processes of a local run, here in the hands of little programs that watch over nobody."""

import subprocess
import sys
from pathlib import Path
from typing import ClassVar

import pytest

from atoll.client import local_processes as local
from atoll.client.local_processes import LocalWorkers, NoWorkerLeftError
from atoll_core.errors import DataError

DEAF = """
import signal
signal.signal(signal.SIGTERM, signal.SIG_IGN)
print("deaf", flush=True)
signal.pause()
"""
ENDS = """
import sys
sys.stderr.write("a line of the log\\nisland-worker: process 7 (w-0) was ended by signal 9\\n")
sys.stderr.write("island-worker: no other is left\\n")
"""


@pytest.fixture
def workers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> LocalWorkers:
    monkeypatch.setattr(local, "supervisor_command", lambda endpoint, number: [sys.executable, "-c", request.param])
    return LocalWorkers("tcp/127.0.0.1:1", 2, tmp_path / "log")


@pytest.mark.parametrize("workers", [DEAF], indirect=True)
def test_after_an_error_a_process_that_hears_nothing_is_not_waited_for(
    workers: LocalWorkers, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that is loading its libraries answers a SIGTERM late; bad data must be refused at once."""
    monkeypatch.setattr(local, "_STOP_LIMIT_S", 1e6)
    workers.__enter__()
    while "deaf" not in workers.log.read_text():
        assert workers._process.poll() is None
    workers.__exit__(DataError, DataError("no data"), None)
    assert workers._process.returncode == -9


@pytest.mark.parametrize("workers", [ENDS], indirect=True)
def test_what_is_said_of_workers_is_told_once_and_their_end_is_an_error(workers: LocalWorkers) -> None:
    with workers:
        workers._process.wait()
        sentences = workers._said()
        with pytest.raises(NoWorkerLeftError, match=r"the reason is in .*log: island-worker: no other is left$"):
            workers.check()
    assert sentences == ["process 7 (w-0) was ended by signal 9", "no other is left"]
    assert workers._said() == []


@pytest.mark.parametrize("workers", ["pass"], indirect=True)
def test_what_an_earlier_run_said_of_its_workers_is_no_news(workers: LocalWorkers) -> None:
    workers.log.write_text("island-worker: process 4711 (w-0) was ended by signal 9\n")
    with workers:
        workers._process.wait()
        assert workers._said() == []
        with pytest.raises(NoWorkerLeftError, match=r"has ended, and they with it; the reason is in .*log$"):
            workers.check()


def test_a_process_that_the_system_cannot_end_is_waited_for_within_a_limit(tmp_path: Path) -> None:
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
    workers._process = Hung()  # type: ignore[assignment]
    workers.stop()
    assert Hung.waits == [local._STOP_LIMIT_S] * 2
