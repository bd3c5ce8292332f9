"""One result for any number of workers, and for any deaths while it is refined: noisy jobs under seeded kills.

``python -m benchmarks.operations.refining_deaths --kills 200`` has one noisy job of two states done by 1, 2, 3 and 7
worker processes, then again and again by seven of which one is killed (SIGKILL) every second or two while the job is
refined, and compares all of result.json but times and versions. Returns 1 when one of them differs, else 0.
"""

import sys
import time
from argparse import Namespace
from typing import Any, Final

from atoll.client.client import Client
from atoll.terminal.output import note, say
from atoll_core.search.seeding import Stream, stream_key
from atoll_core.wire.messages.views import FINAL_STATES
from benchmarks.harness.command_line import option, program, whole
from benchmarks.harness.jobs import configured
from benchmarks.harness.record import load
from benchmarks.harness.service import Machines, Searches, running
from benchmarks.harness.systems import table_of, trajectories
from benchmarks.operations.differences import differences, masked

NUMBERS: Final = (1, 2, 3, 7)
PER_JOB: Final = 4
"""Kills of one job at most: with its fifth lost worker a task fails, as it should."""

LIMIT_S: Final = 600.0
CONFIG: Final = configured(seed=5, budget={"max_epochs": 2}, islands=2)


@program(
    "benchmarks.operations.refining_deaths",
    __doc__,
    option("--kills", type=whole, default=20, help="how many workers are killed in all (default: 20)"),
)
def main(options: Namespace) -> int:
    """Play the kills that were asked for; return the exit code."""
    table = table_of(trajectories("lotka_volterra", noise=0.05, duration=4.0))
    made: dict[int, Any] = {}
    for number in NUMBERS:
        with running(number) as (machines, client):
            began = time.monotonic()
            made[number] = masked(Searches(client, machines).solve("calm", table, CONFIG))
            note(f"{number} workers: {time.monotonic() - began:.1f} s")
    differing = sum(any(differences(one, made[1])) for one in made.values())
    kills = jobs = 0
    stream = Stream(stream_key(0, "", -1, 0, "deaths while refining"))
    with running(max(NUMBERS)) as (machines, client):
        digest = client.upload(table.to_bytes())
        while kills < options.kills:
            name = f"struck-{jobs}"
            client.submit(name, name, CONFIG, digest)
            kills += _strike(machines, client, name, stream, min(PER_JOB, options.kills - kills))
            jobs += 1
            differing += any(differences(masked(client.result(name)), made[1]))
            note(f"{kills} kills, {jobs} jobs, {differing} results differ")
    say(
        f"{kills} workers were killed while {jobs} jobs were refined; {differing} of {jobs + len(NUMBERS)} results "
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
