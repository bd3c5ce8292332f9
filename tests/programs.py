"""The programs as processes: run to their end, or started, watched and ended with the test."""

import contextlib
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LIMIT_S = 200.0


def command(program: str, *arguments: str) -> list[str]:
    module = "atoll" if program == "coordinator" else f"atoll_{program}"
    return [sys.executable, "-m", module, *arguments]


def environment() -> dict[str, str]:
    kept = {name: value for name, value in os.environ.items() if name != "ATOLL_CONNECT"}
    return kept | {"PYTHONPATH": str(ROOT)}


def done(place: Path, program: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command(program, *arguments),
        cwd=place, env=environment(), capture_output=True, text=True, timeout=LIMIT_S, check=False,
    )  # fmt: skip


@contextlib.contextmanager
def started(place: Path, program: str, *arguments: str, keeps_log: bool = True) -> Iterator[subprocess.Popen[str]]:
    """Start a program; its log is a file in `place`, or else a pipe."""
    with (place / f"{program}.log").open("ab") if keeps_log else contextlib.nullcontext(subprocess.PIPE) as log:
        process = subprocess.Popen(
            command(program, *arguments), cwd=place, env=environment(), stdout=subprocess.PIPE, stderr=log, text=True,
            start_new_session=True,
        )  # fmt: skip
    with process:
        try:
            yield process
        finally:
            process.kill()


@contextlib.contextmanager
def serving(
    place: Path, state: str, listen: str = "tcp/127.0.0.1:0", *options: str
) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """Serve on a free port; yield the address that workers connect to."""
    with started(place, "coordinator", "serve", "--listen", listen, "--state", state, *options) as process:
        assert process.stdout is not None
        for line in process.stdout:
            if "island-worker --connect" in line:
                yield line.split()[-1], process
                return
        raise AssertionError("the coordinator never said how to start a worker")


def until(condition: Callable[[], object]) -> bool:
    """Ask again until the condition holds."""
    end = time.monotonic() + LIMIT_S
    while not condition():
        assert time.monotonic() < end, "it never came true"
        time.sleep(0.02)
    return True


def children(parent: int) -> list[int]:
    pids: list[int] = []
    for task in Path(f"/proc/{parent}/task").iterdir():
        with contextlib.suppress(OSError):
            pids += map(int, (task / "children").read_text().split())
    return pids


def is_gone(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] in "ZX"
    except (FileNotFoundError, ProcessLookupError):
        return True


def all_gone(pids: Sequence[int]) -> bool:
    return all(map(is_gone, pids))
