"""Downloads: windows, wrong sizes, and the digest of the whole."""

import hashlib

import pytest

from common.config import JobConfig
from common.errors import RemoteProtocolError
from common.wire.messages import CHUNK_SIZE, JobAnnouncement
from island_worker.download import Download

DATA = bytes(2 * CHUNK_SIZE) + b"rest"


def announcement(data: bytes = DATA, chunks: int = 3, digest: str | None = None) -> JobAnnouncement:
    blob = digest or hashlib.sha256(data).hexdigest()
    return JobAnnouncement(job="j", config=JobConfig(), variables=("x",), blob=blob, size=len(data), chunks=chunks)


def chunk(index: int) -> bytes:
    return DATA[index * CHUNK_SIZE : (index + 1) * CHUNK_SIZE]


def test_two_chunks_are_asked_for_at_a_time_until_all_are_there() -> None:
    download = Download(announcement())
    assert download.take() == [0, 1]
    assert download.take() == []
    assert download.offer(1, chunk(1))
    assert download.finish() is None
    assert download.take() == [2]
    assert download.offer(0, chunk(0))
    assert download.offer(2, chunk(2))
    assert download.finish() == DATA


def test_a_chunk_that_did_not_come_is_asked_for_again() -> None:
    download = Download(announcement())
    download.take()
    download.give_back(0)
    assert download.take() == [0]


def test_a_chunk_of_the_wrong_size_is_refused() -> None:
    download = Download(announcement())
    download.take()
    assert not download.offer(0, b"short")


def test_a_whole_that_is_not_what_was_announced_is_begun_anew() -> None:
    download = Download(announcement(b"abc", 1, digest="0" * 64))
    assert download.take() == [0]
    assert download.offer(0, b"abc")
    assert download.finish() is None
    assert download.take() == [0]


def test_an_announcement_whose_numbers_do_not_fit_is_refused() -> None:
    with pytest.raises(RemoteProtocolError, match="2 chunks"):
        Download(announcement(chunks=2))
