"""Why an archipelago stands still, in a sentence that names who is waited for."""

from typing import Any

import pytest

from atoll_coordinator.service.search.archipelago import Archipelago
from atoll_coordinator.service.search.ending import SearchLimits, Stagnation
from atoll_coordinator.service.workers.membership import Membership
from atoll_coordinator.service.workers.stalls import PATIENCE_S, StallDetector, stall_of
from atoll_core import ENGINE_REVISION, PROTOCOL_VERSION, VERSION
from atoll_core.search.commit_order import CommitOrder
from atoll_core.wire.messages.epochs import IslandReport, SliceCounters
from atoll_core.wire.messages.handshake import Hello
from atoll_core.wire.messages.workers import AssignmentStatus, Doing, Placement, WorkerStatus

COMMIT_ORDER = CommitOrder(generations=10, stride=10, joining=8)
LONG_S = 100.0
HERE: dict[str, Any] = {"state": "computing", "doing": ("job", 1, 3), "reported": 3}


def worker(membership: Membership, name: str, now: float, beats: int = 1, **says: Any) -> None:
    """Let a worker join at second 0 and be heard of at second `now`, for the `beats`-th time."""
    says = {**HERE, "variable": "x", "term": 1, "progress": beats, **says}
    hello = Hello(
        role="worker", name=name, instance="i", protocol=PROTOCOL_VERSION, version=VERSION, engine=ENGINE_REVISION
    )
    membership.register(hello, 0.0)
    job, island, epoch = says["doing"] or ("", 0, 0)
    status = WorkerStatus(
        instance="i", incarnation=1, state=says["state"], progress=says["progress"],
        holdings=(
            AssignmentStatus(
                job="job", variable=says["variable"], term=says["term"], islands=2, reported=says["reported"], commit=0
            ),
        ),
        doing=Doing(job=job, variable="x", island=island, epoch=epoch) if job else None,
    )  # fmt: skip
    membership.record_heartbeat(name, status, now)


def report(island: int, epoch: int) -> IslandReport:
    counters = (SliceCounters(generation=10, evaluations={}),)
    return IslandReport(
        island=island, generations=10, hit=None, additions=(), counters=counters, best_error=None, digest="ab" * 16
    )


def archipelago(*reported: int, epochs: int = 3) -> Archipelago:
    """Islands 0 and 2 on worker a, 1 and 3 on b; `epochs` are complete, of the next one the `reported` islands."""
    limits = SearchLimits(islands=4, epochs=50, stagnation=Stagnation(50), commit_order=COMMIT_ORDER)
    made = Archipelago("job", "x", limits, lambda front: 0.0, lambda program: None)
    placement = Placement(
        incarnation=1, term=1, job="job", variable="x", workers=("a", "b", "a", "b"), epochs=50, interval=16,
        commit_order=COMMIT_ORDER,
    )  # fmt: skip
    made.place(placement, 0.0)
    for epoch in range(epochs):
        made.collector.add_reports("a", epoch, [report(island, epoch) for island in range(4)], 0.0)
    made.collector.add_reports("a", epochs, [report(island, epochs) for island in reported], 0.0)
    return made


def sentence(made: Archipelago, membership: Membership, now: float, still_s: float = LONG_S) -> str | None:
    membership._checked_at = now
    stall = stall_of(made, membership, still_s)
    return stall.sentence if stall is not None else None


CASES = [
    ({"doing": None, "state": "waiting"}, 20.0, "waiting for islands 1, 3 on worker b, silent for 12 s"),
    ({"state": "compiling", "doing": None}, 9.0, "waiting for islands 1, 3 on worker b, which loads or compiles its kernels"),  # noqa: E501
    ({"variable": "y"}, 9.0, "waiting for worker b to take up islands 1, 3 under term 1"),
    ({"term": 7}, 9.0, "waiting for worker b to take up islands 1, 3 under term 1"),
    ({"reported": 4}, 9.0, "waiting for the report of epoch 3 from worker b"),
    ({"state": "waiting", "doing": None}, 9.0, "waiting for islands 1, 3 on worker b, which waits for migrants itself (waiting)"),  # noqa: E501
    ({"doing": ("other", 0, 9)}, 9.0, "waiting for islands 1, 3 on worker b, which computes job other in turn"),
    ({}, 9.0, "computing slowly: islands 1, 3 on worker b, epoch 3, for 100 s"),
]  # fmt: skip


@pytest.mark.parametrize(("says", "now", "said"), CASES)
def test_each_cause_has_its_sentence(says: dict[str, Any], now: float, said: str) -> None:
    membership = Membership()
    worker(membership, "a", now)
    worker(membership, "b", 8.0, **says)
    assert sentence(archipelago(0, 2), membership, now) == said


def test_a_computation_that_does_not_get_on_is_told_with_its_island_and_epoch() -> None:
    membership = Membership()
    worker(membership, "a", 50.0)
    for second in range(8, 51):
        worker(membership, "b", float(second))
    said = sentence(archipelago(0, 2), membership, 50.0)
    assert said == "computing slowly: island 1, epoch 3 on worker b, 42 s without progress"


def test_who_holds_up_the_others_is_named_not_who_is_held_up() -> None:
    membership = Membership()
    worker(membership, "a", 8.0, state="waiting", doing=None)
    worker(membership, "b", 2.0)
    said = sentence(archipelago(), membership, 9.0)
    assert said == "waiting for islands 1, 3 on worker b, silent for 7 s"


def test_nothing_is_told_before_its_time_or_without_a_placement_or_after_the_cut() -> None:
    membership = Membership()
    worker(membership, "b", 8.0, state="waiting", doing=None)
    made = archipelago(0, 2)
    assert sentence(made, membership, 9.0, still_s=PATIENCE_S["migrants"] - 0.1) is None
    assert sentence(made, membership, 9.0, still_s=PATIENCE_S["migrants"]) is not None
    made.collector.cut_now("cancelled")
    assert sentence(made, membership, 9.0) is None
    made = archipelago(0, 2)
    made.unplace()
    assert sentence(made, membership, 9.0) is None


def test_a_stall_lasts_from_the_last_complete_epoch_to_the_next() -> None:
    membership, made = Membership(), archipelago(0, 2)
    detector, changes = StallDetector(membership), []
    for second in range(31):
        worker(membership, "a", float(second), beats=second)
        worker(membership, "b", 0.0)
        membership._checked_at = float(second)
        changes += detector.check([made], float(second))
        assert bool(detector.sentences("job")) == (second >= PATIENCE_S["silence"])
    ((key, stall),) = changes
    assert key == ("job", "x")
    assert stall is not None
    assert (stall.cause, stall.worker, stall.islands) == ("silence", "b", (1, 3))
    assert detector.sentences("job") == ("x: waiting for islands 1, 3 on worker b, silent for 30 s",)
    assert detector.sentences("other") == ()
    made.collector.add_reports("b", 3, [report(island, 3) for island in (1, 3)], 0.0)
    assert detector.check([made], 31.0) == [(("job", "x"), None)]
    assert detector.sentences("job") == ()
