"""Search and refining give one result on any number of workers, also when these and their processes are killed.

With processes: a coordinator, workers, a job of two noisy states whose refining takes some seconds.
"""

import os
import signal
import sys
from pathlib import Path
from typing import Any

import pytest

from atoll.client.client import Client
from atoll_core.search.seeding import Stream, stream_key
from atoll_core.wire.messages.views import FINAL_STATES
from benchmarks.harness.jobs import configured
from benchmarks.harness.service import Machines, Searches, running
from benchmarks.harness.systems import table_of, trajectories
from benchmarks.operations.differences import differences, masked
from tests.unit.island_worker.tasks.processes import children_of

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform != "linux", reason="looks for the processes of tasks in /proc"),
]

TABLE = table_of(trajectories("lotka_volterra", noise=0.05, duration=4.0))
CONFIG = configured(seed=5, budget={"max_epochs": 2}, islands=2)
KILLS = 3
MADE: dict[int, Any] = {}


def calm(workers: int) -> Any:
    """Return the result of the job on so many workers that nothing disturbs."""
    if workers not in MADE:
        with running(workers) as (machines, client):
            MADE[workers] = masked(Searches(client, machines).solve("calm", TABLE, CONFIG))
    return MADE[workers]


@pytest.mark.parametrize("workers", [2, 3])
def test_the_number_of_workers_changes_nothing_in_a_result(workers: int) -> None:
    assert calm(1)["equations"][0]["verdict"] != "no model"
    assert [one.shown(200) for one in differences(calm(workers), calm(1))] == []


@pytest.mark.parametrize("seed", [0, 1])
def test_nor_do_deaths_of_workers_and_of_task_processes_while_it_refines(seed: int, tmp_path: Path) -> None:
    stream = Stream(stream_key(seed, "", -1, 0, "deaths while refining"))
    with running(3, keep=tmp_path) as (machines, client):
        client.submit("struck", "struck", CONFIG, client.upload(TABLE.to_bytes()))
        followed = Followed(client)
        followed.until(("refining", *FINAL_STATES))
        struck = [
            strike(machines, stream, is_first=number == 0)
            for number in range(KILLS)
            if not followed.is_over(0.2 + 2.0 * stream.uniform())
        ]
        followed.until(FINAL_STATES)
        assert followed.state == "done"
        assert len(struck) == KILLS, "refining ended before all strikes"
        result = masked(client.result("struck"))
    assert [one.shown(200) for one in differences(result, calm(1))] == []


class Followed:
    """The job as a client sees it."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self.state = ""

    def until(self, states: tuple[str, ...]) -> None:
        while self.state not in states:
            self._client.pause(0.05)
            self.state = self._client.status("struck", 60.0).state

    def is_over(self, seconds: float) -> bool:
        """Wait, and tell whether the job has ended by then."""
        self._client.pause(seconds)
        self.state = self._client.status("struck", 60.0).state
        return self.state in FINAL_STATES


def strike(machines: Machines, stream: Stream, *, is_first: bool) -> str:
    """Kill a task process, of which one may fail, or else a worker, which is started again at once."""
    worker = machines.workers[stream.below(len(machines.workers))]
    processes = children_of(machines.pid(worker))
    if is_first and processes:
        os.kill(processes[0], signal.SIGKILL)
        return "process"
    machines.kill(worker)
    machines.start(worker)
    return "worker"
