"""A large data set on its way to many workers: how long that takes, and the most memory that any process has.

``python -m benchmarks.operations.big_data --megabytes 50 --workers 8`` writes a file whose table takes as much, has
`coordinator submit` read and upload it, waits until every worker has loaded it and computes, and cancels the job. The
most memory that a process ever had is what the system says of it (Linux, ``VmHWM``); that of `submit` is what it says
at its end. Returns 1 when a process had more than 1 GB, else 0.
"""

import argparse
import os
import subprocess
import sys
import time
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
import polars

from atoll.client.client import Client
from atoll.terminal.output import say, table
from atoll_core.errors import AtollError
from atoll_core.wire.messages.views import FINAL_STATES
from benchmarks.harness.accounts import status
from benchmarks.harness.command_line import OUT, option, program, whole, workers
from benchmarks.harness.record import Record, load
from benchmarks.harness.service import COORDINATOR, Machines, running, wait_until

GOAL_BYTES: Final = 10**9
READY_LIMIT_S: Final = 600.0
LOAD_LIMIT_S: Final = 300.0
JOB: Final = "big"
PEAK: Final = "VmHWM"


def write_data(file: Path, megabytes: int, number_of_columns: int) -> int:
    """Write a table of so many megabytes as float64, and return its number of rows."""
    rows = megabytes * 1_000_000 // (8 * number_of_columns)
    place = np.arange(rows, dtype=np.float64)
    columns = [np.sin(place * (1e-3 + 1e-4 * number)) * (1.0 + number) for number in range(number_of_columns - 1)]
    columns.append(columns[0] * columns[1] + 0.5 * columns[2])
    names = [*(f"x{number}" for number in range(number_of_columns - 1)), "y"]
    polars.DataFrame(dict(zip(names, columns, strict=True))).write_csv(file)
    return rows


def submitted(machines: Machines, file: Path) -> int:
    """Submit by the command line, in a process of its own; return the most bytes that it had."""
    words = ["submit", str(file), "--target", "y", "--id", JOB, "--no-wait", "--connect", machines.address]
    with machines.log("submit").open("w") as log:
        process = subprocess.Popen([sys.executable, "-m", "atoll", *words], stdout=log, stderr=log)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise AtollError(f"submit ended with {process.returncode}: {machines.last_words('submit')[-300:]}")
    return usage.ru_maxrss * 1024


def wait_for(client: Client, workers: int, states: Sequence[str], limit_s: float) -> None:
    """Wait until so many workers are in one of the states; raises UnreachableError."""

    def are_there() -> bool:
        if sum(worker.state in states for worker in client.workers()) >= workers:
            return True
        view = client.status(JOB) if JOB in {view.job for view in client.jobs()} else None
        if view is not None and view.state in FINAL_STATES:
            raise AtollError(f"the job is {view.state} before all workers had its data: {view.reason}")
        return False

    wait_until(client, are_there, f"{workers} workers were not {' or '.join(states)}", limit_s)


def measured(megabytes: int, columns: int, workers: int) -> tuple[dict[str, int], float]:
    """Return the most bytes by process, and the seconds from the upload's start until all workers computed."""
    with running(workers) as (machines, client):
        wait_for(client, workers, ("ready",), READY_LIMIT_S)
        file = machines.folder / "big.csv"
        write_data(file, megabytes, columns)
        begun = time.monotonic()
        most = {"submit": submitted(machines, file)}
        wait_for(client, workers, ("computing", "waiting"), LOAD_LIMIT_S)
        client.pause(2.0)
        seconds = time.monotonic() - begun - 2.0
        most["coordinator"] = status(machines.pid(COORDINATOR), PEAK)
        most |= {f"worker {index}": status(machines.pid(name), PEAK) for index, name in enumerate(machines.workers)}
        client.cancel(JOB)
    return most, seconds


def columns(text: str) -> int:
    """Return a number of columns; raises ArgumentTypeError, because the last column is made of the first three."""
    number = int(text) if text.isdecimal() else 0
    if number < 4:
        raise argparse.ArgumentTypeError(f"at least 4 columns were expected, but {text!r} was given")
    return number


@program(
    "benchmarks.operations.big_data",
    __doc__,
    option("--megabytes", type=whole, default=50, help="size of the data set (%(default)s)"),
    option("--columns", type=columns, default=5, help="columns of the table, at least 4 (%(default)s)"),
    workers(8),
    OUT,
)
def main(options: Namespace) -> int:
    """Measure and print."""
    most, seconds = measured(options.megabytes, options.columns, options.workers)
    Record("big_data", options.words, options.out).write(most_bytes=most, until_all_compute_s=seconds)
    say(table(("process", "most MB in memory"), [(name, f"{size / 1e6:.0f}") for name, size in most.items()]))
    say(
        f"\n{options.megabytes} MB reached {options.workers} workers, which computed, {seconds:.1f} s after submit was "
        f"started; the most that a process had is {max(most.values()) / 1e6:.0f} MB (goal {GOAL_BYTES / 1e6:.0f}); "
        f"load {load():.1f}"
    )
    return 0 if max(most.values()) <= GOAL_BYTES else 1


if __name__ == "__main__":
    sys.exit(main())
