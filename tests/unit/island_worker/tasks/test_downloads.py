"""Downloads: windows, wrong sizes, the digest of the whole; and what a cache keeps."""

import hashlib

from atoll_core.wire.messages.limits import CHUNK_SIZE
from atoll_island_worker.downloads import ByteCache, Download

DATA = bytes(2 * CHUNK_SIZE) + b"rest"
DIGEST = hashlib.sha256(DATA).hexdigest()


def chunk(index: int) -> bytes:
    return DATA[index * CHUNK_SIZE : (index + 1) * CHUNK_SIZE]


def test_two_chunks_are_asked_for_at_a_time_until_all_are_there() -> None:
    download = Download(DIGEST, len(DATA))
    assert download.take() == [0, 1]
    assert download.take() == []
    assert download.offer(1, chunk(1))
    assert download.finish() is None
    assert download.take() == [2]
    assert download.offer(0, chunk(0))
    assert download.offer(2, chunk(2))
    assert download.finish() == DATA


def test_a_chunk_that_did_not_come_is_asked_for_again() -> None:
    download = Download(DIGEST, len(DATA))
    download.take()
    download.give_back(0)
    assert download.take() == [0]


def test_a_chunk_of_the_wrong_size_is_refused() -> None:
    download = Download(DIGEST, len(DATA))
    download.take()
    assert not download.offer(0, b"short")


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
