"""Islands that end their workers, when the coordinator is started again in between, and what is kept of their job."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest

from atoll_coordinator.service.store.store import Store
from atoll_coordinator.service.workers.crash_loops import FAIL_AFTER
from atoll_core.wire import topics
from atoll_core.wire.bus.interface import Reply
from atoll_core.wire.codec import decode, encode
from atoll_core.wire.messages.epochs import Pull, PullAnswer, PullStates, States
from tests.simulation.harness.short_jobs import short_job
from tests.simulation.harness.simulated_cluster import World, bus_of

POISON = ("job", "x", 12)
"""After the first checkpoint."""


@pytest.fixture(autouse=True)
def no_hits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.simulation.harness.stub_islands.HIT_EPOCHS", 10**9)


config = partial(short_job, islands=3, max_epochs=40, stagnation=1000)


class Ward:
    """A world whose store lasts, in which two workers are there again soon, whoever dies."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.world = World(workers=0)
        self.restart()
        self.number = 0
        self._look()

    def restart(self) -> None:
        """Kill the coordinator and start it again."""
        self.world.network.crash("coordinator")
        self.world.store.close()
        self.world.store = Store.open(self.directory)
        self.world.service = self.world.start_service()

    def _look(self) -> None:
        while len(self.world.workers) < 2:
            self.number += 1
            self.world.start_worker(f"w{self.number}", poisonous=POISON, slowness=5.0)
        self.world.at(self.world.network.now + 1.0, self._look)

    def deaths(self, variable: str = "x") -> int:
        return self.world.service.controller.workers.crash_loops.loop(("job", variable)).deaths

    def until(self, deaths: int, variable: str = "x") -> None:
        """Let time pass until so many deaths are counted for an archipelago."""
        end = self.world.network.now + 100.0
        while self.deaths(variable) != deaths:
            assert self.world.network.now < end, f"there were never {deaths} deaths"
            self.world.client.pause(0.02)


@pytest.fixture
def ward(tmp_path: Path) -> Iterator[Ward]:
    made = Ward(tmp_path)
    yield made
    made.world.close()


def test_a_coordinator_that_is_started_again_at_each_death_finds_the_poison_all_the_same(ward: Ward) -> None:
    ward.world.submit(config(), "x")
    for deaths in range(1, FAIL_AFTER):
        ward.until(deaths)
        ward.restart()
        assert ward.deaths() == deaths
    view = ward.world.finish()
    assert (view.state, view.fault) == ("failed", "poison")
    assert f"in {FAIL_AFTER} successive placements a worker" in (view.reason or "")
    assert "(the last worker was w" in (view.reason or "")
    assert ward.world.store.deaths("job") == ()


def test_a_commit_makes_deaths_be_forgotten(ward: Ward) -> None:
    ward.world.submit(config(max_epochs=10_000), "y")
    ward.world.client.pause(1.0)
    ward.world.crash(next(iter(ward.world.workers)))
    ward.until(1, "y")
    assert len(ward.world.store.deaths("job")) == 1
    ward.until(0, "y")
    assert ward.world.store.deaths("job") == ()
    assert ward.world.client.status("job").state == "running"


def test_a_worker_that_was_only_cut_off_is_pardoned_by_the_next_coordinator_too(ward: Ward) -> None:
    ward.world.submit(config(max_epochs=10_000), "y")
    ward.world.client.pause(1.0)
    (name, *_) = ward.world.workers
    ward.world.network.disconnect(name)
    end = ward.world.network.now + 20.0
    while not ward.world.store.deaths("job") and ward.world.network.now < end:
        ward.world.client.pause(0.05)
    (death,) = ward.world.store.deaths("job")
    assert death.worker == name
    ward.restart()
    ward.world.at(ward.world.network.now + 0.2, partial(ward.world.network.heal, name))
    ward.world.client.pause(3.0)
    assert name in {view.worker for view in ward.world.client.workers() if view.state != "lost"}
    assert ward.world.store.deaths("job") == ()


@pytest.mark.slow
def test_the_last_checkpoint_of_a_poisonous_job_can_still_be_read_and_those_of_others_cannot(ward: Ward) -> None:
    ward.world.submit(config(), "x,y")
    assert ward.world.finish().fault == "poison"
    kept = ward.world.store.checkpoints("job")
    assert "x" in kept
    epoch, _ = kept["x"]
    ward.restart()
    stranger, cluster = bus_of(ward.world, "stranger"), ward.world.store.cluster
    pull = PullStates(job="job", variable="x", term=1, epoch=epoch, islands=(0, 1, 2), offset=0)
    stranger.get(topics.states(cluster, "job"), encode(Pull(body=pull)))
    reply = stranger.receive(5.0)
    assert isinstance(reply, Reply)
    assert reply.payload is not None
    body = decode(reply.payload, PullAnswer).body
    assert isinstance(body, States)
    assert [piece.island for piece in body.pieces] == [0, 1, 2]
    ward.world.submit(config(), "x,y", "other")
    assert ward.world.finish("other").state == "done"
    assert ward.world.store.checkpoints("other") == {}
