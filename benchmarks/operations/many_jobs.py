"""Many jobs submitted at once to few workers: all end, and with the digests that they have alone.

``python -m benchmarks.operations.many_jobs --jobs 8 --workers 2`` starts a coordinator and workers, submits as many
jobs as asked for without waiting, and follows them to their ends; then submits them again under other ids, each alone.
Returns 1 when a job does not end well or a digest differs, else 0.
"""

import sys
import time
from argparse import Namespace
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np

from atoll.client.client import Client, connected
from atoll.terminal.output import note, say
from atoll_core.config import JobConfig
from atoll_core.data.table import Table
from atoll_core.errors import AtollError, UnreachableError
from atoll_core.wire.messages.views import FINAL_STATES
from benchmarks.harness.command_line import OUT, option, program, whole, workers
from benchmarks.harness.jobs import UNMET, configured, table_of_columns
from benchmarks.harness.record import Record, load
from benchmarks.harness.service import CONNECT_LIMIT_S, Searches, searching
from benchmarks.harness.tables import Columns

LIMIT_S: Final = 600.0
ROWS: Final = 200
EPOCHS: Final = 6
_LOOK_S: Final = 0.2


@dataclass(frozen=True)
class Ended:
    """One job: when it ended, in seconds since the first was submitted; whether its digest is the one it has alone."""

    seed: int
    state: str
    seconds: float
    is_same: bool


JOBS: Final = Columns("seed | state | ended after s={seconds:.1f} | digest={is_same:same}")


def measurements() -> Table:
    """Return a table of two inputs and a target that no short expression meets."""
    a, b = np.linspace(0.1, 3.0, ROWS), np.cos(np.linspace(0.0, 7.0, ROWS))
    return table_of_columns({"a": a, "b": b, "y": a * np.exp(-b) + np.sin(a * b)}, "measured")


def config_of(seed: int) -> JobConfig:
    """Return the configuration of a search of a fixed number of epochs."""
    return configured(seed, {"target": "y"}, {"max_epochs": EPOCHS, "target_error": UNMET})


def all_at_once(client: Client, digest: str, jobs: int) -> dict[str, float]:
    """Submit all, follow them, and return when each ended."""
    begun = client.now()
    names = [f"crowd-{seed}" for seed in range(jobs)]
    for seed, name in enumerate(names):
        client.submit(name, name, config_of(seed), digest)
    ends: dict[str, float] = {}
    while len(ends) < jobs:
        if client.now() - begun > LIMIT_S:
            missing = ", ".join(sorted(set(names) - set(ends)))
            raise UnreachableError(f"jobs {missing} did not end within {LIMIT_S:.0f} s")
        for view in client.jobs():
            if view.job in names and view.job not in ends and view.state in FINAL_STATES:
                ends[view.job] = client.now() - begun
                note(f"  {view.job} is {view.state} after {ends[view.job]:.1f} s")
        client.pause(_LOOK_S)
    return ends


def measured(searches: Searches, jobs: int) -> list[Ended]:
    """Run the jobs at once, then each alone."""
    data = measurements()
    with connected(searches.address, CONNECT_LIMIT_S) as client:
        ends = all_at_once(client, client.upload(data.to_bytes()), jobs)
        found: list[Ended] = []
        for seed in range(jobs):
            name = f"crowd-{seed}"
            state = client.status(name).state
            digest = client.result(name)["digest"] if state == "done" else ""
            alone: dict[str, Any] = searches.solve(f"seed {seed} alone", data, config_of(seed))
            found.append(Ended(seed, state, ends[name], digest == alone["digest"]))
    return found


@program(
    "benchmarks.operations.many_jobs",
    __doc__,
    option("--jobs", type=whole, default=8, help="how many at once (%(default)s)"),
    workers(),
    OUT,
)
def main(options: Namespace) -> int:
    """Measure and print."""
    began = time.monotonic()
    with searching(options.workers) as searches:
        found = measured(searches, options.jobs)
    if not found:
        raise AtollError("no job was measured")
    Record("many_jobs", options.words, options.out).write(jobs=[asdict(job) for job in found])
    say(JOBS.table(found))
    good = sum(job.state == "done" and job.is_same for job in found)
    say(f"\n{good} of {len(found)} jobs on {options.workers} workers done with the digest that they have alone; "
        f"{time.monotonic() - began:.0f} s in all, load {load():.1f}")  # fmt: skip
    return 0 if good == len(found) else 1


if __name__ == "__main__":
    sys.exit(main())
