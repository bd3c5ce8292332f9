"""Datasets on their way here: which chunks are missing, and whether the whole is what was announced.

Bookkeeping only: what is to be asked goes through an `Asker`.
"""

import hashlib
from typing import Final, Protocol

from atoll.errors import RemoteProtocolError
from atoll.wire.codec import decode
from atoll.wire.messages.limits import CHUNK_SIZE, MAX_MESSAGE, chunk_count
from atoll.wire.messages.workers import Control, JobAnnouncement

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


class Asker(Protocol):
    """How datasets are asked for; what comes is given to `Datasets`."""

    def ask_announcement(self, job: str) -> None:
        """Ask the coordinator for the job's announcement."""

    def ask_chunk(self, job: str, blob: str, index: int) -> None:
        """Ask the coordinator for one chunk."""

    def ask_later(self, job: str) -> None:
        """Have `Datasets.fetch` called again after a pause."""

    def wants(self, job: str) -> bool:
        """Tell whether islands of the job are placed here."""

    def load(self, announcement: JobAnnouncement, data: bytes) -> None:
        """Take in a whole dataset."""


class Datasets:
    """The datasets of all jobs: announced, on their way, here."""

    def __init__(self, asker: Asker) -> None:
        self._asker = asker
        self._downloads: dict[str, Download] = {}
        self._here: set[str] = set()
        self._loading: dict[str, int] = {}

    def announced(self, announcement: JobAnnouncement) -> None:
        """Begin to fetch a job's dataset, once; raises RemoteProtocolError when the announcement cannot be."""
        job = announcement.job
        if job not in self._downloads and job not in self._here:
            self._downloads[job] = Download(announcement)
            self.fetch(job)

    def announcement_came(self, job: str, payload: bytes | None) -> None:
        """Take in the answer to `Asker.ask_announcement`; raises RemoteProtocolError for another message."""
        if payload is None:
            if self._asker.wants(job):
                self._asker.ask_later(job)
            return
        body = decode(payload, Control, MAX_MESSAGE).body
        if not isinstance(body, JobAnnouncement) or body.job != job:
            raise RemoteProtocolError(f"the announcement of job {job} was asked for, and {body.kind!r} came")
        self.announced(body)

    def chunk_came(self, job: str, index: int, payload: bytes | None) -> None:
        """Take in the answer to `Asker.ask_chunk`."""
        download = self._downloads.get(job)
        if download is None:
            return
        if payload is None or not download.offer(index, payload):
            download.give_back(index)
            self._asker.ask_later(job)
            return
        data = download.finish()
        if data is None:
            self.fetch(job)
            return
        del self._downloads[job]
        self._here.add(job)
        self._loading[job] = self._loading.get(job, 0) + 1
        self._asker.load(download.announcement, data)

    def fetch(self, job: str) -> None:
        """Ask for the next missing chunks of a job's dataset, or for its announcement."""
        download = self._downloads.get(job)
        if download is not None:
            for index in download.take():
                self._asker.ask_chunk(job, download.announcement.blob, index)
        elif self._asker.wants(job) and job not in self._here:
            self._asker.ask_announcement(job)

    def loaded(self, job: str) -> bool:
        """Note that a dataset was loaded; return whether it is the one that is here, and not one forgotten since."""
        left = self._loading.pop(job, 1) - 1
        if left:
            self._loading[job] = left
        return left == 0 and job in self._here

    def forget(self, job: str) -> bool:
        """Stop fetching a job's dataset; return whether it was here."""
        self._downloads.pop(job, None)
        was_here = job in self._here
        self._here.discard(job)
        return was_here

    def jobs(self) -> tuple[str, ...]:
        """Return the jobs whose datasets are here or on their way."""
        return (*self._downloads, *self._here)
