"""The worker's session, told as events and expected actions; every test ends with the invariants checked."""

from collections.abc import Iterator

import pytest

from atoll_core.errors import LocalProtocolError, RemoteProtocolError
from atoll_core.search.commit_order import CommitOrder
from atoll_core.wire.messages.epochs import (
    Addition,
    Block,
    HitStatement,
    IslandFinished,
    IslandReport,
    Migrants,
    NewerTerm,
    NotYet,
    PullMigrants,
    PullReports,
    PullStates,
    Reports,
    States,
)
from atoll_core.wire.messages.workers import Commit, Placement, Schedule
from atoll_core.wire.state_pieces import IslandState, split_states
from atoll_island_worker.session.interface import (
    Abandoned,
    AskPeer,
    Discard,
    DiscardJob,
    EpochComputed,
    FetchPlacements,
    FetchStates,
    JobReady,
    LoadFailed,
    Mailed,
    PullAsked,
    Rejected,
    Reset,
    Respond,
    RunTask,
    SendHeartbeat,
    SendReport,
    ShardKey,
    Snapshot,
    StatesCame,
    TaskKey,
    Tick,
)
from atoll_island_worker.session.worker_session import Session


@pytest.fixture
def session() -> Iterator[Session]:
    new_session = Session("me")
    yield new_session
    new_session.validate()


def placed(
    *workers: str, term: int = 1, job: str = "job", variable: str = "x", epochs: int = 100, epoch: int = 0
) -> Placement:
    return Placement(
        incarnation=1,
        term=term,
        job=job,
        variable=variable,
        workers=workers,
        epoch=epoch,
        epochs=epochs,
        interval=2,
        commit_order=CommitOrder(generations=100, stride=10, joining=8),
    )


def key(island: int, epoch: int, term: int = 1, job: str = "job", variable: str = "x") -> TaskKey:
    return TaskKey(job, variable, term, island, epoch)


def report(island: int, hit: int | None = None, generations: int = 100) -> IslandReport:
    return IslandReport(
        island=island,
        generations=hit or generations,
        hit=None if hit is None else HitStatement(generation=hit, error=0.0),
        additions=(),
        counters=(),
        best_error=None,
        digest="ab" * 16,
    )


def computed(task: TaskKey, emigrants: dict[int, bytes], *senders: int, hit: int | None = None) -> EpochComputed:
    return EpochComputed(task, report(task.island, hit), emigrants, frozenset(senders))


def mail(epoch: int, *blocks: tuple[int, int, bytes], term: int = 1, sender: str = "peer") -> Mailed:
    wire_blocks = tuple(Block(source=source, destination=to, data=data) for source, to, data in blocks)
    return Mailed(sender, Migrants(job="job", variable="x", term=term, epoch=epoch, blocks=wire_blocks))


def finished(island: int, epoch: int, term: int = 1, generation: int = 20) -> IslandFinished:
    return IslandFinished(job="job", variable="x", term=term, epoch=epoch, generation=generation, island=island)


def begun(session: Session, *workers: str, **fields: int) -> list[object]:
    session.handle(placed(*workers, **fields))  # type: ignore[arg-type]
    return list(session.handle(JobReady("job")))


def reported(actions: list[object]) -> list[tuple[int, list[int]]]:
    reports = [action.report for action in actions if isinstance(action, SendReport)]
    return [(epoch_report.epoch, [island.island for island in epoch_report.islands]) for epoch_report in reports]


def tasks(actions: list[object]) -> list[TaskKey]:
    return [action.task.key for action in actions if isinstance(action, RunTask)]


# ---------------------------------------------------------------------------------------------- beginning


# -------------------------------------------------------------------------------------------- an epoch


def committed(epoch: int, next_one: int, last: int, holds: bool = False, reported: int = 0) -> Commit:
    schedule = Schedule(next=next_one, last=last, holds=holds)
    return Commit(job="job", variable="x", term=1, epoch=epoch, schedule=schedule, reported=reported)


def test_a_commit_beyond_what_was_reported_is_refused(session: Session) -> None:
    begun(session, "me")
    for commit in (committed(5, 7, 9), committed(0, 2, 4, reported=5)):
        with pytest.raises(RemoteProtocolError, match="commit"):
            session.handle(commit)


# ------------------------------------------------------------------------------------------------- hits


# ------------------------------------------------------------------------------------------------ pulls


def test_missing_migrants_are_asked_for_after_a_second_and_then_with_doubling_pauses(session: Session) -> None:
    begun(session, "me", "peer", "other")
    session.handle(computed(key(0, 0), {}, 1, 2))
    session.handle(mail(0, (1, 0, b"a")))
    asked = [now for now in range(0, 41) if session.handle(Tick(float(now)))]
    assert asked == [1, 3, 7, 15, 23, 31, 39]
    (action,) = session.handle(Tick(47.0))
    assert action == AskPeer(
        "other", PullMigrants(job="job", variable="x", term=1, epoch=0, destination=0, sources=(2,))
    )


def test_an_answer_with_reports_is_no_larger_than_a_message_may_be(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("atoll_island_worker.session.kept_messages.ADDITIONS_PER_ANSWER", 1)
    begun(session, "me")
    addition = Addition(complexity=1, error=0.1, mse=0.1, generation=1, program=b"")
    for epoch in range(3):
        full = report(0).model_copy(update={"additions": (addition,)})
        session.handle(EpochComputed(key(0, epoch), full, {0: b"own"}, frozenset()))
    (answer,) = session.handle(PullAsked("h", PullReports(job="job", variable="x", term=1, first=1, last=3)))
    assert isinstance(answer, Respond)
    assert isinstance(answer.body, Reports)
    assert [epoch_report.epoch for epoch_report in answer.body.reports] == [1]


# ------------------------------------------------------------------------------- foreign and early mail


@pytest.mark.parametrize(
    "event",
    [
        mail(0, (0, 0, b"forged")),
        mail(0, (1, 1, b"not here")),
        mail(0, (9, 0, b"no such island")),
        mail(2000, (1, 0, b"far ahead")),
        Mailed("peer", finished(0, 0)),
        Mailed("stranger", finished(1, 0)),
    ],
)
def test_mail_that_cannot_be_is_refused_and_changes_nothing(session: Session, event: Mailed) -> None:
    begun(session, "me", "peer")
    with pytest.raises(RemoteProtocolError):
        session.handle(event)
    session.handle(computed(key(0, 0), {}, 1))
    assert tasks(list(session.handle(mail(0, (1, 0, b"true"))))) == [key(0, 1)]


def test_mail_that_comes_before_its_placement_is_kept_and_the_placement_fetched_once(session: Session) -> None:
    assert session.handle(mail(0, (1, 0, b"early"))) == [FetchPlacements("job")]
    assert session.handle(mail(1, (1, 0, b"earlier"))) == []
    assert session.handle(mail(0, (0, 0, b"forged"), sender="stranger")) == []
    begun(session, "me", "peer")
    (action, *_) = session.handle(computed(key(0, 0), {}, 1))
    assert isinstance(action, RunTask)
    assert action.task.blocks == {1: b"early"}


# ---------------------------------------------------------------------------------------------- failure


def test_refused_immigrants_are_pulled_again(session: Session) -> None:
    begun(session, "me", "peer")
    session.handle(mail(0, (1, 0, b"damaged")))
    session.handle(computed(key(0, 0), {0: b"own"}, 1))
    assert session.handle(Rejected(key(0, 1), "malformed")) == []
    session.handle(Tick(0.0))
    assert [type(action) for action in session.handle(Tick(1.0))] == [AskPeer]
    (action,) = session.handle(mail(0, (1, 0, b"good")))
    assert isinstance(action, RunTask)
    assert action.task.blocks == {0: b"own", 1: b"good"}


def test_what_no_pull_can_mend_is_trouble(session: Session) -> None:
    begun(session, "me")
    session.handle(computed(key(0, 0), {0: b"own"}))
    session.handle(Rejected(key(0, 1), "malformed"))
    assert [failure.sentence for failure in session.failures()] == ["malformed"]


def test_a_dataset_that_cannot_be_read_is_trouble(session: Session) -> None:
    session.handle(placed("me", "peer"))
    session.handle(LoadFailed("job", "it is empty"))
    assert "it is empty" in session.failures()[0].sentence


def test_computing_what_was_not_asked_for_is_our_bug(session: Session) -> None:
    begun(session, "me", "peer")
    with pytest.raises(LocalProtocolError, match="not asked for"):
        session.handle(computed(key(0, 1), {}))


def test_a_reset_forgets_everything_also_the_terms(session: Session) -> None:
    begun(session, "me", "peer", term=5)
    assert session.handle(Reset()) == [Discard(ShardKey("job", "x", 5)), DiscardJob("job")]
    session.handle(Abandoned(key(0, 0, term=5)))
    assert tasks(begun(session, "me", "peer", term=2)) == [key(0, 0, term=2)]


# ----------------------------------------------------------------------------------------------- ending


# ------------------------------------------------------------------------------------------ checkpoints


def pull_states(epoch: int, *islands: int, term: int = 1, offset: int = 0) -> PullStates:
    return PullStates(job="job", variable="x", term=term, epoch=epoch, islands=islands, offset=offset)


def states(**of: bytes) -> States:
    """Return whole states, given by island as i0=b"...", i1=b"..."."""
    by_island = {int(name[1:]): IslandState.of(data) for name, data in of.items()}
    return States(pieces=split_states(list(by_island), 0, by_island.__getitem__))


def to_the_first_checkpoint(session: Session) -> list[object]:
    begun(session, "me", "me")
    session.handle(computed(key(0, 0), {0: b"a"}))
    session.handle(computed(key(1, 0), {1: b"b"}))
    session.handle(computed(key(0, 1), {0: b"a"}))
    return list(session.handle(computed(key(1, 1), {1: b"b"})))


def test_snapshots_are_told_when_all_are_there_and_answered_until_they_are_durable(session: Session) -> None:
    to_the_first_checkpoint(session)
    assert session.handle(Snapshot(key(0, 2), b"state 0", is_at_barrier=False)) == []
    assert session.handle(PullAsked("h", pull_states(2, 0, 1))) == [Respond("h", NotYet())]
    assert session.assignment_statuses()[0].snapshots == ()
    assert session.handle(Snapshot(key(1, 2), b"state 1", is_at_barrier=False)) == [SendHeartbeat()]
    assert session.assignment_statuses()[0].snapshots == (2,)
    answer = Respond("h", states(i0=b"state 0", i1=b"state 1"))
    assert session.handle(PullAsked("h", pull_states(2, 0, 1))) == [answer]
    assert session.handle(PullAsked("h", pull_states(2, 0, offset=7))) == [Respond("h", NotYet())]
    assert session.handle(PullAsked("h", pull_states(2, 0, term=9))) == [
        Respond("h", NewerTerm(job="job", variable="x", term=1))
    ]
    session.handle(committed(2, 4, 6))
    assert session.assignment_statuses()[0].snapshots == ()
    assert session.handle(PullAsked("h", pull_states(2, 0, 1))) == [Respond("h", NotYet())]


def test_a_state_that_was_damaged_is_refused_and_asked_for_again(session: Session) -> None:
    session.handle(placed("me", term=2, epoch=6))
    asked = pull_states(6, 0, term=2)
    (piece,) = states(i0=b"good").pieces
    with pytest.raises(RemoteProtocolError, match="damaged"):
        session.handle(StatesCame(asked, States(pieces=(piece.model_copy(update={"data": b"evil"}),))))
    assert session.handle(Tick(1.0)) == [FetchStates(asked)]


def test_a_state_that_does_not_fit_fails_the_job(session: Session) -> None:
    session.handle(placed("me", term=2, epoch=6))
    session.handle(JobReady("job"))
    session.handle(StatesCame(pull_states(6, 0, term=2), states(i0=b"odd")))
    session.handle(Rejected(key(0, 6, term=2), "the state of an island does not fit its job"))
    assert "does not fit" in session.failures()[0].sentence


def test_a_reset_keeps_what_the_new_incarnation_has_placed_already(session: Session) -> None:
    begun(session, "me", "peer", term=5)
    assert session.handle(Reset(incarnation=1)) == []
    assert session.jobs() == ("job",)
    assert tasks(list(session.handle(placed("me", "peer", term=5)))) == []
    assert session.handle(Reset(incarnation=2)) == [Discard(ShardKey("job", "x", 5)), DiscardJob("job")]
    assert session.jobs() == ()
