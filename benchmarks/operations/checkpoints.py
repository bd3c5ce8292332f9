"""What checkpoints cost: the same searches with them and without, in turn, and bytes per island.

``python -m benchmarks.operations.checkpoints --epochs 60 --seeds 0-5`` gives one service of `--workers` the same jobs
twice, once without checkpoints, with odd seeds the other way round. The very same processes do both: two processes of
the same program may differ by several percent in how fast their kernels run, according to where in memory these came to
lie. No target ends a search, and the digest must be the same.

Compared is the processor time of coordinator and workers while the islands are under way; unlike seconds of a clock it
hardly depends on what else the machine does. The cost is the share of throughput that is missing with checkpoints.
Returns 1 when a digest differs or the median cost is above the goal, else 0.
"""

import re
import statistics
import sys
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from atoll.terminal.output import note, say
from atoll_core.wire.messages.views import JobView
from benchmarks.harness.accounts import PROCESSES, processor_seconds
from benchmarks.harness.command_line import OUT, option, program, seeds_of, whole, workers
from benchmarks.harness.jobs import NEVER, UNENDING, configured
from benchmarks.harness.record import Record, load
from benchmarks.harness.service import TIED_COORDINATOR, Searches, searching
from benchmarks.harness.systems import SYSTEMS, table_of, trajectories
from benchmarks.harness.tables import Columns

GOAL: Final = 0.03
PLAIN: Final = "plain"
"""What the ids of jobs begin with that take no checkpoint."""

PROGRAM: Final = f"""
from atoll_coordinator.service.search.archipelago import Archipelago
begin = Archipelago.__init__
def chosen(self, job, *rest):
    begin(self, job, *rest)
    if job.startswith("{PLAIN}-"):
        self.interval = {NEVER}
Archipelago.__init__ = chosen
{TIED_COORDINATOR}"""
"""The coordinator's program; the first checkpoint of plain jobs lies beyond the end of every search."""

_COMMITTED: Final = re.compile(r"\bcommit .*\bjob=(\S+) .*\bislands=(\d+) bytes=(\d+)")


@dataclass
class Spent:
    """Processor time of some processes from a job's first complete epoch to the end of its search."""

    pids: tuple[int, ...]
    processes: Path = PROCESSES
    begun: float | None = None
    ended: float = 0.0

    def look(self, view: JobView) -> None:
        """Take in the state of the job; called again and again."""
        if view.state == "running" and any(variable.epoch for variable in view.variables):
            self.ended = sum(processor_seconds(pid, processes=self.processes) for pid in self.pids)
            self.begun = self.ended if self.begun is None else self.begun

    @property
    def seconds(self) -> float:
        """Seconds from the first look to the last."""
        return self.ended - (self.begun or 0.0)


@dataclass(frozen=True)
class Pair:
    """One search with checkpoints and without.

    Processor seconds, seconds of the clock, how many checkpoints were committed, and bytes of a state in the mean.
    """

    seed: int
    with_cpu: float
    without_cpu: float
    with_seconds: float
    without_seconds: float
    checkpoints: int
    bytes_per_island: float
    is_same: bool

    @property
    def cost(self) -> float:
        """The share of throughput that is missing with checkpoints."""
        return 1.0 - self.without_cpu / self.with_cpu


def measured(searches: Searches, options: Namespace, seed: int) -> Pair:
    """Search for the same with checkpoints and without."""
    found: dict[bool, tuple[dict[str, Any], float]] = {}
    config = configured(seed, budget={**UNENDING, "max_epochs": options.epochs})
    for kept in (False, True) if seed % 2 else (True, False):
        spent = Spent(searches.pids)
        sampled = table_of(trajectories(options.system, seed=seed))
        prefix = "kept" if kept else PLAIN
        result = searches.solve(f"seed {seed}", sampled, config, spent.look, prefix)
        found[kept] = (result, spent.seconds)
    (one, with_cpu), (other, without_cpu) = found[True], found[False]
    sizes = committed(searches.log, one["job"])
    pair = Pair(
        seed,
        with_cpu,
        without_cpu,
        one["search_seconds"],
        other["search_seconds"],
        len(sizes),
        statistics.fmean(sizes) if sizes else 0.0,
        one["digest"] == other["digest"],
    )
    note(f"  seed {seed}: {with_cpu:.2f} s of processor time beside {without_cpu:.2f} s, cost {pair.cost:.1%}")
    return pair


def committed(log: str, job: str) -> list[float]:
    """Return, for each checkpoint of a job that a coordinator's log mentions, the bytes of one island."""
    return [int(size) / int(islands) for name, islands, size in _COMMITTED.findall(log) if name == job]


def pairs_table(pairs: Sequence[Pair]) -> str:
    """Return one line for each search."""
    return Columns(
        "seed | cpu s with={with_cpu:.2f} | without={without_cpu:.2f} | cost={cost:.1%} | s with={with_seconds:.2f} | "
        "without={without_seconds:.2f} | checkpoints | KB per island={bytes_per_island:k.1f} | digest={is_same:same}"
    ).table(pairs)


@program(
    "benchmarks.operations.checkpoints",
    __doc__,
    option("--system", choices=sorted(SYSTEMS), default="predator_prey", help="default: %(default)s"),
    option("--epochs", type=whole, default=60, help="of every search (default: %(default)s)"),
    workers(what="of the service"),
    seeds_of("0-5", "such as 0-4 (default: 0-5)"),
    OUT,
)
def main(options: Namespace) -> int:
    """Measure and print; return 1 when a digest differs or the cost is above the goal, else 0."""
    pairs: list[Pair] = []
    with searching(options.workers, program=PROGRAM) as searches:
        for seed in options.seeds:
            pairs.append(measured(searches, options, seed))
            figures = [{**asdict(pair), "cost": pair.cost} for pair in pairs]
            Record("checkpoints", options.words, options.out).write(pairs=figures)
    say(pairs_table(pairs))
    cost = statistics.median(pair.cost for pair in pairs)
    say(f"\ncost {cost:.1%} in the median, goal at most {GOAL:.0%}; load {load():.1f}")
    return 0 if cost <= GOAL and all(pair.is_same for pair in pairs) else 1


if __name__ == "__main__":
    sys.exit(main())
