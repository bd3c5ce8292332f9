"""Bytes that a worker fetches in chunks, by digest: downloads, a cache of them, and the datasets of jobs."""

import hashlib
import itertools
from collections import OrderedDict
from collections.abc import Callable
from typing import Final

from atoll_core.errors import RemoteProtocolError
from atoll_core.wire.codec import decode
from atoll_core.wire.messages.limits import CHUNK_SIZE, MAX_MESSAGE, chunk_count
from atoll_core.wire.messages.workers import Control, JobAnnouncement
from atoll_island_worker.compute.compute_thread import ComputeThread
from atoll_island_worker.connection import Requests

WINDOW: Final = 2
"""Chunks asked for at the same time."""

MAX_CACHED: Final = 256 * 1024 * 1024
"""Bytes of inputs and contexts that a worker keeps for later tasks; the least recently used are dropped."""


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
        """Mark chunk `index`, which did not come, as missing again."""
        self._under_way.discard(index)

    def offer(self, index: int, data: bytes) -> bool:
        """Take in chunk `index`; return False if it has the wrong size."""
        if len(data) != min(CHUNK_SIZE, self.size - index * CHUNK_SIZE):
            return False
        self._under_way.discard(index)
        self._chunks[index] = data
        return True

    def finish(self) -> bytes | None:
        """Return all bytes once they are complete; None before. If the digest is wrong, start again and return None."""
        if len(self._chunks) < self._count:
            return None
        data = b"".join(self._chunks[index] for index in range(self._count))
        if hashlib.sha256(data).hexdigest() == self.digest:
            return data
        self._chunks.clear()
        return None


class ByteCache:
    """Bytes by digest, the most recently used, up to a total limit."""

    def __init__(self, limit: int = MAX_CACHED) -> None:
        self._limit = limit
        self._held: OrderedDict[str, bytes] = OrderedDict()
        self._total = 0

    def __contains__(self, digest: str) -> bool:
        return digest in self._held

    @property
    def digests(self) -> tuple[str, ...]:
        """The digests in the cache, the most recently used last."""
        return tuple(self._held)

    def get(self, digest: str) -> bytes | None:
        """Return the bytes with this digest, if they are in the cache."""
        data = self._held.get(digest)
        if data is not None:
            self._held.move_to_end(digest)
        return data

    def add(self, digest: str, data: bytes) -> None:
        """Add bytes, and drop the least recently used if the limit is exceeded."""
        if digest not in self._held:
            self._held[digest] = data
            self._total += len(data)
        self._held.move_to_end(digest)
        while self._total > self._limit and len(self._held) > 1:
            _, dropped = self._held.popitem(last=False)
            self._total -= len(dropped)


class Datasets:
    """The datasets of all jobs: announced, loading, loaded."""

    def __init__(self, requests: Requests, compute: ComputeThread, is_wanted: Callable[[str], bool]) -> None:
        """`is_wanted` tells whether islands of a job are placed on this worker."""
        self._requests = requests
        self._compute = compute
        self._is_wanted = is_wanted
        self._announcements: dict[str, JobAnnouncement] = {}
        self._downloads: dict[str, Download] = {}
        self._here: set[str] = set()
        self._loading: dict[str, int] = {}

    def announced(self, announcement: JobAnnouncement) -> None:
        """Start to fetch a job's dataset, once; a later announcement may change the job's share of the worker.

        Raises RemoteProtocolError for an invalid announcement.
        """
        job, size = announcement.job, announcement.size
        if announcement.chunks != chunk_count(size):
            raise RemoteProtocolError(f"a dataset of {size} bytes cannot come in {announcement.chunks} chunks")
        if job in self._here:
            self._share(announcement)
        elif job in self._downloads and self._downloads[job].digest == announcement.blob:
            self._announcements[job] = announcement
        elif job not in self._downloads:
            self._announcements[job] = announcement
            self._downloads[job] = Download(announcement.blob, size)
            self.fetch(job)

    def announcement_came(self, job: str, payload: bytes | None) -> None:
        """Handle the answer to `Requests.ask_announcement`; raises RemoteProtocolError for another message."""
        if payload is None:
            if self._is_wanted(job):
                self._requests.ask_later(job)
            return
        body = decode(payload, Control, MAX_MESSAGE).body
        if not isinstance(body, JobAnnouncement) or body.job != job:
            raise RemoteProtocolError(f"the announcement of job {job} was asked for, and {body.kind!r} came")
        self.announced(body)

    def chunk_came(self, job: str, index: int, payload: bytes | None) -> None:
        """Handle the answer to `Requests.ask_chunk`."""
        download = self._downloads.get(job)
        if download is None:
            return
        if payload is None or not download.offer(index, payload):
            download.give_back(index)
            self._requests.ask_later(job)
            return
        data = download.finish()
        if data is None:
            self.fetch(job)
            return
        del self._downloads[job]
        announcement = self._announcements.pop(job)
        self._here.add(job)
        self._loading[job] = self._loading.get(job, 0) + 1
        self._share(announcement)
        self._compute.load(job, announcement.config, data)

    def _share(self, announcement: JobAnnouncement) -> None:
        self._compute.share(announcement.job, 2.0**announcement.priority, announcement.submitter or "")

    def fetch(self, job: str) -> None:
        """Ask for the next missing chunks of a job's dataset, or for its announcement."""
        download = self._downloads.get(job)
        if download is not None:
            for index in download.take():
                self._requests.ask_chunk(job, download.digest, index)
        elif self._is_wanted(job) and job not in self._here:
            self._requests.ask_announcement(job)

    def finish_loading(self, job: str) -> bool:
        """Return whether a dataset that was loaded is still the current one, and was not forgotten meanwhile."""
        left = self._loading.pop(job, 1) - 1
        if left:
            self._loading[job] = left
        return left == 0 and job in self._here

    def forget(self, job: str) -> None:
        """Stop fetching a job's dataset; discard it if it is loaded."""
        self._downloads.pop(job, None)
        self._announcements.pop(job, None)
        if job in self._here:
            self._here.discard(job)
            self._compute.discard_job(job)

    def jobs(self) -> tuple[str, ...]:
        """Return the jobs whose datasets are loaded or loading."""
        return (*self._downloads, *self._here)
