"""An archipelago's checkpoints: gathered, complete when the reports are too, written once, then told."""

import pytest

from atoll_coordinator.service.search.archipelago import PLAN_COMMITS, Archipelago, Checkpoint
from atoll_coordinator.service.search.checkpoint_schedule import FIRST_INTERVAL
from atoll_coordinator.service.search.ending import SearchLimits, Stagnation
from atoll_core.errors import RemoteProtocolError
from atoll_core.search.commit_order import CommitOrder, Position
from atoll_core.wire.messages.epochs import EpochReport, HitStatement, IslandReport, SliceCounters, States
from atoll_core.wire.messages.workers import AssignmentStatus, Commit, Placement, Schedule
from atoll_core.wire.state_pieces import IslandState, split_states

COMMIT_ORDER = CommitOrder(generations=10, stride=10, joining=2)
WORKERS = ("a", "b")


def archipelago() -> Archipelago:
    limits = SearchLimits(islands=2, epochs=1000, stagnation=Stagnation(1000), commit_order=COMMIT_ORDER)
    return Archipelago("job", "x", limits, lambda front: 0.0, lambda program: None)


def place(made: Archipelago, term: int, now: float = 0.0) -> None:
    made.place(
        Placement(
            incarnation=1, term=term, job="job", variable="x", workers=WORKERS, epoch=made.durable, epochs=1000,
            interval=made.interval, commit_order=COMMIT_ORDER,
        ),
        now,
    )  # fmt: skip


def report(made: Archipelago, first: int, last: int, term: int = 1) -> None:
    """Have both islands report the epochs from `first` to below `last`."""
    for epoch in range(first, last):
        for island, worker in enumerate(WORKERS):
            tally = SliceCounters(generation=10, evaluations={"offspring": epoch + 1})
            island_report = IslandReport(
                island=island, generations=10, hit=None, additions=(), counters=(tally,), best_error=None,
                digest=f"{epoch:08x}{island:08x}",
            )  # fmt: skip
            made.add_report(
                worker, EpochReport(job="job", variable="x", term=term, epoch=epoch, islands=(island_report,)), 1.0
            )


def state(island: int, epoch: int) -> IslandState:
    return IslandState.of(f"{island} at {epoch}".encode())


def report_snapshots(made: Archipelago, *snapshots: int, term: int = 1) -> None:
    for worker in WORKERS:
        assignment_status = AssignmentStatus(
            job="job", variable="x", term=term, islands=1, reported=0, commit=made.durable, snapshots=snapshots
        )
        made.update_assignment_status(worker, assignment_status)


def answer(made: Archipelago) -> None:
    for worker, pull in made.next_pulls(9):
        made.add_states(
            worker, pull, States(pieces=split_states(pull.islands, 0, lambda k, at=pull.epoch: state(k, at)))
        )  # type: ignore[misc]


def commit(made: Archipelago, epoch: int, now: float, term: int = 1) -> tuple[Checkpoint, Commit]:
    report_snapshots(made, epoch, term=term)
    answer(made)
    checkpoint = made.take_complete_checkpoint()
    assert checkpoint is not None
    told = made.mark_durable(checkpoint, now)
    assert told is not None
    made.validate()
    return checkpoint, told


def test_a_new_term_begins_at_the_commit_and_old_reports_are_compared_not_counted() -> None:
    made = archipelago()
    place(made, 1)
    report(made, 0, 14)
    commit(made, 8, 1.0)
    place(made, 2)
    report(made, 8, 20, term=2)
    assert made.collector.state.epochs == 20
    assert made.collector.state.evaluations == {"offspring": 40}
    _, told = commit(made, made.durable + made.interval, 2.0, term=2)
    assert (told.term, told.epoch) == (2, 16)


def test_a_hit_in_a_report_is_told_to_all_workers_once() -> None:
    made = archipelago()
    place(made, 1)
    tally = SliceCounters(generation=10, evaluations={"offspring": 1})
    island_report = IslandReport(
        island=1, generations=10, hit=HitStatement(generation=10, error=1e-9), additions=(), counters=(tally,),
        best_error=1e-9, digest="0" * 16,
    )  # fmt: skip
    assert made.due_commit() is None
    made.add_report("b", EpochReport(job="job", variable="x", term=1, epoch=0, islands=(island_report,)), 1.0)
    told = made.due_commit()
    assert told is not None
    assert told.hit == Position(0, 10, 1)
    assert made.due_commit() is None


def test_reports_before_the_term_are_refused() -> None:
    made = archipelago()
    place(made, 1)
    report(made, 0, 8)
    commit(made, 8, 1.0)
    place(made, 2)
    with pytest.raises(RemoteProtocolError, match="before its term began"):
        report(made, 7, 8, term=2)


def test_a_write_that_ends_under_another_term_is_not_told() -> None:
    made = archipelago()
    place(made, 1)
    report(made, 0, 8)
    report_snapshots(made, 8)
    answer(made)
    checkpoint = made.take_complete_checkpoint()
    assert checkpoint is not None
    made.unplace()
    assert made.mark_durable(checkpoint, 1.0) is None
    assert made.durable == 8


def test_a_barrier_that_was_asked_for_is_announced_with_the_next_commit_and_ends_with_its_own() -> None:
    made = archipelago()
    place(made, 1)
    made.request_barrier()
    assert (made.is_planned, made.is_at_barrier) == (True, False)
    report(made, 0, 17)
    _, told = commit(made, 8, 1.0)
    assert told.schedule == Schedule(next=16, last=17, holds=True)
    commit(made, 16, 2.0)
    assert not made.is_at_barrier
    commit(made, 17, 3.0)
    assert made.is_at_barrier
    place(made, 2)
    assert (made.is_at_barrier, made.is_planned) == (False, False)
    assert made.placement is not None
    assert made.placement.epoch == 17


def test_newcomers_have_to_wait_for_some_commits_after_a_planned_change() -> None:
    made = archipelago()
    place(made, 1)
    assert made.may_plan
    made.request_barrier()
    place(made, 2)
    epoch, commits = 0, 0
    while not made.may_plan:
        commit_at = made._schedule.next
        report(made, epoch, commit_at, term=2)
        commit(made, commit_at, 100.0 * commits, term=2)
        epoch, commits = commit_at, commits + 1
    assert commits == PLAN_COMMITS


def test_what_was_committed_earlier_is_where_the_first_term_begins() -> None:
    made, other = archipelago(), archipelago()
    place(other, 1)
    report(other, 0, 8)
    checkpoint, _ = commit(other, 8, 1.0)
    made.resume(checkpoint.stored_search_state(1.0).search_state())
    place(made, 2)
    report(made, 8, 12, term=2)
    report(other, 8, 12)
    assert made.collector.state == other.collector.state
    assert made.interval == FIRST_INTERVAL
