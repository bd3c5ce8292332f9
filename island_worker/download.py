"""The dataset of one job on its way here: which chunks are missing, and whether the whole is what was announced."""

import hashlib
from typing import Final

from common.errors import RemoteProtocolError
from common.wire.messages import CHUNK_SIZE, JobAnnouncement, chunk_count

WINDOW: Final = 2
"""Chunks asked for at the same time."""


class Download:
    """Chunks of one dataset. Pure bookkeeping; the runtime asks and offers."""

    def __init__(self, announcement: JobAnnouncement) -> None:
        """Raises RemoteProtocolError when size and number of chunks do not fit."""
        if announcement.chunks != chunk_count(announcement.size):
            raise RemoteProtocolError(
                f"a dataset of {announcement.size} bytes cannot come in {announcement.chunks} chunks"
            )
        self.announcement: Final = announcement
        self._chunks: dict[int, bytes] = {}
        self._under_way: set[int] = set()

    def take(self) -> list[int]:
        """Return the chunks to ask for now, and note them as under way."""
        missing = (
            index
            for index in range(self.announcement.chunks)
            if index not in self._chunks and index not in self._under_way
        )
        taken = [index for index, _ in zip(missing, range(WINDOW - len(self._under_way)), strict=False)]
        self._under_way.update(taken)
        return taken

    def give_back(self, index: int) -> None:
        """Note that chunk `index` did not come and is to be asked for again."""
        self._under_way.discard(index)

    def offer(self, index: int, data: bytes) -> bool:
        """Take in chunk `index`; return False when it has not the right size."""
        size = min(CHUNK_SIZE, self.announcement.size - index * CHUNK_SIZE)
        if len(data) != size:
            return False
        self._under_way.discard(index)
        self._chunks[index] = data
        return True

    def finish(self) -> bytes | None:
        """Return the whole when it is complete. When it is not what was announced, begin anew and return None."""
        if len(self._chunks) < self.announcement.chunks:
            return None
        data = b"".join(self._chunks[index] for index in range(self.announcement.chunks))
        if hashlib.sha256(data).hexdigest() == self.announcement.blob:
            return data
        self._chunks.clear()
        return None
