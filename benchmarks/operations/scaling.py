"""What more workers bring: the same searches with several numbers of workers, their times and digests.

``python -m benchmarks.operations.scaling --workers 1,2 --seeds 0-4`` searches a system of Table III for a fixed number
of epochs (no target ends it) with each number of workers and each seed. Speed-up is the time of the fewest workers over
that of several, the median over seeds; whatever their number, the digest of the result must be the same.

``--simulated-islands 16,64,256,512,1024`` measures something else: what a coordinator takes
(`benchmarks.operations.scale`).

Returns 1 when a digest differs, else 0.
"""

import argparse
import statistics
import sys
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import dataclass

from atoll.terminal.output import note, say, table
from atoll_core.config import PRESETS
from atoll_core.errors import AtollError
from benchmarks.harness.command_line import OUT, group, option, positive, program, seeds, seeds_of, whole
from benchmarks.harness.jobs import UNENDING, configured
from benchmarks.harness.record import Record, load
from benchmarks.harness.service import Searches, searching
from benchmarks.harness.systems import TABLE_III, table_of, trajectories
from benchmarks.harness.tables import grouped
from benchmarks.operations.scale import TABLES, measure_scale


@dataclass(frozen=True)
class Timing:
    """One search: `seconds` from the first epoch's start to the last one's end."""

    workers: int
    seed: int
    seconds: float
    point_evaluations: int
    digest: str


def timed(searches: Searches, workers: int, seed: int, options: Namespace) -> Timing:
    """Search once; raises AtollError where the time does not suffice for all epochs."""
    budget = {**UNENDING, "max_epochs": options.epochs, "max_time": options.max_time}
    config = configured(seed, {"only": options.only and tuple(options.only)}, budget, preset=options.preset)
    name = f"{options.system} seed {seed}"
    result = searches.solve(name, table_of(trajectories(options.system, options.step, seed)), config)
    done = min(equation["epoch"] for equation in result["equations"])
    if done < options.epochs:
        raise AtollError(
            f"{name} ended after {done} of {options.epochs} epochs; raise --max-time, or ask for fewer --epochs"
        )
    note(f"  {workers} workers, seed {seed}: {result['search_seconds']:.2f} s")
    return Timing(workers, seed, result["search_seconds"], result["point_evaluations"], result["digest"])


def speed_ups(timings: Sequence[Timing]) -> dict[int, float]:
    """Return, by number of workers, the median over seeds of the time of the fewest over its own."""
    by_workers = grouped(timings, lambda timing: timing.workers)
    base = {timing.seed: timing.seconds for timing in by_workers[min(by_workers)]}
    return {
        workers: statistics.median(base[timing.seed] / timing.seconds for timing in by_workers[workers])
        for workers in sorted(by_workers)
    }


def differing(timings: Sequence[Timing]) -> list[int]:
    """Return the seeds whose digest is not the same for every number of workers."""
    by_seed = grouped(timings, lambda timing: timing.seed)
    return sorted(seed for seed, searched in by_seed.items() if len({timing.digest for timing in searched}) > 1)


def timings_table(timings: Sequence[Timing]) -> str:
    """Return one line for each number of workers: medians over seeds."""
    rows = []
    by_workers = grouped(timings, lambda timing: timing.workers)
    for workers, speed_up in speed_ups(timings).items():
        seconds = statistics.median(timing.seconds for timing in by_workers[workers])
        rate = statistics.median(timing.point_evaluations / timing.seconds for timing in by_workers[workers])
        rows.append((str(workers), f"{seconds:.2f}", f"{speed_up:.2f}", f"{rate / 1e6:.2f}"))
    return table(("workers", "s", "speed-up", "M evaluations/s"), rows)


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
    seeds_of("0-4", "such as 0-4 (0-4)"),
    option("--max-time", type=positive, default=600.0, metavar="SECONDS", help="limit of a search (%(default)g)"),
    group(
        "what a coordinator takes, with workers whose islands only pretend",
        option("--simulated-islands", type=_numbers, metavar="16,64", help="numbers of islands"),
        option("--islands-each", type=whole, default=8, metavar="ISLANDS", help="of an archipelago (%(default)s)"),
        option("--simulated-workers", type=_numbers, metavar="1,2,4", help="(one for eight islands)"),
        option("--period", type=positive, default=1.0, help="seconds of an epoch (%(default)g)"),
        option("--epoch-times", choices=TABLES, help="workers compute one island at a time, epochs of this table"),
        option(
            "--rate",
            type=positive,
            default=150.0,
            metavar="EPOCHS",
            help="islands' epochs a second that this machine can simulate; more workers are made slower (%(default)g)",
        ),
        option("--seconds", type=positive, default=15.0, help="length of a measurement (%(default)g)"),
        option("--noise", type=float, default=0.0, help="of the data that reports are from (%(default)g)"),
    ),
    OUT,
)
def main(options: Namespace) -> int:
    """Measure and print; return 1 when a digest depends on the number of workers, else 0."""
    if options.simulated_islands:
        return measure_scale(options.simulated_islands, options, options.words)
    timings: list[Timing] = []
    record = Record("scaling", options.words, options.out)
    for workers in options.workers:
        with searching(workers) as searches:
            for seed in options.seeds:
                timings.append(timed(searches, workers, seed, options))
                record.add(timings[-1])
    say(timings_table(timings))
    bad = differing(timings)
    record.write(speed_up=speed_ups(timings), seeds_that_differ=bad)
    same = f"digests of seeds {', '.join(map(str, bad))} DIFFER" if bad else "the same digests with every number"
    say(f"\n{same}; load {load():.1f}")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
