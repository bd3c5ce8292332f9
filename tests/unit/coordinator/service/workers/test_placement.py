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
from atoll_coordinator.service.workers.crash_loops import CrashLoops, Quarantine
from atoll_coordinator.service.workers.membership import ABSENCE_S, Membership
from atoll_coordinator.service.workers.placement import (
    DATASET_ROOM,
    EXPECT_S,
    PlacementPlan,
    Placer,
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


@given(st.lists(st.integers(1, 40), min_size=1, max_size=8), NAMES)
def test_few_workers_have_an_archipelago_and_loads_are_even_when_all_are_placed(
    sizes: list[int], workers: list[str]
) -> None:
    load = Counter[str]()
    for islands in sizes:
        placed = spread(islands, load, workers, all_islands=sum(sizes))
        load.update(placed)
        assert len(placed) == islands
    loads = [load[worker] for worker in workers]
    assert max(loads) - min(loads) <= 1


def test_many_archipelagos_are_on_few_workers_each(placer_of: Callable[..., Placer]) -> None:
    """Eight islands pull from few workers: 3 workers make 6 pulls in an epoch, and 8 workers would make 56."""
    names = [f"w{number:02}" for number in range(32)]
    placer = placer_of(members(*names))
    many = [archipelago(islands=8, variable=f"v{number}") for number in range(32)]
    workers = placed(placer, *many)
    assert Counter(worker for one in workers for worker in one) == dict.fromkeys(names, 8)
    pulls = [len(set(one)) * (len(set(one)) - 1) for one in workers]
    assert sum(pulls) <= 1.25 * sum(map(len, workers))
    (alone,) = placed(placer, archipelago(islands=8))
    assert len(set(alone)) == 8


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
def placer_of() -> Iterator[Callable[..., Placer]]:
    """Return a function that makes a placer, over a store without any deaths."""
    with Store.open(None) as store:
        crash_loops = CrashLoops(store, EventLog(store, lambda: ""))
        yield lambda membership, expected=1: Placer(membership, Quarantine(membership, crash_loops), expected)


def plan_of(placer: Placer, *archipelagos: Archipelago, now: float = 0.0) -> PlacementPlan:
    """Return the plan for one running job of these archipelagos."""
    return placer.plan_placements([running(*archipelagos)], now)


def running(*archipelagos: Archipelago, size: int = 0) -> Job:
    by_name = {str(number): archipelago for number, archipelago in enumerate(archipelagos)}
    fields = {"id": "job", "state": "running", "is_held": False, "prepared": SimpleNamespace(size=size)}
    return cast(Job, SimpleNamespace(**fields, archipelagos=by_name, open_archipelagos=archipelagos))


def carry_out(plan: PlacementPlan, term: int, now: float) -> None:
    for assignment in plan.assignments:
        assignment.archipelago.place(assignment.placement(1, term), now)


def placed(placer: Placer, *archipelagos: Archipelago, now: float = 0.0) -> list[tuple[str, ...]]:
    return [assignment.workers for assignment in plan_of(placer, *archipelagos, now=now).assignments]


def test_the_expected_workers_are_waited_for_but_not_for_ever(placer_of: Callable[..., Placer]) -> None:
    placer = placer_of(members("a"), 3)
    assert placed(placer, now=-EXPECT_S) == []
    assert placed(placer, archipelago()) == []
    assert placed(placer, archipelago(), now=0.9 * EXPECT_S) == []
    assert placed(placer, archipelago(), now=EXPECT_S) == [("a", "a", "a", "a")]


def test_what_a_lost_worker_had_goes_to_those_with_the_least_to_do(placer_of: Callable[..., Placer]) -> None:
    membership = members("a", "b", "c")
    placer = placer_of(membership)
    jobs = [
        running(archipelago("a", islands=1, job="p")),
        running(archipelago("a", islands=1, job="q")),
        running(archipelago("b", islands=1, job="r")),
    ]
    membership.record_presence("a", False, 0.0)
    membership.expire(ABSENCE_S)
    plan = placer.plan_placements(jobs, 60.0)
    assert plan.broken == [("p", "x"), ("q", "x")]
    assert [assignment.workers for assignment in plan.assignments] == [("c",), ("b",)]


@pytest.mark.slow
@given(st.lists(st.tuples(st.sampled_from("abcd"), st.integers(1, 6)), min_size=1, max_size=6), st.integers(1, 4))
def test_moves_come_to_an_end(placements: list[tuple[str, int]], workers: int) -> None:
    """Wherever archipelagos lie, they are moved a few times at most, and then not again."""
    with Store.open(None) as store:
        membership = members(*"abcd"[:workers])
        crash_loops = CrashLoops(store, EventLog(store, lambda: ""))
        placer = Placer(membership, Quarantine(membership, crash_loops))
        jobs = [
            running(archipelago(*worker * islands, islands=islands, job=f"job{number}"))
            for number, (worker, islands) in enumerate(placements)
        ]
        for _ in range(1 + len(jobs) * 8):
            carry_out(placer.plan_placements(jobs, 0.0), 2, 0.0)
        assert placer.plan_placements(jobs, 0.0).assignments == []


def heard(membership: Membership, name: str, **said: object) -> None:
    status = WorkerStatus(instance="i", incarnation=1, state="ready", progress=1)
    membership.record_heartbeat(name, status.model_copy(update=said), 0.0)


def test_of_workers_with_as_much_to_do_those_come_first_that_have_the_dataset(
    placer_of: Callable[..., Placer],
) -> None:
    membership = members("a", "b", "c")
    heard(membership, "c", jobs=("job",))
    assert placed(placer_of(membership), archipelago(islands=2), archipelago(islands=1)) == [("c", "a"), ("b",)]


def test_machines_without_room_for_a_dataset_are_left_out_while_there_are_others(
    placer_of: Callable[..., Placer],
) -> None:
    membership = members("a", "b")
    heard(membership, "a", available_bytes=DATASET_ROOM * 1000 - 1)
    placer = placer_of(membership)
    (large,) = placer.plan_placements([running(archipelago(islands=2), size=1000)], 0.0).assignments
    assert large.workers == ("b", "b")
    (fits,) = placer.plan_placements([running(archipelago(islands=2), size=999)], 0.0).assignments
    assert fits.workers == ("a", "b")
    heard(membership, "b", available_bytes=0)
    (nowhere,) = placer.plan_placements([running(archipelago(islands=2), size=1000)], 0.0).assignments
    assert nowhere.workers == ("a", "b")


def test_a_cordoned_worker_gets_nothing_and_a_drained_one_hands_over(placer_of: Callable[..., Placer]) -> None:
    membership = members("a", "b")
    placer, made = placer_of(membership), archipelago("a", "b", islands=2)
    membership.set_cordons({"b": False})
    assert placed(placer, archipelago(islands=2)) == [("a", "a")]
    assert placed(placer, made, now=1.0) == []
    membership.set_cordons({"b": True})
    carry_out(plan_of(placer, made, now=2.0), 2, 2.0)  # it has no commit yet: what is lost is next to nothing
    assert made.workers == ("a",)
    assert [membership.service(name) for name in "ab"] == ["open", "draining"]
