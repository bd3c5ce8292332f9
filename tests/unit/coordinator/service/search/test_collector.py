"""Collecting: complete epochs in order, ends in their order, and nothing counted twice."""

import itertools
import math
from collections.abc import Iterable, Iterator
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from atoll_coordinator.service.search.collector import Collector, DivergedError, entries_of
from atoll_coordinator.service.search.ending import SearchLimits, Stagnation
from atoll_core.errors import RemoteProtocolError
from atoll_core.search.commit_order import CommitOrder
from atoll_core.search.pareto import FrontEntry, merge
from atoll_core.wire.messages.epochs import Addition, HitStatement, IslandReport, SliceCounters

COMMIT_ORDER = CommitOrder(generations=100, stride=10, joining=8)
LIMITS = SearchLimits(islands=2, epochs=50, stagnation=Stagnation(5), commit_order=COMMIT_ORDER)


def best_error(front: tuple[FrontEntry, ...]) -> float:
    return min((100.0 * entry.error for entry in front), default=math.inf)


@pytest.fixture
def collector() -> Iterator[Collector]:
    made = Collector("x", LIMITS, best_error)
    yield made
    made.validate()


def report(
    island: int,
    error: float = 1.0,
    hit: int | None = None,
    digest: str = "ab" * 16,
    count: int = 10,
    generations: int = 100,
    found_at: tuple[int, ...] = (4,),
    near: Iterable[Addition] = (),
) -> IslandReport:
    """Return a report of an island that counts `count` / 10 evaluations a slice, those of earlier epochs apart."""
    reached = hit or generations
    ends = range(10, reached + 1, 10)
    return IslandReport(
        island=island,
        generations=reached,
        hit=None if hit is None else HitStatement(generation=hit, error=0.0),
        additions=tuple(
            Addition(complexity=3 + order, error=error / (1 + order), mse=error, generation=at, program=b"p")
            for order, at in enumerate(found_at)
        ),
        runners_up=tuple(near),
        counters=tuple(
            SliceCounters(generation=end, evaluations={"offspring": count * end // 100, "fit": 2 * count * end // 100})
            for end in ends
        ),
        best_error=error,
        digest=digest,
    )


def fill(collector: Collector, epoch: int, *reports: IslandReport) -> None:
    collector.add_reports("w", epoch, reports or (report(0), report(1)), float(epoch + 1))


def test_another_digest_for_the_same_key_is_divergence_and_names_both_workers(collector: Collector) -> None:
    collector.add_reports("first", 0, [report(0)], 1.0)
    with pytest.raises(DivergedError, match=r"first and second .* island 0 of x in epoch 0"):
        collector.add_reports("second", 0, [report(0, digest="cd" * 16)], 2.0)


@pytest.mark.parametrize(("epoch", "island"), [(50, 0), (0, 2)])
def test_islands_and_epochs_that_do_not_exist_are_refused(collector: Collector, epoch: int, island: int) -> None:
    with pytest.raises(RemoteProtocolError, match="there is no such island or epoch"):
        collector.add_reports("w", epoch, [report(0), report(island)], 1.0)
    assert collector.first_missing([0], 1) == 0


def test_errors_that_are_not_finite_never_enter_the_front() -> None:
    wild = report(0).model_copy(
        update={
            "additions": (Addition.model_construct(complexity=1, error=math.inf, mse=0.0, generation=1, program=b""),)
        }
    )
    assert merge((), entries_of(0, wild, wild.additions, 100)) == ()


def test_convergence_has_the_improvements_of_each_island_in_order(collector: Collector) -> None:
    fill(collector, 0, report(0, 1.0, found_at=(4, 4, 9)), report(1, 8.0))
    fill(collector, 1, report(0, 1.0), report(1, 4.0, found_at=(6,)))
    generations = {
        island: [(entry.generation, entry.error) for entry in entries]
        for island, entries in collector.state.convergence.items()
    }
    assert generations == {0: [(4, 1.0), (4, 0.5), (9, pytest.approx(1 / 3))], 1: [(4, 8.0), (106, 4.0)]}


def test_a_report_given_up_at_a_hit_waits_for_the_report_of_that_hit(collector: Collector) -> None:
    assert not collector.add_reports("w0", 0, [report(0, generations=20)], 1.0)
    assert collector.state.epochs == 0
    assert collector.add_reports("w1", 0, [report(1, hit=20)], 2.0)
    assert collector.cut is not None


# ------------------------------------------------------------------------------------------------- ends


@pytest.mark.parametrize(
    ("first", "second"),
    [(report(0, hit=20), report(0, generations=50)), (report(0, generations=50), report(0, hit=20))],
)
def test_who_went_beyond_a_hit_contradicts_who_met_it(
    collector: Collector, first: IslandReport, second: IslandReport
) -> None:
    collector.add_reports("first", 0, [first], 1.0)
    with pytest.raises(DivergedError, match=r"first and second"):
        collector.add_reports("second", 0, [second], 2.0)


@pytest.mark.parametrize(
    "broken",
    [
        report(0, generations=40).model_copy(update={"generations": 50}),
        report(0).model_copy(update={"counters": ()}),
        report(0, hit=20).model_copy(update={"hit": HitStatement(generation=10, error=0.0)}),
        report(0, hit=20).model_copy(update={"hit": HitStatement(generation=17, error=0.0), "generations": 17}),
        report(0, generations=110),
    ],
)
def test_a_report_without_the_counters_of_its_slices_is_refused(collector: Collector, broken: IslandReport) -> None:
    with pytest.raises(RemoteProtocolError, match="slices missing"):
        collector.add_reports("w", 0, [broken], 1.0)


def test_with_a_law_the_first_epoch_is_the_last_unless_it_met_the_target() -> None:
    for hit, why in ((None, "law"), (50, "target")):
        collector = Collector("x", replace(LIMITS, has_law=True), best_error)
        fill(collector, 0, report(0, error=0.1, hit=hit), report(1))
        assert collector.cut is not None
        assert (collector.cut.why, collector.cut.epochs) == (why, 1)


@pytest.mark.parametrize(("improved_at", "due_at"), [(0, 5), (4, 9), (5, 11), (20, 41)])
def test_what_took_the_longer_to_get_better_is_waited_for_the_longer(improved_at: int, due_at: int) -> None:
    growing = Stagnation(5, grows=True)
    assert not growing.is_due(due_at - 1, improved_at)
    assert growing.is_due(due_at, improved_at)
    assert Stagnation(5).is_due(improved_at + 5, improved_at)


def test_the_target_comes_before_stagnation_and_stagnation_before_the_last_epoch() -> None:
    for hit, why in ((70, "target"), (None, "stagnation")):
        collector = Collector(
            "x", SearchLimits(islands=1, epochs=2, stagnation=Stagnation(1), commit_order=COMMIT_ORDER), best_error
        )
        fill(collector, 0, report(0))
        fill(collector, 1, report(0, hit=hit))
        assert collector.cut is not None
        assert collector.cut.why == why


def test_a_cut_now_is_at_the_last_complete_epoch(collector: Collector) -> None:
    fill(collector, 0)
    fill(collector, 1, report(0, error=0.5))
    collector.cut_now("max-time")
    assert collector.cut is not None
    assert (collector.cut.why, collector.cut.epochs, len(collector.cut.front)) == ("max-time", 1, 1)
    collector.cut_now("cancelled")
    assert collector.cut.why == "max-time"


def test_by_time_nothing_is_cut_before_the_first_epoch_is_complete(collector: Collector) -> None:
    collector.cut_now("max-time")
    assert collector.cut is None
    fill(collector, 0)
    assert collector.cut is not None
    assert (collector.cut.why, collector.cut.epochs) == ("max-time", 1)


@given(st.permutations(list(itertools.product(range(4), range(2)))), st.lists(st.integers(0, 7), max_size=5))
def test_the_order_of_arrival_and_repetitions_do_not_matter(order: list[tuple[int, int]], repeated: list[int]) -> None:
    def cut_of(keys: list[tuple[int, int]]) -> object:
        collector = Collector(
            "x", SearchLimits(islands=2, epochs=4, stagnation=Stagnation(9), commit_order=COMMIT_ORDER), best_error
        )
        for epoch, island in keys:
            error = 1.0 / (1 + epoch + 3 * island)
            collector.add_reports("w", epoch, [report(island, error=error, count=epoch + island)], 1.0)
            collector.validate()
        return collector.cut

    assert cut_of(order + [order[index] for index in repeated]) == cut_of(sorted(order))


def runner_up(complexity: int, error: float, code: int, generation: int = 10) -> Addition:
    program = bytes([1, code, 0, 0, 0, 0])
    return Addition(complexity=complexity, error=error, mse=error * error, generation=generation, program=program)


def collected(epochs: list[list[IslandReport]], order: list[tuple[int, int]]) -> Collector:
    """Return a collector of two runners-up that was told of (epoch, island) in that order."""
    collector = Collector("x", SearchLimits(2, len(epochs), Stagnation(9), COMMIT_ORDER, runners_up=2), best_error)
    for epoch, island in order:
        collector.add_reports("w", epoch, [epochs[epoch][island]], 1.0)
    collector.validate()
    return collector


@given(st.permutations(list(itertools.product(range(3), range(2)))))
def test_runners_up_of_all_islands_are_merged_whatever_comes_first(order: list[tuple[int, int]]) -> None:
    epochs = [
        [
            report(0, error=1.0 - 0.1 * epoch, near=[runner_up(3, 2.0 - 0.2 * epoch, 3 + epoch), runner_up(5, 3.0, 9)]),
            report(1, error=1.5, near=[runner_up(3, 1.7, 8), runner_up(3, 1.9, 7), runner_up(4, 1.7, 6)]),
        ]
        for epoch in range(3)
    ]
    cut = collected(epochs, order).cut
    assert cut is not None
    assert cut == collected(epochs, sorted(order)).cut
    errors = [(entry.complexity, entry.error) for entry in cut.pool.runners_up]
    assert errors == [(3, 1.6), (3, 1.7), (5, 3.0)]
    assert cut.pool.front == cut.front


def test_a_member_of_the_front_that_is_displaced_becomes_a_runner_up() -> None:
    first, second = runner_up(3, 1.0, 1), runner_up(3, 0.9, 2)
    better = [report(0, found_at=()).model_copy(update={"additions": (addition,)}) for addition in (first, second)]
    epochs = [[first_report, report(1, found_at=())] for first_report in better]
    pool = collected(epochs, [(0, 0), (0, 1), (1, 0), (1, 1)]).state
    assert [entry.error for entry in pool.front] == [0.9]
    assert [entry.error for entry in pool.runners_up] == [1.0]


def test_missing_reports_are_found(collector: Collector) -> None:
    fill(collector, 0)
    fill(collector, 1, report(0))
    fill(collector, 2, report(1))
    assert collector.first_missing([0], 3) == 2
    assert collector.first_missing([1], 3) == 1
    assert collector.first_missing([0, 1], 1) is None
