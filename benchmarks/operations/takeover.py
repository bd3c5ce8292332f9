"""How long a service is away when its coordinator dies or hangs and another is on standby, and what a copy costs.

``python -m benchmarks.operations.takeover --repetitions 5`` starts two coordinators over one store, kills the one that
serves (or, with ``--hang``, stops it), and takes the time until the other answers a greeting. With ``--megabytes 500``
it copies a store of that size instead, while ten commits of 50 kB come a second, as of ten islands, and compares how
long these take with and without the copy. Returns 1 when a copy is damaged, else 0.
"""

import os
import signal
import socket
import statistics
import subprocess
import sys
import threading
import time
from argparse import Namespace
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from atoll.client.client import connected
from atoll.terminal.output import say
from atoll_coordinator.service.store.backup import back_up
from atoll_coordinator.service.store.jobs import JobRecord
from atoll_coordinator.service.store.store import Store
from atoll_core.errors import AtollError
from benchmarks.harness.command_line import option, program, whole

COMMIT_BYTES: Final = 50_000
PAUSE_S: Final = 0.1
ANSWER_LIMIT_S: Final = 60.0


def _free_address() -> str:
    with socket.create_server(("127.0.0.1", 0)) as probe:
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


@contextmanager
def _serving(state: Path, *further: str) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """Start a coordinator; yield its address and process."""
    address = _free_address()
    words = ["serve", "--listen", address, "--state", str(state), "--standby", *further]
    with (state.parent / "log").open("ab") as log:
        process = subprocess.Popen([sys.executable, "-m", "atoll", *words], stdout=log, stderr=log)
    try:
        yield address, process
    finally:
        process.kill()
        process.wait()


def _answer(address: str) -> None:
    with connected(address, ANSWER_LIMIT_S):
        pass


def away_s(number: signal.Signals) -> float:
    """Return for how many seconds nobody answers, when the coordinator that serves gets a signal."""
    with TemporaryDirectory() as folder, _serving(Path(folder) / "state") as (first, process):
        _answer(first)
        with _serving(Path(folder) / "state") as (second, _):
            while "on standby" not in (Path(folder) / "log").read_text():
                time.sleep(0.1)
            time.sleep(2.0)  # it loads what it needs meanwhile
            began = time.monotonic()
            process.send_signal(number)
            _answer(second)
            return time.monotonic() - began


def commits(store: Store, seconds: float, prefix: str) -> list[float]:
    """Commit ten jobs a second for so long; return how long each took."""
    took: list[float] = []
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        began = time.monotonic()
        store.add_job(JobRecord(f"{prefix}{len(took)}", "", "x" * COMMIT_BYTES, "", ""))
        took.append(time.monotonic() - began)
        time.sleep(PAUSE_S)
    return took


def copied(megabytes: int) -> int:
    """Copy a store while commits come; say what it costs these. Return 1 when the copy is damaged."""
    with TemporaryDirectory(dir=os.environ.get("TMPDIR")) as folder, Store.open(Path(folder) / "state") as store:
        for number in range(megabytes):
            store.add_job(JobRecord(f"j{number}", "", "y" * 1_000_000, "", ""))
        alone = commits(store, 10.0, "a")
        ended: list[float | AtollError] = []

        def copy() -> None:
            began = time.monotonic()
            try:
                back_up(Path(folder) / "state", Path(folder) / "copy")
                ended.append(time.monotonic() - began)
            except AtollError as error:
                ended.append(error)

        copying = threading.Thread(target=copy)
        copying.start()
        beside: list[float] = []
        while copying.is_alive():
            beside += commits(store, 0.5, f"b{len(beside)}-")
        copying.join()
        for name, took in (("alone", alone), ("beside the copy", beside)):
            worst, median = 1000 * max(took), 1000 * statistics.median(took)
            say(f"commits {name}: {len(took)}, median {median:.1f} ms, worst {worst:.0f} ms")
        say(f"the copy of {megabytes} MB: {ended[0]}" + (" s" if isinstance(ended[0], float) else ""))
        return int(not isinstance(ended[0], float))


@program(
    "benchmarks.operations.takeover",
    __doc__,
    option("--repetitions", type=whole, default=5, help="how often (default: 5)"),
    option("--hang", action="store_true", help="stop the coordinator in place of killing it"),
    option("--megabytes", type=whole, help="copy a store of this size instead"),
)
def main(options: Namespace) -> int:
    """Measure one or the other."""
    if options.megabytes is not None:
        return copied(options.megabytes)
    number = signal.SIGSTOP if options.hang else signal.SIGKILL
    times = []
    for _ in range(options.repetitions):
        times.append(away_s(number))
        say(f"{number.name}: {times[-1]:.2f} s")
    say(f"median {statistics.median(times):.2f} s, longest {max(times):.2f} s, of {len(times)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
