"""The worker's command line: what it says, what it starts, and how it ends."""

import os
import socket
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from atoll_core.errors import RefusedError, UnreachableError
from atoll_island_worker import cli, processes
from atoll_island_worker import worker as worker_module
from tests.certificates import Lab


@pytest.fixture(autouse=True)
def _no_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ATOLL_CONNECT", raising=False)


@pytest.fixture
def worked(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, str, float | None]]:
    """What the one process was told to do."""
    calls: list[tuple[str, str, float | None]] = []
    monkeypatch.setattr(worker_module, "run_worker", lambda to, *others: calls.append((str(to), *others[:2])) or 0)
    return calls


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ([], "no coordinator was named; give --connect tcp/HOST:PORT or set ATOLL_CONNECT"),
        (["--connect", "lab1"], "'lab1' was found where tcp/HOST:PORT was expected"),
        (["--connect", "tcp/a:1", "--processes", "0"], "auto or a number"),
        (["--connect", "tcp/a:1", "--processes", "some"], "auto or a number"),
        (["--connect", "tcp/a:1", "--name", "a b"], "letters, digits"),
        (["--connect", "tcp/a:1", "--name", "a" * 65], "letters, digits"),
        (["--connect", "tcp/a:1", "--wait", "-1"], "number of seconds"),
        (["--connect", "tcp/a:1", "--wait", "nan"], "number of seconds"),
        (["--connect", "tcp/a:1", "--lifetime", "soon"], "a time such as 90s, 30m or 12h was expected, but 'soon'"),
        (["--connect", "tcp/a:1", "--grace=-5m"], "a time such as"),
        (["--connect", "tcp/a:1", "--speed", "2"], "unknown option"),
        (["--connect"], "--connect needs a value"),
        (["--connect", "tcp/a:1", "--connect-file", "f"], "both --connect and --connect-file were given"),
        (["--connect-file", __file__], "holds no list of addresses"),
    ],
)
def test_a_wrong_command_line_is_one_sentence_and_exit_code_2(
    arguments: list[str], reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(arguments) == 2
    output = capsys.readouterr()
    assert reason in output.err
    assert output.err.startswith("island-worker: ")
    assert output.err.count("\n") == 1
    assert output.out == ""


def test_one_process_works_under_the_name_it_was_given(worked: list[tuple[str, str, float | None]]) -> None:
    assert cli.main(["--connect", "tcp/a:1", "--processes", "1", "--name", "w1", "--wait", "2.5"]) == 0
    assert worked == [("tcp/a:1", "w1", 2.5)]


def test_the_address_may_come_from_the_environment_and_the_name_from_host_and_process(
    worked: list[tuple[str, str, float | None]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ATOLL_CONNECT", "tcp/b:2")
    monkeypatch.setattr("socket.gethostname", lambda: "lab 1.example.org")
    monkeypatch.setattr("os.getpid", lambda: 17)
    assert cli.main(["--processes", "1"]) == 0
    assert worked == [("tcp/b:2", "lab-1-17", None)]


@pytest.mark.parametrize(
    ("words", "lifetime_s", "grace_s"),
    [([], None, 30.0), (["--lifetime", "90"], 90.0, 30.0), (["--lifetime", "1.5h", "--grace", "2m"], 5400.0, 120.0)],
)
def test_a_worker_leaves_after_its_lifetime_and_has_some_grace(
    words: list[str], lifetime_s: float | None, grace_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[tuple[float | None, float]] = []
    monkeypatch.setattr(worker_module, "run_worker", lambda *arguments: calls.append(arguments[3:5]) or 0)
    assert cli.main(["--connect", "tcp/a:1", "--processes", "1", *words]) == 0
    assert calls == [(lifetime_s, grace_s)]


@pytest.fixture
def loads(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What was loaded ahead."""
    calls: list[str] = []
    monkeypatch.setattr(cli, "load_ahead", lambda: calls.append("all"))
    return calls


def test_where_a_fork_is_unsafe_several_processes_are_started_and_end_with_this_one(
    monkeypatch: pytest.MonkeyPatch, loads: list[str], lab: Lab
) -> None:
    started: list[list[str]] = []

    def supervise(starts: Mapping[str, Callable[[], int]], *_: object) -> int:
        return max([start() for start in starts.values()])

    monkeypatch.setattr(processes, "can_fork", lambda: False)
    monkeypatch.setattr(processes, "supervise", supervise)
    monkeypatch.setattr(processes, "start_process", lambda command, _: started.append(command) or 3)
    words = ["--connect", "tls/a:1", "--processes", "2", "--name", "lab1-" + "n" * 59, "--lifetime", "30m"]
    assert cli.main([*words, "--grace", "5", *lab.options("lab1")]) == 3
    assert loads == []
    for index, command in enumerate(started):
        assert command[1:3] == ["-m", "atoll_island_worker"]
        assert command[command.index("--name") + 1] == "lab1-" + "n" * 53 + f"-{index}"
        assert command[command.index("--processes") + 1] == "1"
        assert " ".join(lab.options("lab1")) in " ".join(command)
        assert "--parent" in command
        assert "--exit-reasons" in command
        assert 1700.0 < float(command[command.index("--lifetime") + 1]) <= 1800.0
        assert command[command.index("--grace") + 1] == "5"


def test_the_automatic_number_of_processes_is_said_with_its_reason(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], worked: list[tuple[str, str, float | None]]
) -> None:
    monkeypatch.setenv("SLURM_CPUS_PER_TASK", "1")
    assert cli.main(["--connect", "tcp/a:1"]) == 0
    assert len(worked) == 1
    assert "island-worker: 1 process: " in capsys.readouterr().err


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (UnreachableError("nobody there"), 3),
        (RefusedError("version 1 here, 2 there"), 2),
        (KeyboardInterrupt(), 130),
        (SystemExit(0), 0),
    ],
)
def test_the_way_the_work_ends_is_the_exit_code(
    error: BaseException, code: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(*_: object) -> int:
        raise error

    monkeypatch.setattr(worker_module, "run_worker", fail)
    assert cli.main(["--connect", "tcp/a:1", "--processes", "1"]) == code
    assert "Traceback" not in capsys.readouterr().err


def test_help_loads_nothing_heavy() -> None:
    script = (
        "import sys\nfrom atoll_island_worker.cli import main\nmain(['--help'])\n"
        "print(sorted({'numpy', 'zenoh', 'pydantic', 'numba', 'msgpack', 'logging'} & sys.modules.keys()))"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout.splitlines()[-1] == "[]"
    assert "exit codes" in done.stdout
    assert "--parent" not in done.stdout


def test_a_file_names_the_coordinator_and_comes_before_the_environment(
    worked: list[tuple[str, str, float | None]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ATOLL_CONNECT", "tcp/a:1")
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"tcp/127.0.0.1:{server.getsockname()[1]}"
        (tmp_path / "f").write_text(address)
        assert cli.main(["--connect-file", str(tmp_path / "f"), "--processes", "1", "--name", "w"]) == 0
    assert worked == [(address, "w", None)]


def test_a_long_name_of_a_host_keeps_the_certificate_in_front_and_the_process_behind() -> None:
    name = cli._worker_name("n" * 48, None)
    assert name.startswith("n" * 48 + "-")
    assert len(name) <= 58
    assert name.endswith(str(os.getpid())[-5:])


def test_a_name_that_is_not_the_certificates_is_refused(
    worked: list[tuple[str, str, float | None]], lab: Lab, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--connect", "tls/a:1", "--processes", "1", "--name", "lab2", *lab.options("lab1")]
    assert cli.main(words) == 2
    assert "--name must be lab1" in capsys.readouterr().err
    assert worked == []


def test_a_file_that_never_comes_ends_with_3(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["--connect-file", str(tmp_path / "f"), "--wait", "0.1"]) == 3
    assert "does not exist" in capsys.readouterr().err
