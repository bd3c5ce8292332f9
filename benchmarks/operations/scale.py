"""What a coordinator takes by number of islands, with workers whose islands only pretend (`simulated_islands`).

The coordinator is a real one in a process of its own; its processor time and memory are read from the system's
account. Islands are those of several jobs with several variables, as many of each as it takes; an archipelago has eight
islands and a worker, too, unless other numbers are asked for.
"""

import contextlib
import itertools
import json
import math
import queue
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from atoll.api.tables import table_of as atoll_table
from atoll.client.client import Client
from atoll.terminal.output import note, say
from atoll_core.config import JobConfig
from atoll_core.data.table import Table
from atoll_core.errors import AtollError, UnreachableError
from benchmarks.harness.accounts import processor_seconds, status
from benchmarks.harness.jobs import UNENDING, configured, table_of_columns
from benchmarks.harness.record import Record, load
from benchmarks.harness.service import COORDINATOR, Machines, running, wait_until
from benchmarks.harness.systems import table_of
from benchmarks.harness.tables import Columns
from benchmarks.many.systems import lorenz96
from benchmarks.many.systems import sampled as sampled_system
from benchmarks.operations.island_samples import Samples, epoch_seconds, sampled

ISLANDS_OF_A_WORKER: Final = 8
MOST_JOBS: Final = 4
WORKERS_EACH: Final = 16
"""Workers of a process that pretends."""

ENDLESS: Final = {**UNENDING, "max_epochs": 1_000_000, "max_time": None}
"""The budget of a search that nothing ends."""

GOAL_ISLANDS: Final = 1000
SAMPLED_VARIABLES: Final = 2
"""Variables in the programs of the sampled reports."""

READY_LIMIT_S: Final = 300.0
LOOK_S: Final = 0.5
MEASURED_EPOCHS: Final = 64
_ROWS: Final = 200
EXAMPLE: Final = Path(__file__).resolve().parents[2] / "examples" / "lotka_volterra.csv"


@dataclass(frozen=True)
class Load:
    """What a coordinator took with so many islands, in the mean over `seconds`.

    `cores`: processor time of its process over time, `loop`: that of its main thread; `resident`: bytes in memory at
    the end; `epochs`: of an island in a second; `wait_50`, `wait_99`: milliseconds between an island's epochs.

    With measured times of epochs, which may be made `slower`: `efficiency`, the share of the time in which workers
    compute; `late_ms`, the longest delay of a slice by a lack of processors here; `worker_ms`, processor time of a
    simulated worker for an epoch of an island, which a real worker needs besides computing.
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
    slower: float = 1.0
    efficiency: float = math.nan
    late_ms: float = math.nan
    worker_ms: float = math.nan

    @property
    def rate(self) -> float:
        """Epochs of all islands in a second, if epochs were not made slower."""
        return self.epochs * self.islands * self.slower

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


def pretending(
    machines: Machines, samples: Path, workers: int, period: float, times: Sequence[float], slower: float
) -> Hosts:
    """Start processes with so many workers altogether, which end with the others."""
    processes = []
    more = []
    if times:
        file = machines.folder / "epoch-times.json"
        file.write_text(json.dumps(times), "utf-8")
        more = ["--epoch-times", str(file), "--slower", str(slower)]
    for first in range(0, workers, WORKERS_EACH):
        words = ["--connect", machines.address, "--samples", str(samples), "--period", str(period)]
        words += ["--first", str(first), "--workers", str(min(WORKERS_EACH, workers - first))]
        command = [sys.executable, "-m", "benchmarks.operations.simulated_islands", *words, *more]
        processes.append(machines.start_program(f"host{first}", command))
    return Hosts(processes)


def measured(  # noqa: PLR0913  # the options of the command line
    islands: int, samples: Samples, period: float, seconds: float, each: int, workers: int,
    times: Sequence[float] = (), slower: float = 1.0,
) -> Load:  # fmt: skip
    """Run that many islands for a while, once all are under way, and return what the coordinator took.

    An archipelago has `each` islands. `times` are seconds of epochs, from which those of islands are drawn and then
    made `slower`; then the measurement lasts for two epochs at least.
    """
    if times:
        seconds = max(seconds, 2.0 * slower * statistics.fmean(times) * islands / workers)
    jobs, variables = shape(islands, each)
    with running(0) as (machines, client):
        hosts = pretending(machines, samples.save(machines.folder), workers, period, times, slower)
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
    load_ = load_of(islands, workers, jobs * variables, (before, after), lines)
    if not times:
        return load_
    busy, delays, processor = ([line[name] for line in lines] for name in ("busy_s", "late_ms", "processor_s"))
    done = sum(line["epochs"] for line in lines)
    efficiency = sum(busy) / (workers * load_.seconds)
    return replace(
        load_, slower=slower, efficiency=efficiency, late_ms=max(delays), worker_ms=1e3 * sum(processor) / max(1, done)
    )


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


TABLES: Final[Mapping[str, Callable[[], Table]]] = {
    "example": lambda: atoll_table(EXAMPLE, JobConfig().data),
    "lorenz96-5": lambda: table_of(sampled_system(lorenz96(5), 1)[0]),
}
"""Tables whose epochs are measured: two states, and five states."""


def measured_times(name: str, islands: int) -> list[float]:
    """Return processor seconds of epochs of a table: second epochs, in an archipelago of so many islands."""
    _, seconds = epoch_seconds(TABLES[name](), islands, MEASURED_EPOCHS)
    seconds = seconds[1:]  # the first one computes the reshuffle, which all islands of a worker share
    low, high = np.percentile(seconds, [5, 95])
    mean = statistics.fmean(seconds)
    note(f"an epoch of {name} takes {1e3 * mean:.1f} ms (5 to 95 %: {1e3 * low:.1f} to {1e3 * high:.1f} ms)")
    return seconds


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
        "99 %={wait_99:.0f} | slower={slower:g} | epochs/s at full speed={rate:.0f} | efficiency={efficiency:.2f} | "
        "ms of a worker={worker_ms:.1f} | late ms={late_ms:.0f} | load={machine_load:.1f}"
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
    times = measured_times(options.epoch_times, options.islands_each) if options.epoch_times else []
    loads: list[Load] = []
    each = options.islands_each
    for number, wanted in itertools.product(islands, options.simulated_workers or [0]):
        workers = wanted or max(2, number // ISLANDS_OF_A_WORKER)
        slower = max(1.0, workers / (statistics.fmean(times) * options.rate)) if times else 1.0
        try:
            loads.append(measured(number, samples, options.period, options.seconds, each, workers, times, slower))
        except UnreachableError as error:  # on a machine that other programs keep busy
            note(f"  {number} islands on {workers} workers were not measured: {error}")
            continue
        figures = {"loads": [{**asdict(load_), "microseconds": load_.microseconds} for load_ in loads]}
        Record("scale", arguments, options.out).write(**figures, growth=growth(loads))
    say(loads_table(loads))
    power = growth(loads)
    if power is not None:
        say(f"\nprocessor time grows with the number of islands to the power of {power:.2f}")
    held = 1e6 / loads[-1].microseconds
    say(f"a core holds {held:.0f} islands at one epoch a second (goal {GOAL_ISLANDS})")
    return 0 if held >= GOAL_ISLANDS else 1
