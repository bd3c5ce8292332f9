"""Messages: they survive the codec, refuse what does not belong, and stay readable between versions."""

import pytest

from atoll_core.config import JobConfig
from atoll_core.errors import RemoteProtocolError
from atoll_core.search.commit_order import CommitOrder
from atoll_core.wire.codec import decode, encode
from atoll_core.wire.messages.clients import Answer, Cancel, ClientRequest, Failure, Submit, Upload, Uploaded
from atoll_core.wire.messages.epochs import (
    Addition,
    Block,
    EpochReport,
    HitStatement,
    IslandFinished,
    IslandReport,
    Mail,
    Migrants,
    NewerTerm,
    NotYet,
    Piece,
    Pull,
    PullAnswer,
    PullMigrants,
    PullReports,
    PullStates,
    Reports,
    Sent,
    SliceCounters,
    States,
)
from atoll_core.wire.messages.handshake import Greeting, GreetingAnswer, Hello, Refusal, Welcome
from atoll_core.wire.messages.limits import CHUNK_SIZE, chunk_count
from atoll_core.wire.messages.workers import (
    AssignmentStatus,
    Close,
    CloseJob,
    Commit,
    Control,
    IslandFailure,
    JobAnnouncement,
    Placement,
    Placements,
    Schedule,
    WorkerStatus,
)

DIGEST = "ab" * 32
AT = {"job": "j", "variable": "v [m/s]", "term": 1}
REPORT = EpochReport(
    **AT,
    epoch=2,
    islands=(
        IslandReport(
            island=1,
            generations=7,
            hit=HitStatement(generation=7, error=1e-10),
            additions=(Addition(complexity=3, error=0.1, mse=0.02, generation=5, program=b"\x01"),),
            counters=(SliceCounters(generation=7, evaluations={"offspring": 12}),),
            best_error=0.1,
            digest=DIGEST,
        ),
    ),
)
MIGRANTS = Migrants(**AT, epoch=0, blocks=(Block(source=0, destination=1, data=b"\x00\xff"),))
FINISHED = IslandFinished(**AT, epoch=0, generation=10, island=2)
PLACEMENT = Placement(
    incarnation=1,
    **AT,
    workers=("w0", "w1"),
    epochs=10,
    interval=16,
    commit_order=CommitOrder(generations=100, stride=10, joining=4),
)
STATUS = WorkerStatus(
    instance="i",
    incarnation=1,
    state="computing",
    progress=5,
    holdings=(AssignmentStatus(**AT, islands=2, reported=4, commit=0),),
    failures=(IslandFailure(**AT, island=0, sentence="broke"),),
)

ALL = [
    Greeting(body=Hello(role="worker", name="w0", instance="i", protocol=1, version="0", engine=1)),
    GreetingAnswer(body=Welcome(realm="r", incarnation=1, protocol=1, version="0", engine=1)),
    GreetingAnswer(body=Refusal(protocol=1, version="0", engine=1, sentence="no")),
    Control(body=JobAnnouncement(job="j", config=JobConfig(), variables=("θ", "x"), blob=DIGEST, size=9, chunks=1)),
    Control(body=Placements(placements=(PLACEMENT,))),
    Control(body=Commit(**AT, epoch=16, schedule=Schedule(next=32, last=33, holds=True), reported=20)),
    Control(body=Close(**AT)),
    Control(body=CloseJob(job="j")),
    STATUS,
    REPORT,
    Mail(body=MIGRANTS),
    Mail(body=FINISHED),
    Pull(body=PullMigrants(**AT, epoch=0, destination=1, sources=(0,))),
    Pull(body=PullReports(**AT, first=0, last=3)),
    Pull(body=PullStates(**AT, epoch=16, islands=(0, 3), offset=9)),
    PullAnswer(body=Sent(migrants=MIGRANTS, finished=(FINISHED,))),
    PullAnswer(body=Reports(reports=(REPORT,))),
    PullAnswer(body=States(pieces=(Piece(island=3, size=9, digest=DIGEST, offset=4, data=b"state"),))),
    PullAnswer(body=NotYet()),
    PullAnswer(body=NewerTerm(job="j", variable="x", term=0)),
    ClientRequest(body=Upload(blob=DIGEST, size=3, index=0, sha256=DIGEST, data=b"abc")),
    ClientRequest(body=Submit(job="j", name="n", config=JobConfig(seed=2**62), table=DIGEST)),
    ClientRequest(body=Cancel(job="j")),
    Answer(body=Uploaded(blob=DIGEST, missing=(1, 2))),
    Answer(body=Failure(failure="refused", sentence="no")),
]


@pytest.mark.parametrize(
    "message", ALL, ids=lambda message: f"{type(message).__name__}-{getattr(message, 'body', '')!s:.20}"
)
def test_every_message_survives_the_codec(message: Greeting) -> None:
    assert decode(encode(message), type(message)) == message


def test_a_greeting_of_a_later_version_is_still_understood() -> None:
    fields = {"role": "worker", "name": "w", "instance": "i", "protocol": 99, "version": "7.0", "engine": 3}
    assert Greeting.model_validate({"body": {**fields, "kind": "hello", "mood": "fine"}, "more": 1}).body.protocol == 99


def test_unknown_fields_and_kinds_are_refused_elsewhere() -> None:
    for tree in ({"kind": "close", "job": "j", "mood": 1}, {"kind": "dance"}):
        with pytest.raises(ValueError, match="body"):
            Control.model_validate({"body": tree})


def test_a_message_for_another_envelope_is_refused() -> None:
    with pytest.raises(RemoteProtocolError):
        decode(encode(Mail(body=FINISHED)), Control)


@pytest.mark.parametrize("job", ["", "a/b", "x" * 65, "*"])
def test_ids_are_checked(job: str) -> None:
    with pytest.raises(ValueError, match="job"):
        CloseJob(job=job)


def test_numbers_that_are_not_finite_are_refused() -> None:
    with pytest.raises(ValueError, match="finite"):
        HitStatement(generation=1, error=float("nan"))


def test_a_placement_knows_the_islands_of_a_worker() -> None:
    assert PLACEMENT.islands_of("w1") == (1,)
    assert PLACEMENT.islands_of("w2") == ()


def test_a_term_s_first_checkpoints_lie_an_interval_apart_and_a_hold_forbids_the_last() -> None:
    schedule = PLACEMENT.model_copy(update={"epoch": 40}).schedule
    assert (schedule.next, schedule.last, schedule.limit) == (56, 72, 72)
    assert schedule.model_copy(update={"holds": True}).limit == 71


def test_chunks_are_counted_upwards() -> None:
    assert [chunk_count(size) for size in (0, 1, CHUNK_SIZE, CHUNK_SIZE + 1)] == [1, 1, 1, 2]
