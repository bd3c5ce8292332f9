"""Messages: they survive the codec, refuse what does not belong, and stay readable between versions."""

import pytest

from atoll_core.errors import RemoteProtocolError
from atoll_core.search.commit_order import CommitOrder
from atoll_core.wire.codec import decode, encode
from atoll_core.wire.messages.epochs import HitStatement, NotYet, PullAnswer
from atoll_core.wire.messages.handshake import Greeting
from atoll_core.wire.messages.limits import CHUNK_SIZE, chunk_count
from atoll_core.wire.messages.workers import (
    CloseJob,
    Control,
    Placement,
)

AT = {"job": "j", "variable": "v [m/s]", "term": 1}
PLACEMENT = Placement(
    incarnation=1,
    **AT,
    workers=("w0", "w1"),
    epochs=10,
    interval=16,
    commit_order=CommitOrder(generations=100, stride=10, joining=4),
)


def test_a_greeting_of_a_later_version_is_still_understood() -> None:
    fields = {"role": "worker", "name": "w", "instance": "i", "protocol": 99, "version": "7.0", "engine": 3}
    assert Greeting.model_validate({"body": {**fields, "kind": "hello", "mood": "fine"}, "more": 1}).body.protocol == 99


def test_unknown_fields_and_kinds_are_refused_elsewhere() -> None:
    for tree in ({"kind": "close", "job": "j", "mood": 1}, {"kind": "dance"}):
        with pytest.raises(ValueError, match="body"):
            Control.model_validate({"body": tree})


def test_a_message_for_another_envelope_is_refused() -> None:
    with pytest.raises(RemoteProtocolError):
        decode(encode(PullAnswer(body=NotYet())), Control)


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
