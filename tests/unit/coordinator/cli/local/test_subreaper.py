"""Workers that were forked by another process: they become children of the run, and none is left behind."""

import subprocess
import sys
from pathlib import Path

import pytest

LIMIT_S = 60.0

PREAMBLE = """
import os, signal, sys, time
from pathlib import Path
from atoll.errors import DataError
from atoll_coordinator.cli.local import workers as local
from atoll_coordinator.cli.local.workers import NoWorkerLeftError, LocalWorkers

FORKS = '''
import os, signal, sys
from atoll_island_worker.processes.fork_server import fork_detached
def idle():
    signal.pause()
def deaf():
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    open("deaf-" + str(os.getpid()), "w").close()
    while True:
        signal.pause()
def quits():
    return 3
fork_detached({f"w-{index}": globals()[kind] for index, kind in enumerate(sys.argv[1:])})
'''

def workers(*kinds, script=FORKS):
    local.fork_server_command = lambda endpoint, number: [sys.executable, "-c", script, *kinds]
    return LocalWorkers("tcp/127.0.0.1:1", len(kinds), Path("log"))

def pids(family):
    while family._fork_server is not None:
        assert family.check() == []
        time.sleep(0.01)
    return [each.pid for each in family._processes.values()]

def said(family):
    while not (exit_reasons := family.check()):
        time.sleep(0.01)
    return exit_reasons

def children():
    return Path(f"/proc/{os.getpid()}/task/{os.getpid()}/children").read_text().split()
"""


@pytest.fixture
def say(tmp_path: Path) -> "Say":
    return Say(tmp_path)


class Say:
    """Runs a script as a process of its own, since it adopts whatever loses its parent; returns what it printed."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def __call__(self, script: str) -> str:
        done = subprocess.run(
            [sys.executable, "-c", PREAMBLE + script],
            cwd=self._folder, env={},
            capture_output=True, text=True, timeout=LIMIT_S, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        return done.stdout


def test_forked_workers_become_children_and_end_when_told(say: Say) -> None:
    script = """
with workers("idle", "idle") as family:
    found = pids(family)
    assert len(found) == 2
    assert sorted(children()) == sorted(map(str, found))
assert children() == []
print("nothing left")
"""
    assert say(script) == "nothing left\n"


def test_a_worker_that_dies_is_said_with_its_signal_or_exit_code(say: Say) -> None:
    script = """
with workers("idle", "quits", "idle") as family:
    print(*said(family))
    pids(family)
    os.kill(family._processes["w-2"].pid, signal.SIGKILL)
    print(*said(family))
    os.kill(family._processes["w-0"].pid, signal.SIGKILL)
    try:
        said(family)
    except NoWorkerLeftError as error:
        print(error)
"""
    assert say(script).splitlines() == [
        "worker w-1 ended with exit code 3; its log is log",
        "worker w-2 ended with signal 9; its log is log",
        "every worker has ended; the reason is in log",
    ]


@pytest.mark.parametrize("moment", ["", "pids(family)", "pids(family); deaf(family)"])
def test_after_an_error_nobody_is_left_nor_waited_for(moment: str, say: Say) -> None:
    """At once, while they are being forked, when they are there, and when they hear nothing."""
    script = f"""
def deaf(family):
    while len(list(Path().glob("deaf-*"))) < 2:
        time.sleep(0.01)
try:
    with workers("deaf", "deaf") as family:
        local._STOP_LIMIT_S = 1e6
        {moment}
        raise DataError("no data")
except DataError:
    print(children())
"""
    assert say(script) == "[]\n"


def test_who_is_not_forked_is_said_and_a_fork_server_that_breaks_ends_the_run(say: Say) -> None:
    script = """
with workers("idle", "idle", script=FORKS.replace("sys.argv[1:]", "sys.argv[2:]")) as family:
    print(*said(family))
try:
    with workers("idle", "idle", script="import os; os.abort()") as family:
        print(*said(family))
        said(family)
except NoWorkerLeftError as error:
    print(error)
"""
    assert say(script).splitlines() == [
        "1 of 2 workers could not be started; their log is log",
        "every worker has ended; the reason is in log",
    ]
