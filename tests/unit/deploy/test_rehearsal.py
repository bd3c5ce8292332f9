"""The rehearsal's own promises: every process is ended, what is missing is named, every step is described."""

import signal
from pathlib import Path

import pytest

from deploy.rehearsal.__main__ import STEPS
from deploy.rehearsal.machine import Machine, NotPossibleError, command_line, wait_until
from tests.unit.documents import ROOT


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path, install=False, base=None, kernels="generic")


@pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="processes are found in /proc")
def test_processes_are_ended_also_when_their_parent_has_left_them_and_they_ignore_sigterm(machine: Machine) -> None:
    script = "trap '' TERM; (setsid sleep 1000 &) ; echo ready > ready; exit 0"
    machine.start("parent", "sh", "-c", script).wait(30)
    assert (machine.work / "ready").exists()
    # A process that just becomes another program shows no environment for an instant: sh, then setsid, then sleep.
    wait_until(
        "the orphan sleeps", lambda: [command_line(pid)[:1] for pid in machine.processes("parent")] == [["sleep"]]
    )
    assert machine.end_all(grace=0.5) == 1
    assert machine.processes() == []


@pytest.mark.skipif(not Path("/proc/self/environ").exists(), reason="processes are found in /proc")
def test_the_processes_of_one_task_are_killed_by_a_variable_of_theirs(machine: Machine) -> None:
    first, second = (machine.start(f"task-{number}", "env", f"TASK={number}", "sleep", "1000") for number in (1, 11))
    wait_until("both sleep", lambda: len(machine.processes("", "TASK=1") + machine.processes("", "TASK=11")) == 2)
    machine.kill("TASK=1")
    assert first.wait(30) == -signal.SIGKILL
    assert machine.processes("", "TASK=11") == [second.pid]
    machine.end_all(grace=5)


def test_a_missing_program_is_named_with_its_package(machine: Machine) -> None:
    with pytest.raises(NotPossibleError, match=r"no-such-program not found.*installs its-package"):
        machine.need({"no-such-program": "its-package", "sh": "dash"})
    with pytest.raises(NotPossibleError, match="no-such-tool not found; --install fetches the Python package its-name"):
        machine.python_tool("no-such-tool", "its-name")


def test_the_documents_describe_every_step_and_name_the_rehearsal() -> None:
    text = (ROOT / "deploy" / "README.md").read_text("utf-8")
    assert [name for name in STEPS if f"| `{name}` |" not in text] == []
    assert "make deploy-rehearsal" in (ROOT / "CONTRIBUTING.md").read_text("utf-8")
