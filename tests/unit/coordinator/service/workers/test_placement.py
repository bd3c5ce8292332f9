"""Islands are spread evenly and always in the same way, when enough workers are there."""

from hypothesis import given
from hypothesis import strategies as st

from atoll import ENGINE_REVISION, PROTOCOL_VERSION, VERSION
from atoll.search.commit_order import CommitOrder
from atoll.wire.messages.handshake import Hello
from atoll.wire.messages.workers import Placement, WorkerStatus
from atoll_coordinator.service.search.archipelago import Archipelago
from atoll_coordinator.service.search.collector import Limits
from atoll_coordinator.service.workers.membership import ABSENCE_S, Membership
from atoll_coordinator.service.workers.placement import EXPECT_S, REPLACE_WITHIN_S, Placer, spread

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
    assert membership.greet(hello, 0.0) is None
    membership.hear(name, WorkerStatus(instance="i", incarnation=1, state="ready", progress=0), 0.0)


def archipelago(*workers: str, islands: int = 4) -> Archipelago:
    limits = Limits(islands=islands, epochs=10, stagnation=5, commit_order=COMMIT_ORDER)
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


def placer(membership: Membership, expected: int = 1) -> Placer:
    return Placer(membership, expected)


def test_without_workers_nothing_is_placed() -> None:
    assert placer(members()).choose(archipelago(), 0, 0.0) is None


def test_what_is_not_placed_is_placed_on_all_who_are_ready() -> None:
    assert placer(members("b", "a")).choose(archipelago(), 1, 0.0) == ("b", "a", "b", "a")


def test_the_expected_workers_are_waited_for_but_not_for_ever() -> None:
    waiting = placer(members("a"), expected=3)
    assert waiting.choose(archipelago(), 0, 0.0) is None
    assert waiting.choose(archipelago(), 0, 0.9 * EXPECT_S) is None
    assert waiting.choose(archipelago(), 0, EXPECT_S) == ("a", "a", "a", "a")


def test_once_the_expected_workers_were_there_nobody_is_waited_for_again() -> None:
    membership = members("a", "b")
    waiting = placer(membership, expected=2)
    assert waiting.choose(archipelago(), 0, 0.0) == ("a", "b", "a", "b")
    membership.see("b", False, 0.0)
    assert waiting.choose(archipelago(), 0, 0.0) == ("a", "a", "a", "a")


def test_a_newcomer_takes_part_soon_after_a_placement_and_later_not() -> None:
    membership = members("a", "b")
    assert placer(membership).choose(archipelago("a", "a", "a", "a"), 0, REPLACE_WITHIN_S) == ("a", "b", "a", "b")
    assert placer(membership).choose(archipelago("a", "a", "a", "a"), 0, REPLACE_WITHIN_S + 0.1) is None
    assert placer(membership).choose(archipelago("a", "b", "a", "b"), 0, 0.0) is None
    assert placer(members("a", "b", "c")).choose(archipelago("a", "b", islands=2), 0, 0.0) is None


def test_a_placement_is_broken_when_one_of_its_workers_is_lost() -> None:
    membership = members("a", "b")
    watching = placer(membership)
    assert not watching.is_broken(archipelago("a", "b", "a", "b"))
    membership.see("b", False, 0.0)
    assert not watching.is_broken(archipelago("a", "b", "a", "b"))
    membership.expire(ABSENCE_S)
    assert watching.is_broken(archipelago("a", "b", "a", "b"))
    assert not watching.is_broken(archipelago("a", "a", "a", "a"))
    assert not watching.is_broken(archipelago())
