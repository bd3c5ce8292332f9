"""What a coordinator takes by number of islands, with workers whose islands only pretend (`simulated_islands`).

The coordinator is a real one in a process of its own; its processor time and memory are read from the system's
account. Islands are those of several jobs with several variables, as many of each as it takes; an archipelago has eight
islands and a worker, too, unless other numbers are asked for.
"""

import contextlib
import json
import math
import queue
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from atoll.client.client import Client
from atoll.terminal.output import note, say
from atoll_core.data.table import Table
from atoll_core.errors import AtollError, UnreachableError
from benchmarks.harness.accounts import processor_seconds, status
from benchmarks.harness.jobs import UNENDING, configured, table_of_columns
from benchmarks.harness.record import Record, load
from benchmarks.harness.service import COORDINATOR, Machines, running, wait_until
from benchmarks.harness.tables import Columns
from benchmarks.operations.island_samples import Samples, sampled

ISLANDS_OF_A_WORKER: Final = 8
MOST_JOBS: Final = 4
WORKERS_EACH: Final = 16
"""Workers of a process that pretends."""

ENDLESS: Final = {**UNENDING, "max_epochs": 1_000_000, "max_time": None}
"""The budget of a search that nothing ends."""

GOAL_ISLANDS: Final = 1000
SAMPLED_VARIABLES: Final = 2
"""Variables in the programs of the sampled reports."""

READY_LIMIT_S: Final = 180.0
LOOK_S: Final = 0.5
_ROWS: Final = 200


@dataclass(frozen=True)
class Load:
    """What a coordinator took with so many islands, in the mean over `seconds`.

    `cores`: processor time of its process over time, `loop`: that of its main thread; `resident`: bytes in memory at
    the end; `epochs`: of an island in a second; `wait_50`, `wait_99`: milliseconds between an island's epochs.
    """

    islands: int
    workers: int
    archipelagos: int
    seconds: float
    epochs: float
    reports: float
    mails: float
    mail_bytes: float
    report_bytes: float
    cores: float
    loop: float
    resident: int
    wait_50: float
    wait_99: float
    machine_load: float

    @property
    def microseconds(self) -> float:
        """Processor time of the coordinator for each epoch of an island."""
        return 1e6 * self.cores / (self.epochs * self.islands)

    @property
    def megabytes(self) -> float:
        """What workers put on the bus in a second."""
        return (self.mail_bytes + self.report_bytes) / 1e6


def shape(islands: int, each: int) -> tuple[int, int]:
    """Return how many jobs of how many variables give that many islands, with `each` in an archipelago.

    Raises AtollError when none do.
    """
    archipelagos = islands // each
    jobs = next((jobs for jobs in (1, 2, MOST_JOBS) if archipelagos / jobs <= 16), MOST_JOBS)
    if islands % (each * jobs) or not archipelagos:
        raise AtollError(f"{islands} islands cannot be simulated; ask for a multiple of {each * jobs}")
    return jobs, archipelagos // jobs


def signals(count: int) -> Table:
    """Return a table of `count` variables that move smoothly."""
    times = np.linspace(0.0, 10.0, _ROWS)
    values = {f"v{number}": np.sin((0.5 + 0.01 * number) * times + number) for number in range(count)}
    return table_of_columns({"t": times, **values}, "signals")


@dataclass(frozen=True)
class Account:
    """What a process has taken so far: seconds of processor time, those of its main thread, bytes in memory."""

    cpu_s: float
    loop_s: float
    resident: int
    at: float

    @classmethod
    def of(cls, pid: int) -> "Account":
        """Read the system's account of a process (Linux)."""
        return cls(processor_seconds(pid), processor_seconds(pid, pid), status(pid, "VmRSS"), time.monotonic())


class Hosts:
    """The processes that pretend, and what they count."""

    def __init__(self, processes: Sequence[subprocess.Popen[str]]) -> None:
        self._lines: queue.SimpleQueue[Mapping[str, Any]] = queue.SimpleQueue()
        for process in processes:
            threading.Thread(target=self._read, args=(process,), daemon=True).start()

    def _read(self, process: subprocess.Popen[str]) -> None:
        assert process.stdout is not None
        for line in process.stdout:
            self._lines.put(json.loads(line))

    def between(self, first: float, last: float) -> list[Mapping[str, Any]]:
        """Return the lines of the seconds that ended between two moments; the earlier ones are forgotten."""
        lines = []
        while not self._lines.empty():
            lines.append(self._lines.get())
        return [line for line in lines if first < line["at"] <= last]


def pretending(machines: Machines, samples: Path, workers: int, period: float) -> Hosts:
    """Start processes with so many workers altogether, which end with the others."""
    processes = []
    for first in range(0, workers, WORKERS_EACH):
        words = ["--connect", machines.address, "--samples", str(samples), "--period", str(period)]
        words += ["--first", str(first), "--workers", str(min(WORKERS_EACH, workers - first))]
        command = [sys.executable, "-m", "benchmarks.operations.simulated_islands", *words]
        processes.append(machines.start_program(f"host{first}", command))
    return Hosts(processes)


def measured(islands: int, samples: Samples, period: float, seconds: float, each: int, workers: int) -> Load:
    """Run that many islands for a while, once all are under way, and return what the coordinator took.

    An archipelago has `each` islands.
    """
    jobs, variables = shape(islands, each)
    with running(0) as (machines, client):
        hosts = pretending(machines, samples.save(machines.folder), workers, period)
        wait_until(client, lambda: _has(client, workers), f"{workers} workers were not there", READY_LIMIT_S, LOOK_S)
        names = [f"scale-{number}" for number in range(jobs)]
        digest = client.upload(signals(max(variables, SAMPLED_VARIABLES)).to_bytes())
        searched = {"only": tuple(f"v{number}" for number in range(variables))}
        for number, name in enumerate(names):
            client.submit(name, name, configured(number, searched, ENDLESS, islands=each), digest)
        late = f"all islands of {jobs} jobs in their third epoch were not there"
        wait_until(client, lambda: _are_under_way(client, names), late, READY_LIMIT_S, LOOK_S)
        note(f"  {islands} islands are under way")
        before = Account.of(machines.pid(COORDINATOR))
        client.pause(seconds)
        after = Account.of(machines.pid(COORDINATOR))
        client.pause(2.0)
        lines = hosts.between(before.at, after.at)
        for name in names:
            client.cancel(name)
    return load_of(islands, workers, jobs * variables, (before, after), lines)


def load_of(
    islands: int, workers: int, archipelagos: int, accounts: tuple[Account, Account], lines: Sequence[Mapping[str, Any]]
) -> Load:
    """Return the mean over a time between two accounts of a coordinator, with what its workers counted meanwhile."""
    before, after = accounts
    seconds = after.at - before.at
    epochs, *rates = (sum(line[name] for line in lines) / seconds for name in ("epochs", *_RATES))
    waits = np.array([wait for line in lines for wait in line["waits"]] or [math.nan])
    return Load(
        islands=islands,
        workers=workers,
        archipelagos=archipelagos,
        seconds=seconds,
        epochs=epochs / islands,
        **dict(zip(_RATES, rates, strict=True)),
        cores=(after.cpu_s - before.cpu_s) / seconds,
        loop=(after.loop_s - before.loop_s) / seconds,
        resident=after.resident,
        wait_50=float(np.percentile(waits, 50)),
        wait_99=float(np.percentile(waits, 99)),
        machine_load=load(),
    )


_RATES: Final = ("reports", "mails", "mail_bytes", "report_bytes")


def _has(client: Client, workers: int) -> bool:
    with contextlib.suppress(UnreachableError):  # while it places everything at once, it may not answer in time
        return len(client.workers()) == workers
    return False


def _are_under_way(client: Client, names: Sequence[str]) -> bool:
    with contextlib.suppress(UnreachableError):
        views = [client.status(name) for name in names]
        return all(view.variables and all(variable.epoch >= 2 for variable in view.variables) for view in views)
    return False


def loads_table(loads: Sequence[Load]) -> str:
    """Return one line for each number of islands."""
    return Columns(
        "islands | workers | archipelagos | epochs/s={epochs:.2f} | reports/s={reports:.0f} | "
        "migrant messages/s={mails:.0f} | MB/s={megabytes:.1f} | cores={cores:.3f} | of which loop={loop:.3f} | "
        "us per epoch={microseconds:.0f} | MB in memory={resident:B.0f} | wait ms median={wait_50:.1f} | "
        "99 %={wait_99:.0f} | load={machine_load:.1f}"
    ).table(loads)


def growth(loads: Sequence[Load]) -> float | None:
    """Return by which power of the number of islands the coordinator's processor time per second grows, fitted.

    The time is that for one epoch a second of every island. None with fewer than two numbers of islands.
    """
    if len({one.islands for one in loads}) < 2:
        return None
    sizes, times = zip(*((math.log(one.islands), math.log(one.cores / one.epochs)) for one in loads), strict=True)
    return statistics.linear_regression(sizes, times).slope


def measure_scale(islands: Sequence[int], options: Any, arguments: Sequence[str]) -> int:
    """Measure each number of islands and print; return 1 when a core does not hold `GOAL_ISLANDS`, else 0."""
    note("computing what real islands send")
    samples = sampled(options.noise)
    loads: list[Load] = []
    for number in islands:
        workers = options.simulated_workers or max(2, number // ISLANDS_OF_A_WORKER)
        loads.append(measured(number, samples, options.period, options.seconds, options.islands_each, workers))
        figures = {"loads": [{**asdict(load_), "microseconds": load_.microseconds} for load_ in loads]}
        Record("scale", arguments, options.out).write(**figures, growth=growth(loads))
    say(loads_table(loads))
    power = growth(loads)
    if power is not None:
        say(f"\nprocessor time grows with the number of islands to the power of {power:.2f}")
    held = 1e6 / loads[-1].microseconds
    say(f"a core holds {held:.0f} islands at one epoch a second (goal {GOAL_ISLANDS})")
    return 0 if held >= GOAL_ISLANDS else 1
