"""What each process does at a signal is what docs/operations.md says of it: exit codes, and who is left."""

import contextlib
import json
import re
import signal
import subprocess
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path

import pytest

from tests.programs import LIMIT_S, ROOT, all_gone, children, done, serving, started, until

DATA = str(ROOT / "examples" / "lynx_hare.csv")
ENDLESS = (
    DATA,
    "--time",
    "year",
    "--preset",
    "paper",
    "--target-error",
    "1e-300",
    "--max-epochs",
    "5000",
    "--seed",
    "1",
)
PAGE = (ROOT / "docs" / "operations.md").read_text("utf-8")
TABLE = PAGE.partition("## Signals and ends of programs")[2].partition("\n## ")[0]
ROWS = {
    cells[0]: cells
    for line in TABLE.splitlines()
    if line.startswith("| `") or line.startswith("| any") or line.startswith("| task")
    for cells in [[cell.strip() for cell in line.strip("|").split("|")]]
}
SLURM = "#!/bin/sh\nexit 0\n"

Begin = Callable[[Path, str], AbstractContextManager[subprocess.Popen[str]]]


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Return where a coordinator serves, in the folder of whose state is ``state``."""
    with serving(tmp_path_factory.mktemp("coordinator"), "state") as (place, _):
        yield place


@contextlib.contextmanager
def says(place: Path, words: str, program: str, *options: str) -> Iterator[subprocess.Popen[str]]:
    """Start a program and wait until it says something, on stdout or in its log."""
    with started(place, program, *options) as process:
        log = place / f"{program}.log"
        if words in ("start a worker with", "adapt keeps"):
            assert process.stdout is not None
            assert any(words in line for line in process.stdout), log.read_text()
        else:
            until(lambda: words in log.read_text() or process.poll() is not None)
        yield process


def serve(place: Path, address: str) -> AbstractContextManager[subprocess.Popen[str]]:
    return says(
        place,
        "start a worker with",
        "coordinator",
        "serve",
        "--listen",
        "tcp/127.0.0.1:0",
        "--state",
        str(place / "own"),
    )


@contextlib.contextmanager
def serve_with_limits(place: Path, address: str) -> Iterator[subprocess.Popen[str]]:
    (place / "limits.toml").write_text("[total]\nrunning = 2\n")
    words = ("serve", "--listen", "tcp/127.0.0.1:0", "--state", str(place / "own"), "--limits", "limits.toml")
    with says(place, "start a worker with", "coordinator", *words) as process:
        yield process


@contextlib.contextmanager
def standby(place: Path, address: str) -> Iterator[subprocess.Popen[str]]:
    (place / "first").mkdir()
    with serve(place / "first", address):
        words = ("serve", "--standby", "--listen", "tcp/127.0.0.1:0", "--state", str(place / "first" / "own"))
        with says(place, "on standby", "coordinator", *words) as process:
            yield process


def router(place: Path, address: str) -> AbstractContextManager[subprocess.Popen[str]]:
    return says(place, "start a worker with", "coordinator", "router", "--listen", "tcp/127.0.0.1:0")


@contextlib.contextmanager
def adapt(place: Path, address: str) -> Iterator[subprocess.Popen[str]]:
    """Start adapt with programs of Slurm's names that do nothing."""
    for name in ("sbatch", "squeue", "scancel"):
        (place / name).write_text(SLURM)
        (place / name).chmod(0o755)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PATH", str(place), prepend=":")
        with says(place, "adapt keeps", "coordinator", "adapt", "--maximum", "0", "--connect", address) as process:
            yield process


def run(place: Path, address: str) -> AbstractContextManager[subprocess.Popen[str]]:
    return says(place, "epoch", "coordinator", "run", *ENDLESS, "--workers", "1", "--out", "out")


def submit(place: Path, address: str) -> AbstractContextManager[subprocess.Popen[str]]:
    return says(place, "Ctrl-C detaches", "coordinator", "submit", *ENDLESS, "--connect", address)


def workers(place: Path, address: str) -> AbstractContextManager[subprocess.Popen[str]]:
    return says(place, "joined", "island_worker", "--connect", address, "--processes", "2")


def worker(place: Path, address: str) -> AbstractContextManager[subprocess.Popen[str]]:
    return says(place, "joined", "island_worker", "--connect", address, "--processes", "1")


PROCESSES: dict[str, Begin] = {
    "`coordinator run`": run,
    "`coordinator serve`": serve,
    "`coordinator serve` with `--limits` or `--roster`": serve_with_limits,
    "`coordinator serve --standby`, while it waits": standby,
    "`coordinator router`": router,
    "`coordinator adapt`": adapt,
    "`coordinator submit`, `coordinator status --follow`, `coordinator logs --follow`": submit,
    "`island-worker` of several processes": workers,
    "`island-worker` of one process, and each process of several": worker,
}
LONG = {serve_with_limits, run, submit, standby, router, worker}
CASES = [
    pytest.param(name, number, id=f"{begin.__name__}-{number.name}", marks=[pytest.mark.slow] * is_slow)
    for name, begin in PROCESSES.items()
    for number in (signal.SIGTERM, signal.SIGINT)
    for is_slow in [begin in LONG or number == signal.SIGINT]
]


def test_every_row_of_the_table_is_tried_or_known_here() -> None:
    elsewhere = {
        "`coordinator backup`, `coordinator restore`",
        "any other command of `coordinator`",
        "task process of an `island-worker`, and the process that forks these",  # unit/island_worker/tasks
    }
    assert set(ROWS) == set(PROCESSES) | elsewhere


def expected_code(name: str, number: signal.Signals) -> int:
    """Return the exit code after one signal, as the last column says it: ``0; 130 after SIGINT`` or ``130``."""
    first, _, then = ROWS[name][4].partition("; ")
    special = re.fullmatch(r"(\d+) after SIGINT", then)
    return int(special[1]) if special and number == signal.SIGINT else int(first)


@pytest.mark.parametrize(("name", "number"), CASES)
def test_a_signal_ends_each_process_with_the_code_of_the_table(
    name: str, number: signal.Signals, address: str, tmp_path: Path
) -> None:
    with PROCESSES[name](tmp_path, address) as process:
        assert process.poll() is None
        left = children(process.pid)
        process.send_signal(number)
        assert process.wait(LIMIT_S) == expected_code(name, number)
        until(lambda: all_gone(left))
    if name == "`coordinator run`":
        assert (tmp_path / "out" / "result.json").exists(), "the best equations are kept"
    if PROCESSES[name] is submit:
        (job,) = json.loads(done(tmp_path, "coordinator", "status", "--json", "--connect", address).stdout)
        assert job["state"] in ("queued", "preparing", "running"), "the job goes on"
        assert done(tmp_path, "coordinator", "cancel", job["job"], "--connect", address).returncode == 0


def test_a_hang_up_has_a_coordinator_read_its_limits_again_and_ends_nothing(tmp_path: Path) -> None:
    log = tmp_path / "coordinator.log"
    with serve_with_limits(tmp_path, "") as process:
        process.send_signal(signal.SIGHUP)
        until(lambda: "limits and roster were read again" in log.read_text())
        (tmp_path / "limits.toml").write_text("[total]\nrunning = none\n")
        process.send_signal(signal.SIGHUP)
        until(lambda: "the old ones stay in force" in log.read_text())
        assert process.poll() is None
        process.send_signal(signal.SIGTERM)
        assert process.wait(LIMIT_S) == 0
