"""Followers hear every event once and in order, see the end, and resume after cuts and restarts."""

from functools import partial

import pytest

from atoll.client.client import Client
from atoll.client.follower import Subscription
from atoll_coordinator.service.monitoring.followers import INTERVAL_S, LEASE_S
from atoll_core.errors import RefusedError, UnreachableError
from atoll_core.wire import topics
from atoll_core.wire.codec import encode
from atoll_core.wire.messages.clients import Following, JobChange
from atoll_core.wire.messages.views import FINAL_STATES, EventView, JobView
from tests.simulation.bus.fault_plan import Plan
from tests.simulation.harness.short_jobs import short_job
from tests.simulation.harness.simulated_cluster import World, bus_of

config = partial(short_job, islands=3, max_epochs=40, stagnation=1000)


class Heard:
    """What a follower has heard of a job."""

    def __init__(self, client: Client, job: str | None = "job", after: int | None = 0) -> None:
        self.client = client
        self.subscription = Subscription(client, job, after)
        self.events: list[EventView] = []
        self.views: list[JobView] = []

    def follow(self, limit_s: float = 600.0) -> JobView:
        """Follow to the job's end."""
        end = self.client.now() + limit_s
        while not (self.views and self.views[-1].state in FINAL_STATES):
            assert self.client.now() < end, self.views[-1:]
            try:
                self.take(self.subscription.wait(1.0))
            except UnreachableError:
                continue
        return self.views[-1]

    def take(self, change: JobChange | None) -> None:
        if change is not None:
            self.events += change.events
            self.views += [change.view] if change.view is not None else []


def whole(world: World) -> list[int]:
    return [event.number for event in world.client.events("job", 0, 1000)]


def test_a_follower_hears_every_event_once_and_sees_every_state_and_the_end() -> None:
    world = World(workers=2, slowness=5.0)
    world.submit(config(1), "x,y")
    heard = Heard(world.client)
    view = heard.follow()
    assert view.state == "done"
    assert view == world.client.status("job")
    assert [event.number for event in heard.events] == whole(world)
    assert {"running", "refining"} <= {view.state for view in heard.views}


def test_nothing_is_asked_while_changes_come(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World(workers=2, slowness=50.0)
    world.submit(config(1, max_epochs=400), "x,y")
    asked: list[int] = []
    follow = Client.follow

    def counted(self: Client, job: str | None, after: int | None, sequence: int) -> Following:
        asked.append(sequence)
        return follow(self, job, after, sequence)

    monkeypatch.setattr(Client, "follow", counted)
    heard, began = Heard(world.client, after=None), world.client.now()
    heard.follow()
    seconds = world.client.now() - began
    assert seconds > 5.0
    assert len(asked) <= 2 + 3 * seconds / LEASE_S
    assert len(heard.views) <= 8 + seconds / INTERVAL_S  # what comes in between goes together
    assert heard.events == [] or heard.events[0].event != "submitted"


@pytest.mark.parametrize("seed", [1, 5, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (0, 3, 4))])
def test_what_a_bad_network_loses_is_told_again(seed: int) -> None:
    world = World(workers=2, seed=seed, plan=Plan(drop=0.2), slowness=5.0)
    world.submit(config(seed), "x,y")
    heard = Heard(world.client)
    heard.follow()
    for _ in range(20):  # the last events may have been lost behind the end
        try:
            heard.take(heard.subscription.wait(3.0))
        except UnreachableError:
            continue
    numbers = [event.number for event in heard.events]
    assert numbers == sorted(set(numbers))
    assert set(whole(world)) <= set(numbers)


def test_a_missed_change_is_noticed_and_asked_for() -> None:
    world = World(workers=2, slowness=20.0)
    world.submit(config(1, max_epochs=100), "x,y")
    heard = Heard(world.client)
    for _ in range(5):
        heard.take(heard.subscription.wait(1.0))
    lost = world.client.next_change(5.0)
    assert lost is not None
    heard.follow()
    assert [event.number for event in heard.events] == whole(world)


def test_changes_of_a_former_lease_of_others_and_of_strangers_say_nothing() -> None:
    world = World(workers=2, slowness=20.0)
    world.submit(config(1), "x,y")
    heard = Heard(world.client)
    heard.take(heard.subscription.wait(1.0))
    key = topics.client(world.store.cluster, world.client._name, "changes")
    stranger = bus_of(world, "stranger")
    for change in (JobChange(job="other", sequence=2**60, previous=0), JobChange(job="job", sequence=1, previous=0)):
        stranger.put(key, encode(change))
    assert heard.follow().state == "done"
    assert [event.number for event in heard.events] == whole(world)


def test_who_follows_no_more_is_forgotten_after_the_lease(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tests.simulation.harness.stub_islands.HIT_EPOCHS", 10**9)
    world = World(workers=1, slowness=20.0)
    world.submit(config(1, max_epochs=10**6), "x")
    heard = Heard(world.client)
    heard.take(heard.subscription.wait(1.0))
    assert len(world.service._followers) == 1
    world.client.pause(LEASE_S + 1.0)
    assert len(world.service._followers) == 0
    world.client.cancel("job")
    assert heard.follow().state == "cancelled"
    assert [event.number for event in heard.events] == whole(world)


def test_an_unknown_job_cannot_be_followed() -> None:
    world = World(workers=1)
    with pytest.raises(RefusedError, match="there is no job"):
        Subscription(world.client, "nothing").wait(1.0)


def test_all_that_happens_can_be_followed() -> None:
    world = World(workers=1)
    heard = Heard(world.client, None)
    heard.take(heard.subscription.wait(1.0))
    world.submit(config(1, max_epochs=3), "x")
    world.finish()
    for _ in range(3):
        heard.take(heard.subscription.wait(1.0))
    assert [event.number for event in heard.events] == [e.number for e in world.client.events(None, 0, 1000)]
