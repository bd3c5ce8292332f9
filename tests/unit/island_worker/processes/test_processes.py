"""Children get a signal, are killed after a limit, and never outlive their parent."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest

from atoll_island_worker import processes as restart_policy
from atoll_island_worker.processes import ExitReasons, start_process, supervise
from tests.programs import all_gone, is_gone, until

LIMIT_S = 30.0

SUPERVISOR = """
import sys
from functools import partial
from atoll_island_worker import processes as supervision
from atoll_island_worker.processes import ExitReasons
supervision._STOP_LIMIT_S = float(sys.argv[1])
grace_s = 30.0 if "0.5" in sys.argv[2] else 0.0
with ExitReasons() as exit_reasons:
    start = partial(supervision.start_process, [sys.executable, "-c", sys.argv[2]], exit_reasons)
    sys.exit(supervision.supervise({"w-0": start, "w-1": start}, exit_reasons, None, grace_s))
"""
FORKING_SUPERVISOR = """
import sys
from functools import partial
from atoll_island_worker import processes as supervision
from atoll_island_worker.processes import Forked
from atoll_island_worker.processes import ExitReasons
from atoll_core.main_program import exit_code_of
from atoll_island_worker.processes import print_reason
supervision._STOP_LIMIT_S = float(sys.argv[1])
code = compile(sys.argv[2], "child", "exec")
grace_s = 30.0 if "0.5" in sys.argv[2] else 0.0
start = partial(Forked, lambda: exit_code_of(lambda: exec(code, {}) or 0, print_reason))
with ExitReasons() as exit_reasons:
    sys.exit(supervision.supervise({"w-0": start, "w-1": start}, exit_reasons, None, grace_s))
"""
OBEDIENT = r"""
import os, signal
from atoll_core.signals import exiting
from atoll_island_worker.processes import end_with_parent
with exiting():
    end_with_parent(os.getppid())
    os.write(1, b"%d\n" % os.getpid())
    while True:
        signal.pause()
"""
LEAVING = r"""
import os, signal, sys, time
from atoll_core.signals import draining, exiting
drained = []
with exiting(), draining(None, lambda: drained.append(1)):
    os.kill(os.getpid(), signal.SIGTERM)
    print("drained", len(drained), flush=True)
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(60)
"""
SLOW = r"""
import os, signal, sys, time
signal.signal(signal.SIGTERM, lambda number, frame: (time.sleep(0.5), os._exit(0)))
os.write(1, b"%d\n" % os.getpid())
while True:
    signal.pause()
"""
STUBBORN = r"""
import os, signal
signal.signal(signal.SIGTERM, signal.SIG_IGN)
os.write(1, b"%d\n" % os.getpid())
while True:
    signal.pause()
"""


class Family:
    """A supervisor with two children."""

    def __init__(self, supervisor: str, child: str, stop_limit_s: float) -> None:
        command = [sys.executable, "-c", supervisor, str(stop_limit_s), child]
        self.parent = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self.parent.stdout is not None
        self.children = [int(self.parent.stdout.readline()) for _ in range(2)]

    def end(self, *signals: int) -> int:
        for number in signals:
            self.parent.send_signal(number)
        return self.parent.wait(LIMIT_S)


FamilyOf = Callable[[str, float], Family]


@pytest.fixture(params=[SUPERVISOR, FORKING_SUPERVISOR], ids=["started", "forked"])
def family_of(request: pytest.FixtureRequest) -> Iterator[FamilyOf]:
    started: list[Family] = []

    def start(child: str, stop_limit_s: float) -> Family:
        started.append(Family(request.param, child, stop_limit_s))
        return started[-1]

    yield start
    for family in started:
        for pid in [family.parent.pid, *family.children]:
            if not is_gone(pid):
                os.kill(pid, signal.SIGKILL)
        family.parent.wait(LIMIT_S)
        if family.parent.stdout is not None:
            family.parent.stdout.close()


def test_the_first_signal_asks_to_be_let_go_and_the_second_ends_at_once() -> None:
    done = subprocess.run([sys.executable, "-c", LEAVING], capture_output=True, text=True, timeout=LIMIT_S, check=False)
    assert (done.stdout, done.returncode) == ("drained 1\n", 0)


def test_a_signal_of_a_parent_that_has_died_ends_at_once() -> None:
    script = LEAVING.replace("draining(None", "draining(1 << 30")
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=LIMIT_S, check=False)
    assert (done.stdout, done.returncode) == ("", 0)


def test_children_have_some_grace_to_hand_over(family_of: FamilyOf) -> None:
    family = family_of(SLOW, 0.1)
    assert family.end(signal.SIGTERM) == 0
    assert until(lambda: all_gone(family.children))


@pytest.mark.slow
@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 0), (signal.SIGINT, 130), (signal.SIGHUP, 0)])
def test_a_signal_to_the_parent_ends_the_children_in_order(number: int, code: int, family_of: FamilyOf) -> None:
    family = family_of(OBEDIENT, LIMIT_S)
    assert family.end(number) == code
    assert until(lambda: all_gone(family.children))


def test_who_does_not_listen_is_killed_after_the_limit(family_of: FamilyOf) -> None:
    family = family_of(STUBBORN, 0.2)
    assert family.end(signal.SIGTERM) == 1
    assert until(lambda: all_gone(family.children))


def test_a_second_signal_kills_at_once(family_of: FamilyOf) -> None:
    family = family_of(STUBBORN, 10 * LIMIT_S)
    assert family.end(signal.SIGINT, signal.SIGTERM) == 130
    assert until(lambda: all_gone(family.children))


def test_children_end_when_the_parent_is_killed(family_of: FamilyOf) -> None:
    family = family_of(OBEDIENT, LIMIT_S)
    assert family.end(signal.SIGKILL) == -signal.SIGKILL
    assert until(lambda: all_gone(family.children))


def test_a_child_whose_parent_died_before_it_looked_ends_too() -> None:
    script = OBEDIENT.replace("os.getppid()", "1 << 30").replace("signal.pause()", "__import__('time').sleep(60)")
    done = subprocess.run([sys.executable, "-c", script], stdout=subprocess.DEVNULL, timeout=LIMIT_S, check=False)
    assert done.returncode == 0


def _ended(*codes: str) -> int:
    """Supervise children that end so; return the exit code."""
    with ExitReasons() as exit_reasons:
        commands = ([sys.executable, "-c", f"import os, signal, sys; {code}"] for code in codes)
        return supervise(
            {f"w-{number}": partial(start_process, command, exit_reasons) for number, command in enumerate(commands)},
            exit_reasons,
        )


@pytest.fixture
def once(monkeypatch: pytest.MonkeyPatch) -> None:
    """No child is started again."""
    monkeypatch.setattr(restart_policy, "MOST_DEATHS", 1)


@pytest.mark.usefixtures("once")
@pytest.mark.parametrize(
    ("codes", "expected"),
    [(["sys.exit(0)", "sys.exit(0)"], 0), (["sys.exit(3)", "sys.exit(2)"], 3), (["os.abort()", "sys.exit(0)"], 1)],
)
def test_the_worst_exit_code_is_ours(codes: list[str], expected: int) -> None:
    before = signal.getsignal(signal.SIGTERM)
    assert _ended(*codes) == expected
    assert signal.getsignal(signal.SIGTERM) == before


def test_a_fork_ends_with_the_code_of_its_work_and_never_returns() -> None:
    script = """
import os, sys
from functools import partial
from atoll_island_worker import processes as restart_policy
from atoll_island_worker.processes import Forked
from atoll_island_worker.processes import ExitReasons
from atoll_island_worker.processes import supervise
restart_policy.MOST_DEATHS = 1
def broken():
    raise ValueError("no such thing")
def killed():
    os.abort()
def ended(*works):
    with ExitReasons() as exit_reasons:
        return supervise({f"w-{number}": partial(Forked, work) for number, work in enumerate(works)}, exit_reasons)
print(ended(lambda: 0, lambda: 3), ended(broken), ended(killed), flush=True)
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=LIMIT_S, check=False)
    assert done.stdout == "3 1 1\n"
    assert "ValueError: no such thing" in done.stderr
    assert "(w-0) was ended by signal 6" in done.stderr


def test_a_child_that_is_killed_is_started_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(restart_policy, "FIRST_PAUSE_S", 0.01)
    mark = str(tmp_path / "mark")
    killed_once = f"os.path.exists({mark!r}) or (open({mark!r}, 'x'), os.kill(os.getpid(), signal.SIGKILL))"
    assert _ended(killed_once, "sys.exit(0)") == 0
    assert Path(mark).exists()


def test_what_processes_say_of_their_ends_is_said_once(capfd: pytest.CaptureFixture[str]) -> None:
    with ExitReasons() as exit_reasons:
        code = f"os.write({exit_reasons.writing_end}, b'no coordinator answers\\n'); sys.exit(3)"
        command = [sys.executable, "-c", f"import os, sys; {code}"]
        starts = {f"w-{number}": partial(start_process, command, exit_reasons) for number in range(3)}
        assert supervise(starts, exit_reasons) == 3
    assert capfd.readouterr().err == "island-worker: no coordinator answers\n"
