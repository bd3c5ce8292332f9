"""Several jobs, priorities, poison, hung computation, stalls: what people who run a service need to rely on."""

from functools import cache, partial

import pytest

from atoll_coordinator.service.workers.membership import STANDING_S
from atoll_core.config import EvolutionConfig, MigrationConfig
from atoll_core.wire.messages.views import EventView
from atoll_core.wire.messages.workers import AssignmentStatus, WorkerStatus
from tests.simulation.harness.short_jobs import short_job
from tests.simulation.harness.simulated_cluster import World, comparable
from tests.simulation.harness.stub_islands import hits_of

config = partial(short_job, islands=4, generations=100, max_epochs=5)


ENDLESS = next(name for name in "abcdefghijklmnop" if not hits_of(config(1), name))
"""A variable whose target is met nowhere."""


@cache
def alone(seed: int) -> str:
    """The answer of a job that has one worker for itself."""
    return comparable(World(workers=1, seed=seed).run(config(seed)))


def happened(world: World, job: str | None = None) -> list[EventView]:
    return list(world.client.events(job, 0, 1000))


def kinds(world: World, job: str | None = None) -> list[str]:
    return [event.event for event in happened(world, job)]


def raise_the_dead(world: World, **options: object) -> None:
    """Start another worker for each that has died, under a new name, now and every second."""
    number = 0

    def look() -> None:
        nonlocal number
        while len(world.workers) < 2:
            number += 1
            world.start_worker(f"next{number}", **options)
        world.at(world.network.now + 1.0, look)

    world.at(world.network.now + 1.0, look)


@pytest.mark.slow
def test_a_job_of_higher_priority_is_taken_up_first_and_gets_the_larger_share() -> None:
    def evaluations(priority: int) -> tuple[int, int]:
        world = World(workers=1)
        endless = config(1, max_epochs=100_000, stagnation=100_000)
        world.submit(endless, variables=ENDLESS, job="low")
        world.submit(endless, variables=ENDLESS, job="high", priority=priority)
        world.client.pause(6.0)
        low, high = (world.client.status(job).point_evaluations for job in ("low", "high"))
        return low, high

    low, high = evaluations(0)
    assert 0.8 < high / low < 1.25
    low, high = evaluations(2)
    assert 3.0 < high / low < 5.0


@pytest.mark.slow
def test_the_line_goes_by_priority_then_by_time() -> None:
    world = World(workers=0)
    for number, priority in enumerate([0, 0, 0, 0, 0, 3, 0]):
        world.submit(config(number, max_epochs=2), job=f"job{number}", priority=priority)
    world.client.pause(1.0)  # the first four have places, and are prepared as soon as there is a worker
    ahead = {view.job: view.ahead for view in world.client.jobs() if view.state == "queued"}
    line = ["job5", "job4", "job6"]
    assert ahead == {job: place for place, job in enumerate(line)}
    world.start_worker("w0")
    world.client.pause(30.0)
    began = [event.job for event in happened(world) if event.event == "prepared"]
    assert began == ["job0", "job1", "job2", "job3", *line]


def test_islands_that_kill_their_workers_are_isolated_then_their_job_fails_and_the_other_goes_on() -> None:
    world = World(workers=0)
    poison = ("bad", "y", 2)
    for name in ("w0", "w1"):
        world.start_worker(name, poisonous=poison)
    raise_the_dead(world, poisonous=poison)
    world.submit(config(1), variables="x,y", job="bad")
    world.submit(config(2), job="good")
    bad, good = world.finish("bad"), world.finish("good")
    assert (bad.state, bad.fault) == ("failed", "poison")
    assert "islands of y seem to kill" in (bad.reason or "")
    assert good.state == "done"
    assert comparable(world.result("good")) == alone(2)
    isolated = [event.variable for event in happened(world, "bad") if event.event == "isolated"]
    assert "y" in isolated
    lost = {event.worker for event in happened(world, "bad") if event.event == "worker-lost"}
    assert 3 + 2 <= len(lost) <= 3 * 2 + 2  # of two workers one may die before the other has begun such an island


@pytest.mark.slow
def test_workers_that_only_lost_their_connection_make_nobody_suspect() -> None:
    world = World(workers=2)
    for number in range(2):
        world.at(1.2 + 4.0 * number, partial(world.network.disconnect, "w1"))
        world.at(2.4 + 4.0 * number, partial(world.network.heal, "w1"))
    world.submit(config(1, max_epochs=100_000, stagnation=100_000, max_time=18.0), variables=ENDLESS)
    view = world.finish()
    assert view.state == "done"
    assert kinds(world).count("worker-lost") == 2
    assert "pardoned" in kinds(world, "job")
    assert "isolated" not in kinds(world, "job")


def test_a_worker_whose_computation_hangs_is_lost_although_its_heartbeats_come() -> None:
    world = World(workers=1)
    world.start_worker("stuck", hangs=("job", 3))
    world.submit(config(1))
    world.client.pause(0.5 * STANDING_S)
    view = world.client.status("job")
    assert any("on worker stuck" in stall and "without progress" in stall for stall in view.stalls), view.stalls
    assert world.finish().state == "done"
    assert comparable(world.result()) == alone(1)
    assert {view.worker: view.state for view in world.client.workers()}["stuck"] == "hung"
    story = kinds(world, "job")
    assert story[0] == "submitted"
    assert "stalled" in story
    assert story[-1] == "done"


def test_a_silent_worker_is_named_while_it_is_waited_for() -> None:
    world = World(workers=2)
    world.at(1.2, lambda: world.network._buses["w1"].handle_with(lambda event: None))
    world.submit(config(1, max_epochs=14))
    world.client.pause(9.0)
    (stall, *_) = world.client.status("job").stalls
    assert "on worker w1, silent for" in stall
    assert world.finish().state == "done"
    assert world.client.status("job").stalls == ()


def test_counters_say_what_went_through() -> None:
    world = World(workers=2)
    world.run(config(1, max_epochs=14))
    view = world.client.status("job")
    assert view.counters.reports > 0
    assert view.counters.placements >= 2
    assert view.counters.waited_s > 0.0
    first, *_ = world.client.workers()
    traffic = {traffic_kind.kind: traffic_kind for traffic_kind in first.counters.traffic}
    assert traffic["report"].messages_out > 0
    assert traffic["pull"].bytes_in > 0
    assert first.counters.memory_bytes > 1_000_000
    own = world.client.coordinator()
    assert own is not None
    assert own.store.transactions > 0
    assert {traffic_kind.kind: traffic_kind for traffic_kind in own.counters.traffic}["status"].messages_in > 0


@pytest.mark.slow
def test_work_that_is_slower_than_the_lease_gets_on_and_is_not_taken_for_poison() -> None:
    world = World(workers=1, slowness=0.6 * STANDING_S / 0.001)
    short = {"evolution": EvolutionConfig(islands=2), "migration": MigrationConfig(generations=20)}
    world.submit(config(1, max_epochs=1).model_copy(update=short), variables=ENDLESS)
    assert world.finish(limit_s=20_000.0).state == "done"
    assert 1 <= kinds(world).count("worker-lost") <= 3
    assert "isolated" not in kinds(world)


def test_a_stranger_who_makes_up_what_it_holds_fills_no_memory() -> None:
    world = World(workers=1)
    world.submit(config(1, max_epochs=100_000, stagnation=100_000), variables=ENDLESS)
    world.client.pause(1.5)
    membership, controller = world.service.controller.workers.membership, world.service.controller
    member = membership.member("w0")
    assert member is not None
    for number in range(200):
        assignment_status = AssignmentStatus(
            job=f"made-up-{number}", variable="x", term=1, islands=1, reported=0, commit=0, waited_s=1.0
        )
        status = WorkerStatus(
            instance=member.hello.instance, incarnation=1, state="ready", progress=number, holdings=(assignment_status,)
        )
        controller.add_heartbeat("w0", status, world.network.now)
    assert len(controller.counters._waited_s) < 5
