"""A campaign of many small tables by `atoll.discover_many`: seconds, memory, and what happens when it is killed.

``python -m benchmarks.operations.campaign --tables 100,1000,10000`` solves so many tables of 40 rows with the default
options: decay, logistic growth, oscillators and chains of two reactions, whose rates are drawn from the number of the
table. A program of its own reads them from a generator, and writes each result into a file as soon as it has it.

Memory is that of the calling process, of the task processes that compute, and of the other processes of the engine,
read at each per cent of the tables. Its growth by a table is the slope of a straight line through the values of the
second half, by least squares. Growth of seconds by number of tables is the slope in logarithms.

``--limit SECONDS`` ends a campaign after some time; its figures are those of the tables that were done.

With ``--killed`` the program is killed (SIGKILL) once when half of the tables are written, and started again: it
continues with the tables that the file lacks. The results must be those of a program that was not killed: compare the
digests.

Returns 1 when a table has no model, or the file does not have each table once, else 0.
"""

import ctypes
import hashlib
import json
import math
import os
import resource
import signal
import statistics
import subprocess
import sys
import time
from argparse import Namespace
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np

import atoll
from atoll.terminal.output import note, say
from atoll_core.errors import AtollError
from benchmarks.harness.accounts import status
from benchmarks.harness.command_line import OUT, option, positive, program, whole
from benchmarks.harness.record import Record, load
from benchmarks.harness.tables import Columns
from benchmarks.operations.engines import ENGINES, below, words_of

ROWS: Final = 40
LOOKS: Final = 100
"""Times that memory is read in a campaign."""

_SUBREAPER: Final = 36
"""PR_SET_CHILD_SUBREAPER of Linux: processes whose parent has ended become children of this process."""


@dataclass(frozen=True)
class Memory:
    """Bytes in memory (resident) when so many tables were done.

    `caller`: of the calling process; `computing`: of the task processes together; `others`: of the other processes of
    the engine together.
    """

    tables: int
    caller: int
    computing: int
    others: int

    @classmethod
    def of(cls, pid: int, tables: int) -> "Memory":
        """Read the memory of a campaign whose caller is the process `pid`."""
        computing = others = 0
        for child in below(pid):
            words = words_of(child)
            with suppress(OSError, AtollError):  # it has just ended
                size = status(child, "VmRSS")
                if b"atoll.tasks.process" in words:
                    computing += size
                else:
                    others += size
        return cls(tables, status(pid, "VmRSS"), computing, others)


@dataclass(frozen=True)
class Campaign:
    """One campaign: seconds until the last result, processor seconds of all its processes, memory.

    `caller_slope`, `computing_slope`, `others_slope`: growth of memory by a table, in bytes (nan with few tables);
    `wrong`: tables without a model, lacking, or written twice; `digest`: of all results by name.
    """

    engine: str
    tables: int
    is_killed: bool
    seconds: float
    processor: float
    first_s: float
    caller: int
    computing: int
    others: int
    caller_slope: float
    computing_slope: float
    others_slope: float
    wrong: int
    digest: str
    machine_load: float

    @property
    def each_ms(self) -> float:
        """Processor time of all processes for a table."""
        return 1e3 * self.processor / self.tables


# ------------------------------------------------------------------------------------------- the program that is killed


def tables_of(count: int) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield so many tables by name; the same number is always the same table."""
    times = np.linspace(0.0, 6.0, ROWS)
    for number in range(count):
        rate, size, other = np.random.default_rng(number).uniform(0.5, 2.0, 3)
        decay = size * np.exp(-rate * times)
        match number % 4:
            case 0:
                yield f"decay {number}", {"t": times, "x": decay}
            case 1:
                grown = other / (1.0 + (other / (0.1 * size) - 1.0) * np.exp(-rate * times))
                yield f"growth {number}", {"t": times, "x": grown}
            case 2:
                x, y = size * np.cos(rate * times), -size * np.sin(rate * times)
                yield f"oscillator {number}", {"t": times, "x": x, "y": y}
            case _:
                faster = rate + other
                product = size * rate / other * (np.exp(-rate * times) - np.exp(-faster * times))
                yield f"chain {number}", {"t": times, "x": decay, "y": product}


def complete_lines(file: Path) -> list[str]:
    """Return the lines of a file of results; a last line that a killed program did not complete is cut off."""
    if not file.exists():
        return []
    text = file.read_text("utf-8")
    complete = text[: text.rfind("\n") + 1]
    if complete != text:
        file.write_text(complete, "utf-8")
    return complete.splitlines()


def names_in(file: Path) -> list[str]:
    """Return the names of the tables that a file of results has."""
    return [json.loads(line)["name"] for line in complete_lines(file)]


def solve(engine: str, count: int, workers: int, file: Path) -> None:
    """Solve the tables that `file` lacks, and add each result to it."""
    known = set(names_in(file))
    missing = ((name, data) for name, data in tables_of(count) if name not in known)
    with ENGINES[engine]() as (executor, _), file.open("a", encoding="utf-8") as written:
        for name, found in atoll.discover_many(missing, executor=executor, workers=workers):
            result: dict[str, Any] = {"name": name, "error": str(found)}
            if isinstance(found, atoll.Model):
                equations = [equation.expression for equation in found.equations]
                result = {"name": name, "digest": found.result.digest, "equations": equations}
            written.write(json.dumps(result) + "\n")
            written.flush()
            say(str(name))


# ------------------------------------------------------------------------------------------------ the program around it


@dataclass
class Progress:
    """A campaign under way: the moments of its results, its memory now and then; `looked` is called after each look."""

    tables: int
    end: float
    looked: Callable[[list[Memory]], None]
    seconds: list[float] = field(default_factory=list)
    memory: list[Memory] = field(default_factory=list)

    def follow(self, command: Sequence[str], until: int) -> None:
        """Run a program until it ends, or until `until` tables are done or the time is over, and then kill it.

        Raises AtollError when the program fails.
        """
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert process.stdout is not None
        every = max(1, self.tables // LOOKS)
        for _ in process.stdout:
            self.seconds.append(time.monotonic())
            if len(self.seconds) % every == 0:
                self.memory.append(Memory.of(process.pid, len(self.seconds)))
                self.looked(self.memory)
            if len(self.seconds) >= until or time.monotonic() > self.end:
                process.send_signal(signal.SIGKILL)
                break
        process.wait()
        if process.returncode not in (0, -signal.SIGKILL):
            raise AtollError(f"the campaign failed with exit code {process.returncode}")


def slope(memory: Sequence[Memory], part: str) -> float:
    """Return by how many bytes the memory of some processes grows by a table, fitted to the second half."""
    late = memory[len(memory) // 2 :]
    if len(late) < 3:
        return math.nan
    return statistics.linear_regression([one.tables for one in late], [getattr(one, part) for one in late]).slope


def measured(options: Namespace, tables: int, looked: Callable[[list[Memory]], None]) -> Campaign:
    """Run one campaign."""
    with TemporaryDirectory(prefix="atoll-campaign-") as folder:
        file = Path(folder) / "results.jsonl"
        words = ["--once", "--tables", str(tables), "--workers", str(options.workers), "--results", str(file)]
        command = [sys.executable, "-m", __spec__.name, "--engine", options.engine, *words]
        before, began = _processor_s(), time.monotonic()
        progress = Progress(tables, began + (options.limit or math.inf), looked)
        if options.killed:
            progress.follow(command, tables // 2)
            note(f"  killed when {len(progress.seconds)} of {tables} tables were done")
            progress.memory.clear()
        progress.follow(command, 2 * tables)
        results = sorted(map(json.loads, complete_lines(file)), key=lambda result: str(result["name"]))
    with suppress(ChildProcessError):  # processes that end after their parents
        while True:
            os.wait()
    done, seconds = len(results), progress.seconds
    memory = progress.memory or [Memory(done, 0, 0, 0)]
    found = {result["name"] for result in results if "digest" in result}
    return Campaign(
        options.engine, done, options.killed, seconds[-1] - began, _processor_s() - before, seconds[0] - began,
        max(one.caller for one in memory), max(one.computing for one in memory), max(one.others for one in memory),
        slope(memory, "caller"), slope(memory, "computing"), slope(memory, "others"),
        (tables if options.limit is None else done) - len(found) + len(results) - len(found),
        hashlib.sha256(json.dumps(results, sort_keys=True).encode()).hexdigest(), load(),
    )  # fmt: skip


def _processor_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def growth(campaigns: Sequence[Campaign]) -> float | None:
    """Return by which power of the number of tables the processor seconds grow; None with one number."""
    if len({one.tables for one in campaigns}) < 2:
        return None
    sizes, times = zip(*((math.log(one.tables), math.log(one.processor)) for one in campaigns), strict=True)
    return statistics.linear_regression(sizes, times).slope


@program(
    "benchmarks.operations.campaign",
    __doc__,
    option("--tables", default="100", metavar="NUMBER,NUMBER", help="numbers of tables (%(default)s)"),
    option("--engine", choices=ENGINES, default="processes", help="what computes (%(default)s)"),
    option("--workers", type=whole, default=2, help="tables at the same time (%(default)s)"),
    option("--killed", action="store_true", help="kill the program when half of the tables are written"),
    option("--limit", type=positive, metavar="SECONDS", help="end a campaign after this time"),
    option("--once", action="store_true", help="solve the tables in this process"),
    option("--results", type=Path, help="the file that --once writes"),
    OUT,
)
def main(options: Namespace) -> int:
    """Measure and print; return 1 when a table is wrong, else 0."""
    numbers = [whole(number) for number in options.tables.split(",")]
    if options.once:
        solve(options.engine, numbers[0], options.workers, options.results)
        return 0
    ctypes.CDLL(None).prctl(_SUBREAPER, 1, 0, 0, 0)
    record, campaigns = Record("campaign", options.words, options.out), list[Campaign]()
    for number in numbers:
        campaigns.append(measured(options, number, lambda memory: record.write(memory=[asdict(one) for one in memory])))
        record.add(campaigns[-1])
        note(f"  {number} tables: {campaigns[-1].seconds:.0f} s, {campaigns[-1].each_ms:.0f} ms of processor each")
    say(
        Columns(
            "tables | s={seconds:.0f} | first after s={first_s:.1f} | processor s={processor:.0f} | "
            "ms of processor each={each_ms:.0f} | MB of the caller={caller:B.0f} | "
            "of task processes={computing:B.0f} | of others={others:B.0f} | "
            "bytes more by a table: caller={caller_slope:.0f} | "
            "task processes={computing_slope:.0f} | others={others_slope:.0f} | wrong | digest={digest:.12} | "
            "load={machine_load:.1f}"
        ).table(campaigns)
    )
    power = growth(campaigns)
    if power is not None:
        say(f"\nprocessor time grows with the number of tables to the power of {power:.2f}")
    record.write(growth=power)
    return 1 if any(one.wrong for one in campaigns) else 0


if __name__ == "__main__":
    sys.exit(main())
