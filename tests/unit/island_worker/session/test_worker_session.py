"""The worker's session, told as events and expected actions; every test ends with the invariants checked."""

from collections.abc import Iterator

import pytest

from atoll_core.errors import LocalProtocolError, RemoteProtocolError
from atoll_core.search.commit_order import CommitOrder, Position
from atoll_core.wire.messages.epochs import (
    Addition,
    Block,
    HitStatement,
    IslandReport,
    Migrants,
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
    AnnounceHit,
    Discard,
    EpochComputed,
    JobReady,
    LoadFailed,
    PullAsked,
    PullEnded,
    Rejected,
    Reset,
    Respond,
    RunTask,
    SendHeartbeat,
    SendPull,
    SendReport,
    ShardKey,
    Snapshot,
    StopAt,
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


def pull(epoch: int, *sources: int, to: tuple[int, ...] = (0,), term: int = 1) -> PullMigrants:
    return PullMigrants(job="job", variable="x", term=term, epoch=epoch, sources=sources, destinations=to)


def migrants(*blocks: tuple[int, int, bytes]) -> Migrants:
    return Migrants(blocks=tuple(Block(source=source, destination=to, data=data) for source, to, data in blocks))


def came(epoch: int, *blocks: tuple[int, int, bytes], peer: str = "peer") -> PullEnded:
    return PullEnded(SendPull(peer, pull(epoch, 1)), migrants(*blocks))


def asked(actions: list[object]) -> list[SendPull]:
    return [action for action in actions if isinstance(action, SendPull)]


def begun(session: Session, *workers: str, **fields: int) -> list[object]:
    session.handle(placed(*workers, **fields))  # type: ignore[arg-type]
    return list(session.handle(JobReady("job")))


def tasks(actions: list[object]) -> list[TaskKey]:
    return [action.task.key for action in actions if isinstance(action, RunTask)]


# -------------------------------------------------------------------------------------------- an epoch


def test_migrants_are_asked_for_when_an_epoch_begins_and_may_come_before_the_island_needs_them(
    session: Session,
) -> None:
    actions = begun(session, "me", "peer", "other", "me")
    assert asked(actions) == [SendPull("peer", pull(0, 1, to=(0, 3))), SendPull("other", pull(0, 2, to=(0, 3)))]
    assert session.handle(came(0, (1, 0, b"one"))) == []
    session.handle(came(0, (1, 0, b"again")))
    actions = session.handle(computed(key(0, 0), {}, 1))
    (action, *_) = actions
    assert isinstance(action, RunTask)
    assert action.task.blocks == {1: b"one"}
    assert [ask.body.epoch for ask in asked(actions)] == [1, 1]
    assert session.duplicates == 1


def committed(
    epoch: int, next_one: int, last: int, holds: bool = False, reported: int = 0, hit: Position | None = None
) -> Commit:
    schedule = Schedule(next=next_one, last=last, holds=holds)
    return Commit(job="job", variable="x", term=1, epoch=epoch, schedule=schedule, reported=reported, hit=hit)


def test_a_commit_beyond_what_was_reported_is_refused(session: Session) -> None:
    begun(session, "me")
    for commit in (committed(5, 7, 9), committed(0, 2, 4, reported=5)):
        with pytest.raises(RemoteProtocolError, match="commit"):
            session.handle(commit)


# ------------------------------------------------------------------------------------------------- hits


def test_the_coordinator_learns_of_a_hit_at_once_and_a_hit_elsewhere_stops_what_counts_later(session: Session) -> None:
    begun(session, "me", "peer", "me")
    assert AnnounceHit(key(2, 0).shard, 0) in session.handle(computed(key(2, 0), {}, hit=40))
    assert not session.has_reported(key(2, 0).shard, 0)
    assert session.assignment_statuses()[0].hit == Position(0, 40, 2)
    actions = session.handle(committed(0, 2, 4, hit=Position(0, 20, 1)))
    assert [action.hit for action in actions if isinstance(action, StopAt)] == [Position(0, 20, 1)]
    assert session.handle(committed(0, 2, 4, hit=Position(0, 30, 1))) == []
    assert session.assignment_statuses()[0].hit == Position(0, 20, 1)


def test_a_hit_needs_no_announcement_once_its_report_was_sent(session: Session) -> None:
    begun(session, "me", "me")
    session.handle(computed(key(0, 0), {}, hit=40))
    (report,) = session.handle(Abandoned(key(1, 0)))
    assert isinstance(report, SendReport)
    assert session.has_reported(key(0, 0).shard, 0)
    assert not session.has_reported(key(0, 0).shard, 1)
    assert session.has_reported(key(0, 0).shard._replace(term=7), 1)


# ------------------------------------------------------------------------------------------------ pulls


def test_a_pull_that_ends_without_migrants_is_repeated_at_a_tick(session: Session) -> None:
    (first,) = asked(begun(session, "me", "peer"))
    session.handle(computed(key(0, 0), {}, 1))
    assert session.handle(Tick()) == []
    assert session.handle(PullEnded(first, None)) == []
    assert session.handle(Tick()) == [SendPull("peer", pull(0, 1))]
    assert session.handle(Tick()) == []


def test_a_pull_that_timed_out_is_repeated_at_once_while_an_island_waits(session: Session) -> None:
    (first,) = asked(begun(session, "me", "peer"))
    assert session.handle(PullEnded(first, None, has_timed_out=True)) == []
    again = asked(session.handle(computed(key(0, 0), {}, 1)))
    assert again == [SendPull("peer", pull(0, 1))]
    assert session.handle(PullEnded(again[0], None, has_timed_out=True)) == again


def test_one_pull_is_for_all_islands_here(session: Session) -> None:
    (first,) = asked(begun(session, "me", "me", "peer", "peer"))
    session.handle(PullEnded(first, None, has_timed_out=True))
    again = asked(session.handle(computed(key(0, 0), {}, 2, 3)))
    assert again == [SendPull("peer", pull(0, 2, 3, to=(0, 1)))]
    assert asked(session.handle(computed(key(1, 0), {}, 2, 3))) == []
    answer = migrants((2, 0, b"a"), (2, 1, b"b"), (3, 0, b"c"), (3, 1, b"d"))
    assert tasks(list(session.handle(PullEnded(again[0], answer)))) == [key(0, 1), key(1, 1)]


def test_the_rest_of_an_answer_is_asked_for_at_once(session: Session) -> None:
    (early,) = asked(begun(session, "me", "peer", "peer"))
    session.handle(computed(key(0, 0), {}, 1, 2))
    assert session.handle(PullEnded(early, migrants((1, 0, b"a")))) == [SendPull("peer", pull(0, 2))]


def test_a_pull_is_answered_when_all_of_its_islands_have_finished_the_epoch(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun(session, "me", "me", "peer")
    session.handle(computed(key(0, 0), {2: b"far", 1: b"near"}, 1))
    assert session.handle(PullAsked("lost", pull(0, 0, 1, to=(2,)))) == []
    assert session.handle(PullAsked("handle", pull(0, 0, 1, to=(2,)))) == []
    answer = Respond("handle", migrants((0, 2, b"far"), (1, 2, b"too")))
    assert [one for one in session.handle(computed(key(1, 0), {2: b"too"}, 0)) if isinstance(one, Respond)] == [answer]
    assert session.handle(PullAsked("h", pull(0, 0, to=(5,)))) == [Respond("h", migrants())]
    monkeypatch.setattr("atoll_island_worker.session.kept_messages.CHUNK_SIZE", 4)
    assert session.handle(PullAsked("h", pull(0, 0, 1, to=(2,)))) == [Respond("h", migrants((0, 2, b"far")))]


@pytest.mark.parametrize("question", [pull(0, 1, term=3), pull(0, 1), pull(0, 9)])
def test_a_pull_under_another_term_or_of_another_workers_islands_gets_nothing(
    session: Session, question: PullMigrants
) -> None:
    begun(session, "me", "peer")
    assert session.handle(PullAsked("h", question)) == [Respond("h", NotYet())]


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


@pytest.mark.parametrize("block", [(0, 0, b"forged"), (1, 1, b"not here"), (9, 0, b"no such island")])
def test_migrants_that_were_not_asked_for_are_refused_and_change_nothing(
    session: Session, block: tuple[int, int, bytes]
) -> None:
    begun(session, "me", "peer")
    with pytest.raises(RemoteProtocolError, match="not requested"):
        session.handle(came(0, (1, 0, b"first"), block))
    session.handle(computed(key(0, 0), {}, 1))
    assert tasks(list(session.handle(came(0, (1, 0, b"true"))))) == [key(0, 1)]


# ---------------------------------------------------------------------------------------------- failure


def test_refused_immigrants_are_pulled_again(session: Session) -> None:
    begun(session, "me", "peer")
    session.handle(came(0, (1, 0, b"damaged")))
    session.handle(computed(key(0, 0), {0: b"own"}, 1))
    assert session.handle(Rejected(key(0, 1), "malformed")) == []
    assert session.handle(Tick()) == [SendPull("peer", pull(0, 1))]
    (action, *_) = session.handle(came(0, (1, 0, b"good")))
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
    with pytest.raises(LocalProtocolError, match="not requested"):
        session.handle(computed(key(0, 1), {}))


def test_a_reset_forgets_everything_also_the_terms(session: Session) -> None:
    begun(session, "me", "peer", term=5)
    assert session.handle(Reset()) == [Discard(ShardKey("job", "x", 5))]
    session.handle(Abandoned(key(0, 0, term=5)))
    assert tasks(begun(session, "me", "peer", term=2)) == [key(0, 0, term=2)]


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
    assert session.handle(PullAsked("h", pull_states(2, 0, term=9))) == [Respond("h", NotYet())]
    session.handle(committed(2, 4, 6))
    assert session.assignment_statuses()[0].snapshots == ()
    assert session.handle(PullAsked("h", pull_states(2, 0, 1))) == [Respond("h", NotYet())]


def test_a_term_that_begins_at_a_checkpoint_waits_for_the_states(session: Session) -> None:
    session.handle(placed("me", "peer", "me", term=5, epoch=6))
    assert session.handle(JobReady("job")) == []
    assert session.assignment_statuses()[0].reported == 6
    question = SendPull(None, pull_states(6, 0, 2, term=5))
    actions = session.handle(PullEnded(question, states(i0=b"zero")))
    assert tasks(actions) == [key(0, 6, term=5)]
    assert SendPull(None, pull_states(6, 2, term=5)) in actions
    (action,) = [
        action for action in session.handle(PullEnded(question, states(i2=b"two"))) if isinstance(action, RunTask)
    ]
    assert (action.task.key, action.task.state, action.task.blocks) == (key(2, 6, term=5), b"two", None)


def test_a_state_that_was_damaged_is_refused_and_asked_for_again(session: Session) -> None:
    session.handle(placed("me", term=2, epoch=6))
    question = SendPull(None, pull_states(6, 0, term=2))
    (piece,) = states(i0=b"good").pieces
    with pytest.raises(RemoteProtocolError, match="damaged"):
        session.handle(PullEnded(question, States(pieces=(piece.model_copy(update={"data": b"evil"}),))))
    assert session.handle(Tick()) == [question]


def test_a_state_that_does_not_fit_fails_the_job(session: Session) -> None:
    session.handle(placed("me", term=2, epoch=6))
    session.handle(JobReady("job"))
    session.handle(PullEnded(SendPull(None, pull_states(6, 0, term=2)), states(i0=b"odd")))
    session.handle(Rejected(key(0, 6, term=2), "the state of an island does not fit its job"))
    assert "does not fit" in session.failures()[0].sentence


def test_a_reset_keeps_what_the_new_incarnation_has_placed_already(session: Session) -> None:
    begun(session, "me", "peer", term=5)
    assert session.handle(Reset(incarnation=1)) == []
    assert session.jobs() == ("job",)
    assert tasks(list(session.handle(placed("me", "peer", term=5)))) == []
    assert session.handle(Reset(incarnation=2)) == [Discard(ShardKey("job", "x", 5))]
    assert session.jobs() == ()
