"""Processor time of searches in this process: ``python -m benchmarks.kernels.searches --data DIR``.

DIR has the 14 Strogatz label files (`benchmarks.peers.strogatz_files`). Each search ends at the target error of a race
with Operon. One worker without a service computes all islands in the commit order, so that the times do not include
start-up, messages and refining, and the digests of two revisions can be compared. To compare two revisions, run this
program in a worktree of each, in turn.
"""

import hashlib
import math
import statistics
import sys
import time
from argparse import Namespace
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

from atoll.terminal.output import say
from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.tasks.defaults import resolve
from atoll_core.config import JobConfig
from atoll_core.data.dataset import Problem
from atoll_core.search.commit_order import CommitOrder, Position
from atoll_island_worker.evolution.island import Island
from benchmarks.harness.command_line import OUT, option, program, seeds_of, whole
from benchmarks.harness.jobs import configured
from benchmarks.harness.record import Record, load
from benchmarks.harness.tables import Columns
from benchmarks.peers.strogatz import RACE_ERROR
from benchmarks.peers.strogatz_files import LABEL, NAMES, rows_of, truths

EPOCHS: Final = 60
"""A search that has not met its target ends after this number of epochs."""

ROWS: Final = Columns(
    "file | milliseconds={milliseconds:.2f} | point evaluations={point_evaluations:.0f} | digest={digest}"
)


@dataclass(frozen=True)
class FileTimes:
    """One file: the geometric mean over seeds of the fastest repetition, the evaluations of all seeds, and a digest."""

    file: str
    milliseconds: float
    point_evaluations: float
    digest: str


def epoch(islands: dict[int, Island], problem: Problem, config: JobConfig, order: CommitOrder) -> bool:
    """Compute one epoch of all islands in the commit order, up to the first hit; return whether there was a hit."""
    hit: Position | None = None
    number = max((island.epoch for island in islands.values()), default=0)
    busy = dict.fromkeys(range(config.evolution.islands), 0)
    while busy:
        index = min(busy, key=lambda island: order.rank(Position(number, busy[island], island)))
        if hit is not None and busy[index] >= order.needed(hit, index):
            del busy[index]
            continue
        if index not in islands:
            islands[index] = Island(problem, config, index)
        is_over = islands[index].advance(order.stride)
        busy[index] = islands[index].generation
        report = islands[index].report() if is_over else None
        if report is not None:
            del busy[index]
            if report.hit is not None:
                at = Position(number, report.hit.generation, index)
                hit = at if hit is None else min(hit, at, key=order.rank)
    return hit is not None


def search(problem: Problem, config: JobConfig) -> tuple[str, int]:
    """Search until the target is met; return a digest of all islands and their point evaluations."""
    joining = min(config.migration.joining or config.evolution.islands, config.evolution.islands)
    order = CommitOrder(
        generations=config.migration.generations, stride=config.evolution.refit_interval, joining=joining
    )
    islands: dict[int, Island] = {}
    digest = hashlib.blake2b(digest_size=8)
    for _ in range(EPOCHS):
        has_hit = epoch(islands, problem, config, order)
        for index in sorted(islands):
            digest.update(islands[index].report().digest.encode())
        if has_hit:
            break
        sent = {source: island.emigrants() for source, island in islands.items()}
        for index, island in islands.items():
            island.immigrate({source: blocks[index] for source, blocks in sent.items() if index in blocks})
    return digest.hexdigest(), sum(island.spent for island in islands.values())


def measure(folder: Path, name: str, seeds: list[int], repetitions: int) -> FileTimes:
    """Search one file with all seeds."""
    digests, spent, fastest = [], 0, []
    table = rows_of(folder, name)
    for seed in seeds:
        config = configured(seed, {"target": LABEL}, {"target_error": RACE_ERROR})
        dataset = prepare(table, config).dataset
        config, problem = resolve(config, dataset), dataset.problem(LABEL)
        times = []
        for _ in range(repetitions):
            begun = time.process_time()
            digest, evaluations = search(problem, config)
            times.append(time.process_time() - begun)
        digests.append(digest)
        spent += evaluations
        fastest.append(min(times))
    together = hashlib.blake2b("".join(digests).encode(), digest_size=8).hexdigest()
    return FileTimes(name, 1e3 * statistics.geometric_mean(fastest), float(spent), together)


@program(
    "benchmarks.kernels.searches",
    __doc__,
    option("--data", type=Path, required=True, help="folder with the files and truth.json"),
    option("--file", choices=NAMES, action="append", help="repeat for several; default: all 14"),
    seeds_of("0-2", "such as 0-4 (0-2)"),
    option("--repetitions", type=whole, default=3, help="the fastest counts (%(default)s)"),
    OUT,
)
def main(options: Namespace) -> None:
    """Measure and print."""
    names = options.file or list(truths(options.data))
    measure(options.data, names[0], options.seeds[:1], 1)  # kernels are loaded before times are taken
    files = [measure(options.data, name, options.seeds, options.repetitions) for name in names]
    mean = math.exp(statistics.fmean(math.log(file.milliseconds) for file in files))
    say(ROWS.table(files))
    say(f"\ngeometric mean {mean:.2f} ms of processor time per search; load {load():.1f}")
    Record("searches", options.words, options.out).write(files=[asdict(file) for file in files], mean_ms=mean)


if __name__ == "__main__":
    sys.exit(main())
