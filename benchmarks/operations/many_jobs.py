"""What a coordinator with thousands of stored jobs takes: its start, its memory, and each question of a client.

A store is filled with jobs that have ended, each with a result of the usual size and some of megabytes, a table, a
dataset and events. A real `serve` is started on it and asked by a real client over the network of this machine; beside
the client's time stands the longest time that the coordinator's loop spent on one event meanwhile.
"""

import hashlib
import itertools
import json
import sqlite3
import statistics
import sys
import time
from argparse import Namespace
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from atoll.client.client import Client, connected
from atoll.terminal.output import note, say
from atoll_coordinator.service.store import events, jobs
from atoll_coordinator.service.store.events import EventRecord
from atoll_coordinator.service.store.jobs import JobRecord
from atoll_coordinator.service.store.store import Store
from atoll_core.config import JobConfig
from atoll_core.signals import raising_interrupts
from benchmarks.harness.accounts import processor_seconds, status
from benchmarks.harness.command_line import OUT, option, program, whole
from benchmarks.harness.record import Record, load
from benchmarks.harness.service import CONNECT_LIMIT_S, COORDINATOR, TIED_COORDINATOR, Machines
from benchmarks.harness.tables import Columns

GOAL_MS: Final = 50.0
GOAL_START_S: Final = 2.0
RESULT_BYTES: Final = 60_000
"""Of a usual result: that of the hares and lynxes has so many."""

LARGE_BYTES: Final = 4_000_000
LARGE_EACH: Final = 500
"""Every so many jobs, one has a result of `LARGE_BYTES`."""

_BATCH: Final = 500
_STATES: Final = ("done", "done", "failed", "cancelled")

TIMED_COORDINATOR: Final = (
    """
import json, os, time
from atoll_coordinator.service.service_loop import Service
_step, _worst = Service.step, {}
def step(self, event):
    began = time.perf_counter()
    try:
        _step(self, event)
    finally:
        name, seconds = type(event).__name__, time.perf_counter() - began
        if not os.path.exists(FILE):
            _worst.clear()
        if seconds > _worst.get(name, 0.0):
            _worst[name] = seconds
            with open(FILE + "-", "w") as file:
                json.dump(_worst, file)
            os.replace(FILE + "-", FILE)
Service.step = step
"""
    + TIED_COORDINATOR
)
"""The coordinator's program, which writes into FILE how long its loop took at most over an event of each kind."""


@dataclass(frozen=True)
class Answered:
    """How long a question took at the client, in milliseconds, and the loop's longest time over one event meanwhile."""

    question: str
    asked: int
    median_ms: float
    worst_ms: float
    loop_ms: float


def filled(folder: Path, number: int) -> None:
    """Make a store of `number` ended jobs in `folder`."""
    spec = JobConfig().model_dump_json()
    with Store.open(folder) as store:
        for first in range(0, number, _BATCH):
            with store._transaction() as sql:  # one for many, or filling would take an hour
                for index in range(first, min(first + _BATCH, number)):
                    _add(sql, index, spec)


def _add(sql: sqlite3.Connection, index: int, spec: str) -> None:
    job, table, dataset = f"job-{index:06d}", f"table {index}".encode() * 20, f"dataset {index}".encode() * 20
    digests = [hashlib.sha256(data).hexdigest() for data in (table, dataset)]
    for digest, data in zip(digests, (table, dataset), strict=True):
        sql.execute("INSERT OR IGNORE INTO blobs VALUES (?, ?, 1)", (digest, len(data)))
        sql.execute("INSERT OR IGNORE INTO chunks VALUES (?, 0, ?)", (digest, data))
    state = _STATES[index % len(_STATES)]
    record = JobRecord(job, f"job {index}", spec, digests[0], _time(index), "running", dataset_digest=digests[1])
    jobs.add(sql, record)
    size = LARGE_BYTES if index % LARGE_EACH == 0 else RESULT_BYTES
    jobs.end(sql, job, state, _result(index, size), None, _time(index))
    told = [EventRecord(job, _time(index), kind, json.dumps({"text": kind})) for kind in ("submitted", "placed", state)]
    events.add(sql, told)


def _time(index: int) -> str:
    return f"2026-01-01T00:00:00.{index % 1000:03d}Z"


def _result(index: int, size: int) -> str:
    """Return JSON of about so many bytes with what a list shows of a result, and numbers as a simulation has them."""
    equation = {
        "variable": "x", "lhs": "dx/dt", "epoch": 8, "error": 0.1, "normalized_error": 0.1, "complexity": 5,
        "expression": "0.5*x - x*y", "converged": True, "why": "target", "verdict": "good", "point_evaluations": 10**6,
    }  # fmt: skip
    head = json.dumps({"warnings": [], "point_evaluations": 10**6, "equations": [equation], "job": index})
    return f'{head[:-1]}, "rows": [{_rows(size // 8)}]}}'


@cache
def _rows(number: int) -> str:
    return ", ".join(f"{0.001 * row:.4f}" for row in range(number))


def measured(questions: dict[str, Callable[[], object]], times: int, loop: Path) -> list[Answered]:
    """Ask each question so many times."""
    answers = []
    for name, ask in questions.items():
        loop.unlink(missing_ok=True)
        seconds = []
        for _ in range(times):
            began = time.perf_counter()
            ask()
            seconds.append(time.perf_counter() - began)
        answers.append(
            Answered(name, times, 1e3 * statistics.median(seconds), 1e3 * max(seconds), 1e3 * _longest(loop))
        )
        note(f"  {name}: {answers[-1].median_ms:.1f} ms")
    return answers


def _longest(file: Path) -> float:
    """Return the longest time that the loop has said since its file was removed."""
    return max(json.loads(file.read_text()).values(), default=0.0) if file.exists() else 0.0


def questions_of(client: Client, address: str, number: int, burst: Path) -> dict[str, Callable[[], object]]:
    """Return what is asked, by name. `burst` is a table that jobs to be cancelled are made of."""
    last, middle = f"job-{number - 1:06d}", f"job-{number // 2 + 1:06d}"
    table = client.upload(burst.read_bytes())

    def ping() -> None:
        with connected(address, CONNECT_LIMIT_S):
            pass

    def submit() -> None:
        client.submit(f"{mark}-{next(submitted)}", "to be cancelled", JobConfig(), table)

    def cancel() -> None:
        client.cancel(f"{mark}-{next(cancelled)}")

    submitted, cancelled, mark = itertools.count(), itertools.count(), f"cancelled-{time.time_ns()}"
    return {
        "greeting (ping, connected)": lambda: client.greet(),
        "ping with a connection of its own": ping,
        "status of an ended job": lambda: client.status(middle),
        "status of what is under way": lambda: client.jobs(is_open=True),
        "last page of 20 jobs": lambda: client.jobs(last=20),
        "last page of 100 jobs": lambda: client.jobs(last=100),
        "jobs by the beginning of their ids": lambda: client.jobs("job-00", last=100),
        "the id of a job": lambda: client.resolve(last),
        "events of a job": lambda: client.events(middle),
        "a usual result": lambda: client.result(middle),
        "a large result": lambda: client.result("job-000000"),
        "submit": submit,
        "cancel": cancel,
    }


@program(
    "benchmarks.operations.many_jobs",
    __doc__,
    option("--jobs", type=whole, default=20_000, help="jobs in the store (%(default)s)"),
    option("--times", type=whole, default=20, help="how often each question is asked (%(default)s)"),
    option("--state", type=Path, help="a store that is kept and used again"),
    OUT,
)
def main(options: Namespace) -> int:
    """Measure and print; return 1 where a figure misses its goal, else 0."""
    record = Record("many_jobs", options.words, options.out)
    with raising_interrupts(), TemporaryDirectory(prefix="atoll-benchmark-") as made:
        folder = options.state or Path(made)
        loop = Path(made) / "loop.json"
        if not (folder / "state").exists():
            note(f"filling a store with {options.jobs} jobs")
            filled(folder / "state", options.jobs)
        machines = Machines(folder, 0, coordinator=TIMED_COORDINATOR.replace("FILE", repr(str(loop))))
        try:
            began = time.monotonic()
            machines.open()
            start_s = time.monotonic() - began
            pid = machines.pid(COORDINATOR)
            resident, start_cpu_s = status(pid, "VmRSS"), processor_seconds(pid)
            with connected(machines.address, CONNECT_LIMIT_S) as client:
                table = Path(made) / "table.csv"
                table.write_text("t,x\n" + "\n".join(f"{t},{t * t}" for t in range(50)))
                answers = measured(questions_of(client, machines.address, options.jobs, table), options.times, loop)
            after = status(pid, "VmRSS")
        finally:
            machines.close()
    size = (folder / "state" / "atoll.sqlite3").stat().st_size if options.state else 0
    say(
        Columns(
            "question | asked={asked} | median ms={median_ms:.1f} | longest={worst_ms:.1f} | "
            "longest of the loop={loop_ms:.1f}"
        ).table(answers)
    )
    say(
        f"\nstart {start_s:.2f} s (goal {GOAL_START_S:g}), {start_cpu_s:.2f} s of processor time; in memory "
        f"{resident / 1e6:.0f} MB after the start, "
        f"{after / 1e6:.0f} MB at the end; store {size / 1e9:.2f} GB; load {load():.1f}"
    )
    record.write(
        answers=[asdict(one) for one in answers],
        start_s=start_s,
        start_cpu_s=start_cpu_s,
        resident=resident,
        store_bytes=size,
    )
    bad = [one.question for one in answers if "large" not in one.question and one.median_ms > GOAL_MS]
    return 1 if bad or start_s > GOAL_START_S else 0


if __name__ == "__main__":
    sys.exit(main())
