"""Downloads: windows, wrong sizes, the digest of the whole; and what a cache keeps."""

import hashlib

import pytest

from atoll_core.wire.messages.limits import CHUNK_SIZE
from atoll_island_worker.downloads import ByteCache, Download, Downloads

DATA = bytes(2 * CHUNK_SIZE) + b"rest"
DIGEST = hashlib.sha256(DATA).hexdigest()


def chunk(index: int) -> bytes:
    return DATA[index * CHUNK_SIZE : (index + 1) * CHUNK_SIZE]


def test_two_chunks_are_asked_for_at_a_time_until_all_are_there() -> None:
    asked: list[int] = []
    done: list[bytes] = []
    downloads = Downloads(lambda _, index: asked.append(index), lambda _, data: done.append(data))
    for index in (1, 0, 2):
        downloads.fetch({DIGEST: len(DATA)})
        downloads.fetch({DIGEST: len(DATA)})
        assert downloads.chunk_came(DIGEST, index, chunk(index))
    assert (asked, done) == ([0, 1, 2], [DATA])


@pytest.mark.parametrize("payload", [None, b"short"])
def test_a_chunk_that_did_not_come_whole_is_asked_for_again(payload: bytes | None) -> None:
    asked: list[int] = []
    downloads = Downloads(lambda _, index: asked.append(index), lambda *_: None)
    downloads.fetch({DIGEST: len(DATA)})
    assert not downloads.chunk_came(DIGEST, 0, payload)
    downloads.fetch({DIGEST: len(DATA)})
    assert asked == [0, 1, 0]


def test_what_is_no_longer_wanted_is_forgotten() -> None:
    downloads = Downloads(lambda *_: None, lambda *_: None)
    downloads.fetch({DIGEST: len(DATA)})
    downloads.fetch({})
    assert not downloads.chunk_came(DIGEST, 0, chunk(0))


def test_a_whole_that_is_not_what_was_announced_is_begun_anew() -> None:
    download = Download("0" * 64, 3)
    assert download.take() == [0]
    assert download.offer(0, b"abc")
    assert download.finish() is None
    assert download.take() == [0]


def test_a_cache_keeps_what_was_used_last() -> None:
    cache = ByteCache(10)
    for name in ("a", "b"):
        cache.add(name, name.encode() * 4)
    assert cache.get("a") == b"aaaa"
    cache.add("c", b"cccc")
    assert ("b" in cache, cache.digests) == (False, ("a", "c"))
