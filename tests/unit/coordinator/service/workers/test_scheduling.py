"""Islands are spread evenly and always in the same way, when enough workers are there."""

from collections import Counter
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import cast

import pytest
from hypothesis import given
from hypothesis import strategies as st

from atoll_coordinator.service.jobs.job import Job
from atoll_coordinator.service.monitoring.event_log import EventLog
from atoll_coordinator.service.search.archipelago import Archipelago
from atoll_coordinator.service.store.store import Store
from atoll_coordinator.service.workers.crash_loops import CrashLoops
from atoll_coordinator.service.workers.membership import ABSENCE_S, Membership
from atoll_coordinator.service.workers.quarantine import Quarantine
from atoll_coordinator.service.workers.scheduling import (
    DATASET_ROOM,
    EXPECT_S,
    REPLACE_WITHIN_S,
    Plan,
    Scheduler,
    spread,
)
from atoll_core import ENGINE_REVISION, PROTOCOL_VERSION, VERSION
from atoll_core.wire.messages.handshake import Hello
from atoll_core.wire.messages.workers import WorkerStatus
from tests.unit.coordinator.service.workers.archipelagos import archipelago

NAMES = st.lists(st.text("abc", min_size=1), min_size=1, unique=True)


@given(st.lists(st.integers(1, 40), min_size=1, max_size=8), NAMES)
def test_no_worker_has_two_islands_more_than_another(sizes: list[int], workers: list[str]) -> None:
    load = Counter[str]()
    for islands in sizes:
        placed = spread(islands, load, workers)
        counts = [placed.count(worker) for worker in workers]
        load.update(placed)
        loads = [load[worker] for worker in workers]
        assert len(placed) == islands
        assert max(counts) - min(counts) <= 1
        assert max(loads) - min(loads) <= 1


@given(st.integers(1, 40), st.dictionaries(st.text("abc", min_size=1), st.integers(0, 9)), NAMES)
def test_the_order_in_which_workers_are_named_does_not_matter(
    islands: int, load: dict[str, int], workers: list[str]
) -> None:
    assert spread(islands, load, workers) == spread(islands, load, workers[::-1])


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


@pytest.fixture
def scheduler_of() -> Iterator[Callable[..., Scheduler]]:
    """Return a function that makes a scheduler, over a store without any deaths."""
    with Store.open(None) as store:
        crash_loops = CrashLoops(store, EventLog(store, lambda: ""))
        yield lambda membership, expected=1: Scheduler(membership, Quarantine(membership, crash_loops), expected)


def plan_of(scheduler: Scheduler, *archipelagos: Archipelago, now: float = 0.0) -> Plan:
    """Return the plan for one running job of these archipelagos."""
    return scheduler.plan([running(*archipelagos)], now)


def running(*archipelagos: Archipelago, size: int = 0) -> Job:
    by_name = {str(number): archipelago for number, archipelago in enumerate(archipelagos)}
    fields = {"id": "job", "state": "running", "is_held": False, "prepared": SimpleNamespace(size=size)}
    return cast(Job, SimpleNamespace(**fields, archipelagos=by_name, open_archipelagos=archipelagos))


def carry_out(plan: Plan, term: int, now: float) -> None:
    for assignment in plan.assignments:
        assignment.archipelago.place(assignment.placement(1, term), now)


def placed(scheduler: Scheduler, *archipelagos: Archipelago, now: float = 0.0) -> list[tuple[str, ...]]:
    return [assignment.workers for assignment in plan_of(scheduler, *archipelagos, now=now).assignments]


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
    assert [assignment.workers for assignment in plan.assignments] == [("a", "a", "a", "a")]
    assert plan.released == []


def four_jobs() -> list[Job]:
    """Return jobs of two variables with eight islands each, none of them placed."""
    return [
        running(*(archipelago(islands=8, job=f"job{number}", variable=name) for name in "xy")) for number in range(4)
    ]


def islands_of(jobs: list[Job]) -> Counter[str]:
    archipelagos = [archipelago for job in jobs for archipelago in job.open_archipelagos]
    return Counter(
        name
        for archipelago in archipelagos
        if archipelago.placement is not None
        for name in archipelago.placement.workers
    )


def test_jobs_lie_on_different_workers_as_long_as_there_are_idle_ones(scheduler_of: Callable[..., Scheduler]) -> None:
    scheduler, jobs = scheduler_of(members(*(f"w{number:02}" for number in range(64)))), four_jobs()
    for number in range(4):  # they come one after the other
        carry_out(scheduler.plan(jobs[: number + 1], 10.0 * number), 1, 10.0 * number)
    assert islands_of(jobs) == Counter({f"w{number:02}": 1 for number in range(64)})


def test_what_a_lost_worker_had_goes_to_those_with_the_least_to_do(scheduler_of: Callable[..., Scheduler]) -> None:
    membership = members("a", "b", "c")
    scheduler = scheduler_of(membership)
    jobs = [
        running(archipelago("a", islands=1, job="p")),
        running(archipelago("a", islands=1, job="q")),
        running(archipelago("b", islands=1, job="r")),
    ]
    membership.record_presence("a", False, 0.0)
    membership.expire(ABSENCE_S)
    plan = scheduler.plan(jobs, 60.0)
    assert plan.broken == [("p", "x"), ("q", "x")]
    assert [assignment.workers for assignment in plan.assignments] == [("c",), ("b",)]


def test_workers_that_come_later_get_islands_where_others_have_several(scheduler_of: Callable[..., Scheduler]) -> None:
    """Two archipelagos share the same workers, each with one island on each; then as many workers join."""
    membership = members("a", "b")
    scheduler = scheduler_of(membership)
    jobs = [running(archipelago("a", "b", islands=2, job=name)) for name in "pq"]
    assert not any(scheduler.plan(jobs, 60.0).assignments)
    assert not any(archipelago.is_planned for job in jobs for archipelago in job.open_archipelagos)
    join(membership, "c")
    join(membership, "d")
    scheduler.plan(jobs, 60.0)
    assert any(archipelago.is_planned for job in jobs for archipelago in job.open_archipelagos)
    carry_out(scheduler.plan(jobs, REPLACE_WITHIN_S), 2, REPLACE_WITHIN_S)
    assert islands_of(jobs) == Counter("abcd")
    assert scheduler.plan(jobs, REPLACE_WITHIN_S).assignments == []


@pytest.mark.slow
@given(st.lists(st.tuples(st.sampled_from("abcd"), st.integers(1, 6)), min_size=1, max_size=6), st.integers(1, 4))
def test_moves_come_to_an_end(placements: list[tuple[str, int]], workers: int) -> None:
    """Wherever archipelagos lie, they are moved a few times at most, and then not again."""
    with Store.open(None) as store:
        membership = members(*"abcd"[:workers])
        crash_loops = CrashLoops(store, EventLog(store, lambda: ""))
        scheduler = Scheduler(membership, Quarantine(membership, crash_loops))
        jobs = [
            running(archipelago(*worker * islands, islands=islands, job=f"job{number}"))
            for number, (worker, islands) in enumerate(placements)
        ]
        for _ in range(1 + len(jobs) * 8):
            carry_out(scheduler.plan(jobs, 0.0), 2, 0.0)
        assert scheduler.plan(jobs, 0.0).assignments == []


def heard(membership: Membership, name: str, **said: object) -> None:
    status = WorkerStatus(instance="i", incarnation=1, state="ready", progress=1)
    membership.record_heartbeat(name, status.model_copy(update=said), 0.0)


def test_of_workers_with_as_much_to_do_those_come_first_that_have_the_dataset(
    scheduler_of: Callable[..., Scheduler],
) -> None:
    membership = members("a", "b", "c")
    heard(membership, "c", jobs=("job",))
    assert placed(scheduler_of(membership), archipelago(islands=2), archipelago(islands=1)) == [("c", "a"), ("b",)]


def test_machines_without_room_for_a_dataset_are_left_out_while_there_are_others(
    scheduler_of: Callable[..., Scheduler],
) -> None:
    membership = members("a", "b")
    heard(membership, "a", available_bytes=DATASET_ROOM * 1000 - 1)
    scheduler = scheduler_of(membership)
    (large,) = scheduler.plan([running(archipelago(islands=2), size=1000)], 0.0).assignments
    assert large.workers == ("b", "b")
    (fits,) = scheduler.plan([running(archipelago(islands=2), size=999)], 0.0).assignments
    assert fits.workers == ("a", "b")
    heard(membership, "b", available_bytes=0)
    (nowhere,) = scheduler.plan([running(archipelago(islands=2), size=1000)], 0.0).assignments
    assert nowhere.workers == ("a", "b")


def test_a_cordoned_worker_gets_nothing_and_a_drained_one_hands_over(scheduler_of: Callable[..., Scheduler]) -> None:
    membership = members("a", "b")
    scheduler, made = scheduler_of(membership), archipelago("a", "b", islands=2)
    membership.set_cordons({"b": False})
    assert placed(scheduler, archipelago(islands=2)) == [("a", "a")]
    assert placed(scheduler, made, now=1.0) == []
    membership.set_cordons({"b": True})
    carry_out(plan_of(scheduler, made, now=2.0), 2, 2.0)  # it has no commit yet: what is lost is next to nothing
    assert made.workers == ("a",)
    assert [membership.service(name) for name in "ab"] == ["open", "draining"]
