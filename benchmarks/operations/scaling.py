"""What more workers bring and cost: speed-up, time spent waiting for migrants, messages and bytes per epoch.

``python -m benchmarks.operations.scaling --workers 1,2 --seeds 0-4`` searches a system of Table III for a fixed number
of epochs (no target ends it) with each number of workers and each seed. Speed-up is the time of one worker over that of
several, the median over seeds; whatever their number, the digest of the result must be the same.

Efficiency compares two workers on one job with two independent services of one worker each, on the same job at the
same time: jobs a second of the former over those of the latter. It asks what the distribution costs, and leaves out
what two busy cores cost each other.

``--simulated-islands 16,64,256,512,1024`` measures something else: what a coordinator takes
(`benchmarks.operations.scale`).

An epoch, where messages are counted, is one of one archipelago. Only payloads count; heartbeats count by the second.
Returns 1 when a digest differs, else 0.
"""

import argparse
import statistics
import sys
import time
from argparse import Namespace
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final

from atoll.client.client import connected
from atoll.terminal.output import note, say, table
from atoll_core.config import PRESETS, JobConfig
from atoll_core.data.table import Table
from atoll_core.errors import AtollError
from benchmarks.harness.command_line import OUT, group, option, positive, program, seeds, seeds_of, whole
from benchmarks.harness.jobs import UNENDING, configured
from benchmarks.harness.record import Record, load
from benchmarks.harness.service import Searches, searching
from benchmarks.harness.systems import TABLE_III, table_of, trajectories
from benchmarks.harness.tables import Columns
from benchmarks.operations.scale import measure_scale
from benchmarks.operations.watching import Idleness, Load, counting, load_of

GOAL_WAITING: Final = 0.05
GOAL_EFFICIENCY: Final = 0.90
COUNTED_EPOCHS: Final = 4
"""Epochs in which messages are counted: their number does not vary much."""


@dataclass(frozen=True)
class Timing:
    """One search: `seconds` from the first epoch's start to the last one's end; `waiting` is a share of them."""

    workers: int
    seed: int
    seconds: float
    point_evaluations: int
    digest: str
    waiting: float | None


@dataclass(frozen=True)
class Round:
    """Two workers on one job, and two services of one worker on a job each, at once: seconds."""

    seed: int
    together: float
    apart: tuple[float, float]

    @property
    def efficiency(self) -> float:
        """Jobs a second of the two workers over those of the two services."""
        return (1.0 / self.together) / sum(1.0 / each for each in self.apart)


class Bench:
    """The searches of one benchmark: the same system, preset and number of epochs throughout."""

    def __init__(self, options: Namespace) -> None:
        self._options = options

    def _table(self, seed: int) -> Table:
        return table_of(trajectories(self._options.system, self._options.step, seed))

    def _config(self, seed: int, epochs: int) -> JobConfig:
        budget = {**UNENDING, "max_epochs": epochs, "max_time": self._options.max_time}
        only = self._options.only and tuple(self._options.only)
        return configured(seed, {"only": only}, budget, preset=self._options.preset)

    def timed(self, searches: Searches, workers: int, seed: int) -> Timing:
        """Search once, and watch how long the workers wait."""
        with connected(searches.address) as client:
            idleness = Idleness(tuple(worker.pid for worker in client.workers() if worker.state != "lost"))
        result = self._solved(searches, seed, idleness)
        note(f"  {workers} workers, seed {seed}: {result['search_seconds']:.2f} s")
        return Timing(
            workers, seed, result["search_seconds"], result["point_evaluations"], result["digest"], idleness.share()
        )

    def round(self, both: Searches, singles: Sequence[Searches], seed: int) -> Round:
        """Search with two workers, and twice at once with one worker each; with odd seeds the other way round."""
        if seed % 2:
            apart = self._apart(singles, seed)
            its = Round(seed, self._together(both, seed), apart)
        else:
            its = Round(seed, self._together(both, seed), self._apart(singles, seed))
        note(f"  seed {seed}: {its.together:.2f} s beside {its.apart[0]:.2f}, {its.apart[1]:.2f}: {its.efficiency:.1%}")
        return its

    def _together(self, both: Searches, seed: int) -> float:
        return float(self._solved(both, seed)["search_seconds"])

    def _apart(self, singles: Sequence[Searches], seed: int) -> tuple[float, float]:
        pool = ThreadPoolExecutor(len(singles))
        try:
            results = list(pool.map(lambda its: self._solved(its, seed), singles))
        finally:
            pool.shutdown(wait=False, cancel_futures=True)  # after an interrupt, the processes end and the threads too
        one, two = (float(result["search_seconds"]) for result in results)
        return one, two

    def counted(self, searches: Searches, workers: int, seed: int) -> Load:
        """Search for a few epochs and count what goes over the bus meanwhile."""
        with connected(searches.address) as client:
            cluster = client.greet()
        begun = time.monotonic()
        with counting(searches.address, cluster) as traffic:
            epochs = min(COUNTED_EPOCHS, self._options.epochs)
            result = searches.solve(f"{workers} workers, counted", self._table(seed), self._config(seed, epochs))
        return load_of(workers, traffic, epochs, len(result["equations"]), time.monotonic() - begun)

    def _solved(self, searches: Searches, seed: int, idleness: Idleness | None = None) -> dict[str, Any]:
        epochs = self._options.epochs
        watch = None if idleness is None else idleness.look
        name = f"{self._options.system} seed {seed}"
        result = searches.solve(name, self._table(seed), self._config(seed, epochs), watch)
        done = min(equation["epoch"] for equation in result["equations"])
        if done < epochs:
            raise AtollError(
                f"{name} ended after {done} of {epochs} epochs; raise --max-time, or ask for fewer --epochs"
            )
        return result


def speed_ups(timings: Sequence[Timing]) -> dict[int, float]:
    """Return, by number of workers, the median over seeds of the time of the fewest over its own."""
    fewest = min(its.workers for its in timings)
    base = {timing.seed: timing.seconds for timing in timings if timing.workers == fewest}
    numbers = sorted({its.workers for its in timings})
    return {
        number: statistics.median(base[its.seed] / its.seconds for its in timings if its.workers == number)
        for number in numbers
    }


def differing(timings: Sequence[Timing]) -> list[int]:
    """Return the seeds whose digest is not the same for every number of workers."""
    digests: dict[int, set[str]] = {}
    for timing in timings:
        digests.setdefault(timing.seed, set()).add(timing.digest)
    return sorted(seed for seed, different in digests.items() if len(different) > 1)


def timings_table(timings: Sequence[Timing], loads: Sequence[Load]) -> str:
    """Return one line for each number of workers: medians over seeds, and what goes over the bus."""
    bus = Columns(
        "migrant messages={migrant_messages:.1f} | KB={migrant_bytes:k.1f} | reports={report_messages:.1f} | "
        "KB={report_bytes:k.1f} | heartbeats/s={heartbeats:.1f} | KB/s={heartbeat_bytes:k.1f}"
    )
    speed_up, rows = speed_ups(timings), []
    for its in loads:
        mine = [timing for timing in timings if timing.workers == its.workers]
        waits = waiting(mine)
        seconds = statistics.median(each.seconds for each in mine)
        rate = statistics.median(each.point_evaluations / each.seconds for each in mine) / 1e6
        times = (f"{seconds:.2f}", f"{speed_up[its.workers]:.2f}", "-" if waits is None else f"{waits:.1%}")
        rows.append((str(its.workers), *times, f"{rate:.2f}", *bus.row(its)))
    return table(("workers", "s", "speed-up", "waiting", "M evaluations/s", *bus.heads), rows)


def waiting(timings: Sequence[Timing]) -> float | None:
    """Return the median share of waiting, None when it is not known."""
    known = [timing.waiting for timing in timings if timing.waiting is not None]
    return statistics.median(known) if known else None


@dataclass
class Findings:
    """All that was measured so far; written to `out` whenever something is added."""

    arguments: Sequence[str]
    out: Path | None
    timings: list[Timing] = field(default_factory=list)
    loads: list[Load] = field(default_factory=list)
    rounds: list[Round] = field(default_factory=list)

    def write(self) -> None:
        """Write the file anew."""
        figures = {
            "timings": [asdict(timing) for timing in self.timings],
            "loads": [asdict(its) for its in self.loads],
            "rounds": [{**asdict(its), "efficiency": its.efficiency} for its in self.rounds],
            "speed_up": speed_ups(self.timings),
            "seeds_that_differ": differing(self.timings),
        }
        Record("scaling", self.arguments, self.out).write(**figures)

    def show(self) -> None:
        """Print the table and the sentences below it."""
        say(timings_table(self.timings, self.loads))
        say(f"\nmessages and KB: for each epoch of an archipelago; goal for waiting with 2 workers: {GOAL_WAITING:.0%}")
        if self.rounds:
            efficiencies = [its.efficiency for its in self.rounds]
            each = ", ".join(f"{efficiency:.1%}" for efficiency in efficiencies)
            median = f"{statistics.median(efficiencies):.1%} in the median"
            say(f"2 workers beside two services of one worker: {median} ({each}); goal {GOAL_EFFICIENCY:.0%}")
        bad = differing(self.timings)
        same = f"digests of seeds {', '.join(map(str, bad))} DIFFER" if bad else "the same digests with every number"
        say(f"{same}; load {load():.1f}")


def _measure(bench: Bench, options: Namespace, findings: Findings) -> None:
    for workers in options.workers:
        with searching(workers) as searches:
            for seed in options.seeds:
                findings.timings.append(bench.timed(searches, workers, seed))
                findings.write()
            findings.loads.append(bench.counted(searches, workers, options.seeds[0]))
            findings.write()
    if options.no_efficiency:
        return
    with searching(2) as both, searching(1) as one, searching(1) as other:
        for seed in options.seeds:
            findings.rounds.append(bench.round(both, (one, other), seed))
            findings.write()


def _numbers(text: str) -> list[int]:
    numbers = sorted(set(seeds(text)))
    if numbers[0] < 1:
        raise argparse.ArgumentTypeError(f"at least 1 worker was expected, but {text!r} was given")
    return numbers


@program(
    "benchmarks.operations.scaling",
    __doc__,
    option("--workers", type=_numbers, default=[1, 2], help="numbers of workers, such as 1-4 (1,2)"),
    option("--system", choices=TABLE_III, default="predator_prey", help="what is searched (%(default)s)"),
    option(
        "--only", metavar="VARIABLE", action="append", help="repeat for several; default: all, as many archipelagos"
    ),
    option("--step", type=positive, default=0.1, help="sampling step (%(default)s)"),
    option("--preset", choices=PRESETS, default="default"),
    option("--epochs", type=whole, default=20, help="length of each search (%(default)s)"),
    seeds_of("0-4", "such as 0-4 (0-4); one round each"),
    option("--max-time", type=positive, default=600.0, metavar="SECONDS", help="limit of a search (%(default)g)"),
    option("--no-efficiency", action="store_true", help="leave out the two services side by side"),
    group(
        "what a coordinator takes, with workers whose islands only pretend",
        option("--simulated-islands", type=_numbers, metavar="16,64", help="numbers of islands"),
        option("--period", type=positive, default=1.0, help="seconds of an epoch (%(default)g)"),
        option("--seconds", type=positive, default=15.0, help="length of a measurement (%(default)g)"),
        option("--noise", type=float, default=0.0, help="of the data that reports are from (%(default)g)"),
    ),
    OUT,
)
def main(options: Namespace) -> int:
    """Measure and print; return 1 when a digest depends on the number of workers, else 0."""
    if options.simulated_islands:
        return measure_scale(options.simulated_islands, options, options.words)
    findings = Findings(options.words, options.out)
    _measure(Bench(options), options, findings)
    findings.show()
    return 1 if differing(findings.timings) else 0


if __name__ == "__main__":
    sys.exit(main())
