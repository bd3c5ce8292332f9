"""What coordinator and workers keep in memory of jobs that have ended: next to nothing."""

import gc
import weakref
from functools import partial
from typing import Any

import numpy as np
import pytest

from atoll_coordinator.data.recording import Preparation
from atoll_core.config import JobConfig
from atoll_island_worker.session import worker_session
from tests.simulation.harness.short_jobs import short_job
from tests.simulation.harness.simulated_cluster import World, prepare

config = partial(short_job, islands=3, max_epochs=12, stagnation=1000)


def prepare_with_values(table: bytes, config: JobConfig) -> Preparation:
    """Prepare a job whose first target has values, which its dataset holds as it comes from the task."""
    prepared = prepare(table, config)
    object.__setattr__(prepared.dataset.targets[0], "values", np.arange(20.0))
    return prepared


class Watched:
    """A world that knows what its jobs are made of, without holding it."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr("tests.simulation.harness.stub_islands.HIT_EPOCHS", 10**9)
        self.parts: list[weakref.ref[Any]] = []
        self.world = World(workers=2, prepare=prepare_with_values, slowness=5.0)

    def look(self, job: str) -> None:
        """Take notice of a job and its archipelagos."""
        live = self.world.service.controller.jobs[job]
        assert live.prepared is not None
        self.parts.append(weakref.ref(live.prepared.dataset.targets[0].values))
        self.parts += [weakref.ref(live), *(weakref.ref(archipelago) for archipelago in live.archipelagos.values())]
        self.parts += [weakref.ref(archipelago.collector) for archipelago in live.archipelagos.values()]

    def left(self) -> list[object]:
        gc.collect()
        return [part() for part in self.parts if part() is not None]


@pytest.mark.slow
@pytest.mark.parametrize("end", ["done", "cancelled", "failed"])
def test_nothing_heavy_is_left_of_a_job_that_has_ended(end: str, monkeypatch: pytest.MonkeyPatch) -> None:
    watched = Watched(monkeypatch)
    world, controller = watched.world, watched.world.service.controller
    world.submit(config(1, max_epochs=12 if end == "done" else 10**6), "x,y")
    while "job" not in controller.jobs or not controller.jobs["job"].archipelagos:
        world.client.pause(0.01)
    watched.look("job")
    assert len(watched.left()) == 1 + 1 + 2 + 2
    if end == "cancelled":
        world.client.cancel("job")
    elif end == "failed":
        controller.fail_job("job", "internal", "it broke", world.network.now)
    assert world.finish().state == end
    world.client.pause(3.0)
    assert watched.left() == []
    assert controller.checkpoints.held_bytes == 0


@pytest.mark.slow
def test_a_worker_remembers_the_terms_of_some_jobs_that_have_ended_and_no_more(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(worker_session, "MAX_TERMS", 4)
    world = World(workers=2)
    for number in range(6):
        world.submit(config(number, max_epochs=2), "x,y", f"job{number}")
        assert world.finish(f"job{number}").state == "done"
        world.client.pause(2.0)
    for worker in world.workers.values():
        assert list(worker.session._terms)[-4:] == [(f"job{number}", name) for number in (4, 5) for name in "xy"]
        assert len(worker.session._terms) <= 4 + 2
        assert worker.session.jobs() == ()
