"""One result for any number of workers, and for any deaths while it is refined: noisy jobs under seeded kills.

``python -m benchmarks.operations.refining_deaths --kills 200`` has a noisy job done by 1, 2, 3 and 7 worker processes,
says how long that takes, then has it done again and again by as many as the last, of which one is killed (SIGKILL)
every second or two while the job is refined, and compares all of result.json but times and versions. Jobs are of two
states (Lotka and Volterra, 5 % of noise), three (a food chain, 5 %) and seven (yeast glycolysis, 1 %). Returns 1 when
one of the results differs, else 0.
"""

import sys
import time
from argparse import Namespace
from collections.abc import Callable
from typing import Any, Final

from atoll.client.client import Client
from atoll.terminal.output import note, say
from atoll_core.data.table import Table
from atoll_core.search.seeding import Stream, stream_key
from atoll_core.wire.messages.views import FINAL_STATES
from benchmarks.corpus.cases import Key, make_case
from benchmarks.harness.command_line import option, program, whole
from benchmarks.harness.jobs import configured
from benchmarks.harness.record import load
from benchmarks.harness.service import Machines, Searches, running
from benchmarks.harness.systems import table_of, trajectories
from benchmarks.many.systems import YEAST, sampled
from benchmarks.operations.differences import differences, masked

PER_JOB: Final = 4
"""Kills of one job at most: with its fifth lost worker a task fails, as it should."""

LIMIT_S: Final = 1200.0
CONFIG: Final = configured(seed=5, budget={"max_epochs": 2}, islands=2)
TABLES: Final[dict[str, Callable[[], Table]]] = {
    "two": lambda: table_of(trajectories("lotka_volterra", noise=0.05, duration=4.0)),
    "three": lambda: make_case(Key("food_chain", 3, 4, "even", "noise-0.05", 1000), has_fresh=False).table,
    "seven": lambda: table_of(sampled(YEAST, 1000, 1.0)[0]),
}


@program(
    "benchmarks.operations.refining_deaths",
    __doc__,
    option("--kills", type=whole, default=20, help="how many workers are killed in all (default: 20)"),
    option("--job", choices=("two", "three", "seven"), default="two", help="how many states it has (default: two)"),
    option("--workers", type=whole, nargs="+", default=[1, 2, 3, 7], help="processes (default: 1 2 3 7)"),
)
def main(options: Namespace) -> int:
    """Play the kills that were asked for; return the exit code."""
    table = TABLES[options.job]()
    made: list[Any] = []
    for number in options.workers:
        with running(number) as (machines, client):
            searches = Searches(client, machines)
            searches.solve("first", table_of(trajectories("lotka_volterra")), CONFIG)  # kernels are loaded then
            began = time.monotonic()
            result = searches.solve("calm", table, CONFIG)
            whole_s = time.monotonic() - began
            say(f"{number} workers: {whole_s:.1f} s, search {result['search_seconds']:.1f} s; load {load():.1f}")
            made.append(masked(result))
    differing = sum(any(differences(one, made[0])) for one in made)
    kills = jobs = 0
    stream = Stream(stream_key(0, "", -1, 0, "deaths while refining"))
    with running(options.workers[-1]) as (machines, client):
        digest = client.upload(table.to_bytes())
        while kills < options.kills:
            name = f"struck-{jobs}"
            client.submit(name, name, CONFIG, digest)
            kills += _strike(machines, client, name, stream, min(PER_JOB, options.kills - kills))
            jobs += 1
            differing += any(differences(masked(client.result(name)), made[0]))
            note(f"{kills} kills, {jobs} jobs, {differing} results differ")
    say(
        f"{kills} workers were killed while {jobs} jobs were refined; {differing} of {jobs + len(made)} results "
        f"differ; load {load():.1f}"
    )
    return int(differing > 0)


def _strike(machines: Machines, client: Client, job: str, stream: Stream, most: int) -> int:
    """Kill workers, one after the other, from when a job is refined to its end; return how many."""
    end, done = time.monotonic() + LIMIT_S, 0
    while (state := client.status(job, 60.0).state) not in FINAL_STATES:
        if time.monotonic() > end:
            raise TimeoutError(f"job {job} has not ended within {LIMIT_S:.0f} s")
        client.pause(0.1 if state != "refining" else 0.3 + stream.uniform())
        if state == "refining" and done < most:
            worker = machines.workers[stream.below(len(machines.workers))]
            machines.kill(worker)
            machines.start(worker)
            done += 1
    return done


if __name__ == "__main__":
    sys.exit(main())
