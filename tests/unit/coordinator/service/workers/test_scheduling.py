"""Islands are spread evenly and always in the same way, when enough workers are there."""

from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import cast

import pytest
from hypothesis import given
from hypothesis import strategies as st

from atoll import ENGINE_REVISION, PROTOCOL_VERSION, VERSION
from atoll.search.commit_order import CommitOrder
from atoll.wire.messages.handshake import Hello
from atoll.wire.messages.workers import Placement, WorkerStatus
from atoll_coordinator.service.jobs.job import Job
from atoll_coordinator.service.monitoring.event_log import EventLog
from atoll_coordinator.service.search.archipelago import Archipelago
from atoll_coordinator.service.search.collector import Limits, Stagnation
from atoll_coordinator.service.store.store import Store
from atoll_coordinator.service.workers.crash_loops import CrashLoops
from atoll_coordinator.service.workers.membership import ABSENCE_S, Membership
from atoll_coordinator.service.workers.quarantine import Quarantine
from atoll_coordinator.service.workers.scheduling import EXPECT_S, REPLACE_WITHIN_S, Plan, Scheduler, spread

COMMIT_ORDER = CommitOrder(generations=100, stride=10, joining=8)

NAMES = st.lists(st.text("abc", min_size=1), min_size=1, unique=True)


@given(st.integers(1, 40), st.integers(0, 100), NAMES)
def test_no_worker_has_two_islands_more_than_another(islands: int, first: int, workers: list[str]) -> None:
    placed = spread(islands, first, workers)
    counts = [placed.count(worker) for worker in workers]
    assert len(placed) == islands
    assert max(counts) - min(counts) <= 1


@given(st.integers(1, 40), st.integers(0, 100), NAMES)
def test_the_order_in_which_workers_are_named_does_not_matter(islands: int, first: int, workers: list[str]) -> None:
    assert spread(islands, first, workers) == spread(islands, first, workers[::-1])


def test_variables_with_fewer_islands_than_workers_lie_on_different_workers() -> None:
    workers = ["a", "b", "c", "d"]
    assert spread(2, 0, workers) == ("a", "b")
    assert spread(2, 2, workers) == ("c", "d")


def members(*names: str) -> Membership:
    membership = Membership()
    for name in names:
        join(membership, name)
    return membership


def join(membership: Membership, name: str) -> None:
    hello = Hello(
        role="worker", name=name, instance="i", protocol=PROTOCOL_VERSION, version=VERSION, engine=ENGINE_REVISION
    )
    assert membership.register(hello, 0.0) is None
    membership.record_heartbeat(name, WorkerStatus(instance="i", incarnation=1, state="ready", progress=0), 0.0)


def archipelago(*workers: str, islands: int = 4) -> Archipelago:
    limits = Limits(islands=islands, epochs=10, stagnation=Stagnation(5), commit_order=COMMIT_ORDER)
    made = Archipelago("job", "x", limits, lambda front: 0.0, lambda program: None)
    if workers:
        placement = Placement(
            incarnation=1,
            term=1,
            job="job",
            variable="x",
            workers=workers,
            epochs=10,
            interval=16,
            commit_order=COMMIT_ORDER,
        )
        made.place(placement, 0.0)
    return made


@pytest.fixture
def scheduler_of() -> Iterator[Callable[..., Scheduler]]:
    """Return a function that makes a scheduler, over a store without any deaths."""
    with Store.open(None) as store:
        crash_loops = CrashLoops(store, EventLog(store, lambda: ""))
        yield lambda membership, expected=1: Scheduler(membership, Quarantine(membership, crash_loops), expected)


def plan_of(scheduler: Scheduler, *archipelagos: Archipelago, now: float = 0.0) -> Plan:
    """Return the plan for one running job of these archipelagos."""
    by_name = {str(number): each for number, each in enumerate(archipelagos)}
    job = SimpleNamespace(state="running", archipelagos=by_name, open_archipelagos=archipelagos)
    return scheduler.plan([cast(Job, job)], now)


def placed(scheduler: Scheduler, *archipelagos: Archipelago, now: float = 0.0) -> list[tuple[str, ...]]:
    return [each.workers for each in plan_of(scheduler, *archipelagos, now=now).assignments]


def test_without_workers_nothing_is_placed(scheduler_of: Callable[..., Scheduler]) -> None:
    assert placed(scheduler_of(members()), archipelago()) == []


def test_what_is_not_placed_is_placed_on_all_who_are_ready(scheduler_of: Callable[..., Scheduler]) -> None:
    scheduler = scheduler_of(members("b", "a"))
    assert placed(scheduler, archipelago(islands=3), archipelago()) == [("a", "b", "a"), ("b", "a", "b", "a")]


def test_the_expected_workers_are_waited_for_but_not_for_ever(scheduler_of: Callable[..., Scheduler]) -> None:
    scheduler = scheduler_of(members("a"), 3)
    assert placed(scheduler, now=-EXPECT_S) == []
    assert placed(scheduler, archipelago()) == []
    assert placed(scheduler, archipelago(), now=0.9 * EXPECT_S) == []
    assert placed(scheduler, archipelago(), now=EXPECT_S) == [("a", "a", "a", "a")]


def test_once_the_expected_workers_were_there_nobody_is_waited_for_again(
    scheduler_of: Callable[..., Scheduler],
) -> None:
    membership = members("a", "b")
    scheduler = scheduler_of(membership, 2)
    assert placed(scheduler, archipelago()) == [("a", "b", "a", "b")]
    membership.record_presence("b", False, 0.0)
    assert placed(scheduler, archipelago()) == [("a", "a", "a", "a")]


def test_a_newcomer_takes_part_soon_after_a_placement_and_later_not(scheduler_of: Callable[..., Scheduler]) -> None:
    scheduler = scheduler_of(members("a", "b"))
    assert placed(scheduler, archipelago("a", "a", "a", "a"), now=REPLACE_WITHIN_S) == [("a", "b", "a", "b")]
    assert placed(scheduler, archipelago("a", "a", "a", "a"), now=REPLACE_WITHIN_S + 0.1) == []
    assert placed(scheduler, archipelago("a", "b", "a", "b")) == []
    assert placed(scheduler_of(members("a", "b", "c")), archipelago("a", "b", islands=2)) == []


def test_a_newcomer_that_comes_later_is_waited_for_at_a_checkpoint(scheduler_of: Callable[..., Scheduler]) -> None:
    made = archipelago("a", "a", "a", "a")
    assert not made.is_planned
    plan_of(scheduler_of(members("a", "b")), made, now=REPLACE_WITHIN_S + 0.1)
    assert made.is_planned


def test_a_placement_is_broken_when_one_of_its_workers_is_lost(scheduler_of: Callable[..., Scheduler]) -> None:
    membership = members("a", "b")
    scheduler, made = scheduler_of(membership), archipelago("a", "b", "a", "b")
    assert plan_of(scheduler, made).broken == []
    membership.record_presence("b", False, 0.0)
    assert plan_of(scheduler, made).broken == []
    membership.expire(ABSENCE_S)
    plan = plan_of(scheduler, made, archipelago("a", "a", "a", "a"))
    assert plan.broken == [made.key]
    assert [each.workers for each in plan.assignments] == [("a", "a", "a", "a")]
    assert plan.released == []
