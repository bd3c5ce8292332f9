"""Workers, servers and task processes as processes: how they end, and that none outlives whose it is."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest

from tests.unit.documents import ROOT
from tests.unit.island_worker.tasks import strange_worker
from tests.unit.island_worker.tasks.processes import LIMIT_S, children_of, is_gone, pid_in, until

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="workers are forked on Linux only")
KINDS = ("interpreter", "server")

Start = Callable[..., subprocess.Popen[str]]


@pytest.fixture
def start() -> Iterator[Start]:
    """Start workers, and let none of them survive a test."""
    started: list[subprocess.Popen[str]] = []

    def begin(*words: object) -> subprocess.Popen[str]:
        command = [sys.executable, "-m", strange_worker.__name__, *map(str, words)]
        process = subprocess.Popen(
            command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
        )
        started.append(process)
        return process

    yield begin
    for process in started:
        process.kill()
        process.communicate(timeout=LIMIT_S)


def last_line(worker: subprocess.Popen[str]) -> str:
    out, _ = worker.communicate(timeout=LIMIT_S)
    return out.splitlines()[-1]


def first_line(worker: subprocess.Popen[str]) -> str:
    assert worker.stdout is not None
    return worker.stdout.readline()


@pytest.mark.parametrize(
    ("function", "number", "said"),
    [
        ("die", 9, "Ended(failure='memory', why='its process was ended by signal 9 (SIGKILL), as happens"),
        ("die", 11, "Ended(failure='crash', why='its process was ended by signal 11 (SIGSEGV)')"),
        ("leave", 3, "Ended(failure='crash', why='its process ended with exit code 3')"),
    ],
)
def test_a_forked_process_that_dies_is_told_of_like_any_other(
    start: Start, function: str, number: int, said: str
) -> None:
    assert said in last_line(start("server", function, number))


@pytest.mark.parametrize("kind", KINDS)
def test_what_a_task_prints_and_logs_goes_its_own_ways(start: Start, kind: str) -> None:
    worker = start(kind, "echo", "a word")
    out, err = worker.communicate(timeout=LIMIT_S)
    assert "result=b'a word'" in out
    assert "by a task" not in out
    assert "written by a task" in err
    _, err = start(kind, "log").communicate(timeout=LIMIT_S)
    assert "WARNING:of.a.task:heard 1" in err
    assert "not to be heard" not in err


def test_a_server_that_is_still_loading_starts_processes(start: Start) -> None:
    assert "result=b'a word'" in last_line(start("loading", "echo", "a word"))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("function", ["spin", "sleep"])
def test_a_task_process_ends_with_its_worker_however_that_ends(
    start: Start, tmp_path: Path, kind: str, function: str
) -> None:
    starter = start(kind, function, tmp_path / "mark")
    worker = starter.pid if kind == "interpreter" else int(first_line(starter))
    task = pid_in(tmp_path / "mark")
    assert not is_gone(task)
    os.kill(worker, signal.SIGKILL)
    until(partial(is_gone, task))
    assert starter.wait(LIMIT_S) != 0


def test_nothing_is_left_when_all_are_killed_at_once(start: Start, tmp_path: Path) -> None:
    starter = start("server", "spin", tmp_path / "mark")
    worker, task = int(first_line(starter)), pid_in(tmp_path / "mark")
    (server,) = [pid for pid in children_of(starter.pid) if pid != worker]
    assert children_of(server) == [task]
    starter.kill()
    os.kill(worker, signal.SIGKILL)
    for pid in (worker, task, server):
        until(partial(is_gone, pid))


def test_a_server_that_is_killed_takes_no_task_along_and_workers_go_on_without_it(start: Start, tmp_path: Path) -> None:
    starter = start("server", "sleep", tmp_path / "mark", tmp_path / "until")
    worker, task = int(first_line(starter)), pid_in(tmp_path / "mark")
    (server,) = [pid for pid in children_of(starter.pid) if pid != worker]
    os.kill(server, signal.SIGKILL)
    until(partial(is_gone, server))
    assert not is_gone(task)
    (tmp_path / "until").touch()
    assert "result=b'slept'" in last_line(starter)


@pytest.mark.parametrize("kind", KINDS)
def test_an_interrupt_of_the_whole_group_ends_no_task(start: Start, tmp_path: Path, kind: str) -> None:
    starter = start(kind, "sleep", tmp_path / "mark", tmp_path / "until")
    task = pid_in(tmp_path / "mark")
    os.killpg(starter.pid, signal.SIGINT)
    os.kill(task, signal.SIGINT)
    assert not is_gone(task)
    (tmp_path / "until").touch()
    assert "result=b'slept'" in last_line(starter)
