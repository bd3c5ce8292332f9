"""Users share places and workers; jobs are paused and workers drained, and every job ends as it does alone."""

from functools import cache, partial

import pytest

from atoll_coordinator.service.scheduling.limits import Allowance, Limits, Total
from atoll_core.wire.messages.clients import Submit
from tests.simulation.harness.schedule_run import hurried
from tests.simulation.harness.short_jobs import short_job
from tests.simulation.harness.simulated_cluster import World, comparable
from tests.simulation.harness.stub_islands import hits_of

config = partial(short_job, islands=4, generations=100, max_epochs=60)
VARIABLE = next(name for name in "abcdefghijklmnop" if not hits_of(config(1), name))
"""A variable whose target is met nowhere: the search goes on to the last epoch."""


@cache
def alone() -> str:
    return comparable(World(workers=1, seed=1).run(config(1), VARIABLE))


def submit_as(world: World, user: str, job: str, **changes: int) -> None:
    """Submit an endless job as that of a user."""
    endless = config(1, max_epochs=100_000, stagnation=100_000, **changes)
    table = world.client.upload(VARIABLE.encode())
    body = Submit(job=job, name=job, config=endless, table=table)
    world.service.controller.submit(body, world.network.now, user)


def until(world: World, state: str) -> None:
    """Let time pass until the job is in a state."""
    for _ in range(600):
        if world.client.status("job").state == state:
            return
        world.client.pause(0.25)
    raise AssertionError(f"the job is {world.client.status('job').state}")


def islands(world: World) -> dict[str, int]:
    return {view.worker: view.islands for view in world.client.workers()}


def test_a_paused_job_stops_at_a_checkpoint_and_ends_as_it_would_have() -> None:
    with hurried():
        world = World(workers=2, seed=1, slowness=5.0)
        world.submit(config(1), VARIABLE)
        world.client.pause(2.0)
        assert world.client.pause_job("job").paused
        world.client.pause(10.0)
        view = world.client.status("job")
        assert (view.state, view.workers, view.held) == ("running", 0, True)
        assert 0 < view.variables[0].epoch < 60
        assert set(islands(world).values()) == {0}
        turns = sum(compute.turns for compute in world.computes.values())
        world.client.pause(10.0)
        assert sum(compute.turns for compute in world.computes.values()) == turns
        assert world.client.status("job").variables[0].epoch == view.variables[0].epoch
        world.client.pause_job("job", paused=False)
        assert world.finish().state == "done"
    assert comparable(world.result()) == alone()
    assert [event.event for event in world.client.events("job") if event.event in ("held", "resumed")] == [
        "held",
        "resumed",
    ]


def test_time_stands_still_for_a_job_that_is_paused() -> None:
    with hurried():
        world = World(workers=1, seed=1, slowness=5.0)
        world.submit(config(1, max_epochs=100_000, stagnation=100_000, max_time=40.0), VARIABLE)
        world.client.pause(3.0)
        world.client.pause_job("job")
        world.client.pause(100.0)
        assert world.client.status("job").state == "running"
        world.client.pause_job("job", paused=False)
        assert world.finish().state == "done"


def test_a_worker_that_is_drained_hands_over_and_gets_nothing_until_it_is_taken_back() -> None:
    with hurried():
        world = World(workers=2, seed=1, slowness=5.0)
        world.submit(config(1), VARIABLE)
        world.client.pause(2.0)
        assert set(islands(world).values()) == {2}
        world.client.set_worker("w0", "draining")
        world.client.pause(10.0)
        assert islands(world) == {"w0": 0, "w1": 4}
        assert {view.worker: view.service for view in world.client.workers()}["w0"] == "draining"
        world.client.set_worker("w0", "open")
        assert world.finish().state == "done"
    assert comparable(world.result()) == alone()
    assert world.client.status("job").counters.deaths == 0


def test_a_cordoned_worker_keeps_its_islands_and_gets_no_more() -> None:
    world = World(workers=2, seed=1, slowness=5.0)
    world.submit(config(1, max_epochs=100_000, stagnation=100_000), VARIABLE, job="one")
    world.client.pause(2.0)
    world.client.set_worker("w0", "cordoned")
    world.submit(config(2, max_epochs=100_000, stagnation=100_000), VARIABLE, job="two")
    world.client.pause(10.0)
    assert islands(world) == {"w0": 2, "w1": 6}


@pytest.mark.slow
def test_users_have_equal_shares_of_a_worker_however_many_jobs_of_whatever_priority_they_have() -> None:
    world = World(workers=1, seed=1)
    for number in range(3):
        submit_as(world, "ann", f"ann-{number}")
        world.service.controller.set_priority(f"ann-{number}", 5, world.network.now)
    submit_as(world, "bob", "bob")
    world.client.pause(20.0)
    computed = world.computes["w0"].seconds
    assert 0.8 < computed["ann"] / computed["bob"] < 1.25


def test_a_changed_priority_reaches_the_workers() -> None:
    world = World(workers=1, seed=1)
    for job in ("low", "high"):
        submit_as(world, "ann", job)
    world.client.pause(3.0)
    world.client.set_priority("high", 3)
    before = {view.job: view.point_evaluations for view in world.client.jobs()}
    world.client.pause(10.0)
    after = {view.job: view.point_evaluations for view in world.client.jobs()}
    assert after["high"] - before["high"] > 4 * (after["low"] - before["low"])


def test_a_worker_whose_certificate_is_revoked_is_sent_away_and_its_islands_go_on_elsewhere() -> None:
    from atoll_core.wire.security.roles import RoleBindings

    roles = {"w1": "worker", "client": "admin"}
    world = World(workers=2, seed=1, slowness=5.0)
    world.submit(config(1), VARIABLE)
    world.client.pause(2.0)
    world.service.set_policy(Limits(), RoleBindings({**roles, "w0": "revoked"}))  # type: ignore[dict-item]
    world.client.pause(2.0)
    assert world.workers["w0"].exit_code not in (None, 0)
    assert "is revoked" in str(world.workers["w0"].error)
    assert world.finish().state == "done"
    assert comparable(world.result()) == alone()


def test_who_has_used_up_the_time_of_a_day_waits() -> None:
    with hurried():
        world = World(workers=1, seed=1, slowness=5.0)
        world.service.controller.queue.limits = Limits.model_validate({"user": {"task_time": 5.0}})
        world.submit(config(1, max_epochs=100_000, stagnation=100_000), VARIABLE)
        world.client.pause(60.0)
        view = world.client.status("job")
        assert (view.held, view.workers) == (True, 0)
        assert "used up" in (view.reason or "")
        used = sum(world.computes["w0"].seconds.values())
        assert 5.0 <= used < 20.0
        world.network.crash("coordinator")
        world.service = world.start_service()
        world.service.controller.queue.limits = Limits.model_validate({"user": {"task_time": 5.0}})
        world.client.pause(60.0)
        assert world.client.status("job").held, "also when the coordinator is started again"
        assert sum(world.computes["w0"].seconds.values()) < used + 15.0


def test_a_job_that_is_paused_before_a_worker_prepares_it_gives_its_place_back() -> None:
    with hurried():
        world = World(workers=0, seed=1)
        world.service.controller.queue.limits = Limits(total=Total(running=1))
        world.submit(config(1), VARIABLE)
        world.client.pause(2.0)
        assert world.client.status("job").state == "preparing"
        view = world.client.pause_job("job")
        assert (view.state, view.paused, "coordinator resume job" in (view.reason or "")) == ("queued", True, True)
        world.submit(config(2), VARIABLE, job="other")
        world.client.pause(2.0)
        assert [view.state for view in world.client.jobs()] == ["queued", "preparing"]
        world.start_worker("w0")
        assert world.finish("other").state == "done"
        world.client.pause_job("job", paused=False)
        assert world.finish().state == "done"
    assert comparable(world.result()) == alone()


@pytest.mark.parametrize("is_paused", [False, True])
def test_no_time_passes_for_a_job_whose_refining_waits_for_a_worker_or_is_paused(is_paused: bool) -> None:
    with hurried():
        world = World(workers=1, seed=1, slowness=5.0)
        world.submit(config(1, max_time=60.0), VARIABLE)
        until(world, "running")
        world.client.pause(1.0)
        assert set(islands(world).values()) == {4}
        world.client.set_worker("w0", "cordoned")  # it keeps its islands and gets no task
        until(world, "refining")
        if is_paused:
            assert world.client.pause_job("job").paused
            world.client.set_worker("w0", "open")
        world.client.pause(100.0)
        view = world.client.status("job")
        assert (view.state, "coordinator resume job" in (view.reason or "")) == ("refining", is_paused)
        world.client.set_worker("w0", "open")
        world.client.pause_job("job", paused=False)
        assert world.finish().state == "done"
        assert not world.result()["warnings"]
    assert comparable(world.result()) == comparable(World(workers=1, seed=1).run(config(1, max_time=60.0), VARIABLE))


def test_tasks_are_charged_to_users_and_end_their_task_time() -> None:
    with hurried():
        world = World(workers=0, seed=1)
        controller = world.service.controller
        controller.queue.limits = Limits(user=Allowance(task_time=0.0))
        submit_as(world, "ann", "of-ann")
        controller._charge("of-ann", 1.0)
        world.client.pause(5.0)
        view = world.client.status("of-ann")
        assert (view.state, "task time" in (view.reason or "")) == ("queued", True)
        world.start_worker("w0")
        world.client.pause(5.0)
        assert world.client.status("of-ann").state == "queued"
        controller.queue.limits = Limits()
        world.client.pause(5.0)
        assert world.client.status("of-ann").state == "running"
