"""Bytes by digest: which chunks are missing, whether the whole is what was announced, and a cache of what came."""

import hashlib
import itertools
from collections import OrderedDict
from typing import Final

from atoll_core.wire.messages.limits import CHUNK_SIZE, chunk_count

WINDOW: Final = 2
"""Chunks asked for at the same time."""

MAX_CACHED: Final = 256 * 1024 * 1024
"""Bytes of inputs and contexts that a worker keeps for later tasks; the last used are kept."""


class Download:
    """The chunks of the `size` bytes whose SHA-256 is `digest`."""

    def __init__(self, digest: str, size: int) -> None:
        self.digest: Final = digest
        self.size: Final = size
        self._count: Final = chunk_count(size)
        self._chunks: dict[int, bytes] = {}
        self._under_way: set[int] = set()

    def take(self) -> list[int]:
        """Return the chunks to ask for now; they are under way from then on."""
        missing = (i for i in range(self._count) if i not in self._chunks and i not in self._under_way)
        taken = list(itertools.islice(missing, WINDOW - len(self._under_way)))
        self._under_way.update(taken)
        return taken

    def give_back(self, index: int) -> None:
        """Have chunk `index` asked for again, which did not come."""
        self._under_way.discard(index)

    def offer(self, index: int, data: bytes) -> bool:
        """Take in chunk `index`; return False when it has not the right size."""
        if len(data) != min(CHUNK_SIZE, self.size - index * CHUNK_SIZE):
            return False
        self._under_way.discard(index)
        self._chunks[index] = data
        return True

    def finish(self) -> bytes | None:
        """Return the whole when it is complete. When it is not what was announced, begin anew and return None."""
        if len(self._chunks) < self._count:
            return None
        data = b"".join(self._chunks[index] for index in range(self._count))
        if hashlib.sha256(data).hexdigest() == self.digest:
            return data
        self._chunks.clear()
        return None


class ByteCache:
    """Bytes by digest, the last used of them, up to a limit in all."""

    def __init__(self, limit: int = MAX_CACHED) -> None:
        self._limit = limit
        self._held: OrderedDict[str, bytes] = OrderedDict()
        self._total = 0

    def __contains__(self, digest: str) -> bool:
        return digest in self._held

    @property
    def digests(self) -> tuple[str, ...]:
        """Of what is held, the last used last."""
        return tuple(self._held)

    def get(self, digest: str) -> bytes | None:
        """Return what has this digest, if it is held."""
        data = self._held.get(digest)
        if data is not None:
            self._held.move_to_end(digest)
        return data

    def add(self, digest: str, data: bytes) -> None:
        """Hold bytes, and forget those that were used longest ago where that is too much."""
        if digest not in self._held:
            self._held[digest] = data
            self._total += len(data)
        self._held.move_to_end(digest)
        while self._total > self._limit and len(self._held) > 1:
            _, dropped = self._held.popitem(last=False)
            self._total -= len(dropped)
