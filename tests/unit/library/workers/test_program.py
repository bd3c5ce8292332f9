"""The worker program as a child of a cluster's process, and what its handle says of its end."""

import signal
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import pytest

from atoll.workers import program
from atoll.workers.handle import Handle, MachineWorkers
from atoll.workers.program import ProgramOptions, WorkerProgram, ending
from atoll_core.errors import AtollError
from atoll_island_worker.cli import _parse
from tests.programs import until

OPTIONS = ProgramOptions("tls/lab:7447", 7.0, 3.0, {"ca": "a.pem", "cert": "c.pem", "key": "k.pem"})
STUBBORN = """
import pathlib, signal, sys, time
signal.signal(signal.SIGTERM, signal.SIG_IGN)
pathlib.Path(sys.argv[1]).touch()
time.sleep(60)
"""


class Machines(Handle):
    def __init__(self, **machines: MachineWorkers) -> None:
        self.found = machines
        self.is_closed = False

    def machines(self) -> Mapping[str, MachineWorkers]:
        return self.found

    def close(self) -> None:
        self.is_closed = True


def test_the_command_is_one_that_the_program_understands(monkeypatch: pytest.MonkeyPatch) -> None:
    commands: list[Sequence[str]] = []
    monkeypatch.setattr("subprocess.Popen", lambda command, **_: commands.append(command))
    WorkerProgram(OPTIONS, 4)
    (command,) = commands
    assert list(command[:3]) == [sys.executable, "-m", "atoll_island_worker"]
    read = _parse(command[3:])
    assert (read.connect, read.processes, read.wait, read.grace) == ("tls/lab:7447", 4, 7.0, 3.0)
    assert (read.tls_ca, read.tls_cert, read.tls_key) == ("a.pem", "c.pem", "k.pem")
    assert read.supervise
    assert read.parent
    assert read.name is None


def test_the_end_of_a_program_is_seen() -> None:
    made = WorkerProgram(ProgramOptions("tcp/127.0.0.1:9", 0.0, 0.0), 1)
    until(lambda: made.exit_code() is not None)
    assert made.exit_code() == 3
    made.drain()


def test_a_program_that_does_not_end_is_killed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mark = tmp_path / "mark"
    monkeypatch.setattr(program, "STOP_LIMIT_S", 0.05)
    monkeypatch.setattr(program, "worker_command", lambda *_, **__: [sys.executable, "-c", STUBBORN, str(mark)])
    made = WorkerProgram(ProgramOptions("tcp/127.0.0.1:9", 0.0, 0.0), 1)
    until(mark.exists)
    made.drain()
    assert made.exit_code() == -signal.SIGKILL


def test_a_handle_says_which_machine_has_lost_its_workers_and_why() -> None:
    Machines(first=MachineWorkers(2, None)).check()
    with pytest.raises(AtollError) as raised:
        Machines(first=MachineWorkers(2, None), second=MachineWorkers(1, 2)).check()
    assert str(raised.value) == (
        "the island workers of second have ended with exit code 2 (bad options, or refused by the coordinator); the "
        "log of that machine's process in the cluster says more"
    )


@pytest.mark.parametrize(
    ("code", "sentence"),
    [
        (0, "ended with exit code 0 (the coordinator ended, or they were told to end)"),
        (1, "ended with exit code 1"),
        (3, "ended with exit code 3 (the coordinator could not be reached)"),
        (-9, "ended by signal 9"),
    ],
)
def test_endings_are_said(code: int, sentence: str) -> None:
    assert ending(code) == sentence


def test_the_end_of_a_block_ends_the_workers() -> None:
    with Machines() as handle:
        assert not handle.is_closed
    assert handle.is_closed
