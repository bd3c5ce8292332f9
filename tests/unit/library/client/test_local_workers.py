"""The worker processes of a local run, here in the hands of little programs that watch over nobody."""

import sys
from pathlib import Path

import pytest

from atoll.client import local_processes as local
from atoll.client.local_processes import LocalWorkers, NoWorkerLeftError

ENDS = """
import sys
sys.stderr.write("a line of the log\\nisland-worker: process 7 (w-0) was ended by signal 9\\n")
sys.stderr.write("island-worker: no other is left\\n")
"""


@pytest.fixture
def workers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> LocalWorkers:
    monkeypatch.setattr(local, "supervisor_command", lambda endpoint, number: [sys.executable, "-c", request.param])
    return LocalWorkers("tcp/127.0.0.1:1", 2, tmp_path / "log")


@pytest.mark.parametrize("workers", [ENDS], indirect=True)
def test_what_is_said_of_workers_is_told_once_and_their_end_is_an_error(workers: LocalWorkers) -> None:
    with workers:
        workers._process.wait()
        sentences = workers._new_messages()
        with pytest.raises(NoWorkerLeftError, match=r"the reason is in .*log: island-worker: no other is left$"):
            workers.check()
    assert sentences == ["process 7 (w-0) was ended by signal 9", "no other is left"]
    assert workers._new_messages() == []
