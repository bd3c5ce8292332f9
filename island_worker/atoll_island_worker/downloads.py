"""Bytes that a worker fetches in chunks, by digest: downloads, a cache of them, and the datasets of jobs.

Datasets and tasks say which bytes they need, and `Downloads` fetches exactly these. A chunk that does not arrive is
requested again at the worker's next tick.
"""

import hashlib
import itertools
from collections import OrderedDict
from collections.abc import Callable, Mapping
from typing import Final

from atoll_core.errors import RemoteProtocolError
from atoll_core.wire.messages.limits import CHUNK_SIZE, chunk_count
from atoll_core.wire.messages.workers import JobAnnouncement
from atoll_island_worker.compute.compute_thread import ComputeThread

WINDOW: Final = 2
"""Most chunks requested at the same time."""

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
        """Return the chunks to request now, and mark them as under way."""
        missing = (i for i in range(self._count) if i not in self._chunks and i not in self._under_way)
        taken = list(itertools.islice(missing, WINDOW - len(self._under_way)))
        self._under_way.update(taken)
        return taken

    def offer(self, index: int, data: bytes | None) -> bool:
        """Store chunk `index`; return False, and mark it as missing, if it did not arrive or has the wrong size."""
        self._under_way.discard(index)
        if data is None or len(data) != min(CHUNK_SIZE, self.size - index * CHUNK_SIZE):
            return False
        self._chunks[index] = data
        return True

    def finish(self) -> bytes | None:
        """Return all bytes once they are complete, else None. If the digest is wrong, start again and return None."""
        if len(self._chunks) < self._count:
            return None
        data = b"".join(self._chunks[index] for index in range(self._count))
        if hashlib.sha256(data).hexdigest() == self.digest:
            return data
        self._chunks.clear()
        return None


class Downloads:
    """The downloads of a worker, by digest."""

    def __init__(self, ask: Callable[[str, int], None], done: Callable[[str, bytes], None]) -> None:
        """`ask` requests a chunk of a digest; `done` receives the bytes of a digest once they have arrived."""
        self._ask = ask
        self._done = done
        self._open: dict[str, Download] = {}

    def fetch(self, wanted: Mapping[str, int]) -> None:
        """Request the next missing chunks of the `wanted` bytes (digest to size), and forget all other downloads."""
        self._open = {digest: self._open.get(digest) or Download(digest, size) for digest, size in wanted.items()}
        for download in self._open.values():
            for index in download.take():
                self._ask(download.digest, index)

    def chunk_came(self, digest: str, index: int, payload: bytes | None) -> bool:
        """Handle the answer to a request for a chunk.

        Return whether it was needed, so that more chunks are requested at once.
        """
        download = self._open.get(digest)
        if download is None or not download.offer(index, payload):
            return False
        data = download.finish()
        if data is not None:
            del self._open[digest]
            self._done(digest, data)
        return True


class ByteCache:
    """The most recently used bytes by digest, up to a total limit."""

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
        """Add bytes, and drop the least recently used bytes if the limit is exceeded."""
        if digest not in self._held:
            self._held[digest] = data
            self._total += len(data)
        self._held.move_to_end(digest)
        while self._total > self._limit and len(self._held) > 1:
            _, dropped = self._held.popitem(last=False)
            self._total -= len(dropped)


class Datasets:
    """The datasets of all jobs: announced, loading, loaded."""

    def __init__(self, compute: ComputeThread) -> None:
        self._compute = compute
        self._announcements: dict[str, JobAnnouncement] = {}
        self._here: set[str] = set()
        self._loading: dict[str, int] = {}

    def announced(self, announcement: JobAnnouncement) -> None:
        """Record that a job's dataset is needed; a later announcement may only change the job's share of the worker.

        Raises RemoteProtocolError for an invalid announcement.
        """
        job, size = announcement.job, announcement.size
        if announcement.chunks != chunk_count(size):
            raise RemoteProtocolError(f"a dataset of {size} bytes cannot have {announcement.chunks} chunks")
        if job in self._here:
            self._share(announcement)
        else:
            self._announcements[job] = announcement

    def wanted(self) -> dict[str, int]:
        """Return digests and sizes of the missing datasets."""
        return {announcement.blob: announcement.size for announcement in self._announcements.values()}

    def arrived(self, digest: str, data: bytes) -> None:
        """Load a dataset that has arrived."""
        arrived = [job for job, announcement in self._announcements.items() if announcement.blob == digest]
        for job in arrived:
            announcement = self._announcements.pop(job)
            self._here.add(job)
            self._loading[job] = self._loading.get(job, 0) + 1
            self._share(announcement)
            self._compute.load(job, announcement.config, data)

    def _share(self, announcement: JobAnnouncement) -> None:
        self._compute.share(announcement.job, 2.0**announcement.priority, announcement.submitter or "")

    def finish_loading(self, job: str) -> bool:
        """Return whether a loaded dataset is still the current one, and was not forgotten meanwhile."""
        left = self._loading.pop(job, 1) - 1
        if left:
            self._loading[job] = left
        return left == 0 and job in self._here

    def forget(self, job: str) -> None:
        """Stop fetching a job's dataset; discard it if it is loaded."""
        self._announcements.pop(job, None)
        if job in self._here:
            self._here.discard(job)
            self._compute.discard_job(job)

    def jobs(self) -> tuple[str, ...]:
        """Return the jobs whose datasets are loaded or on their way."""
        return (*self._announcements, *sorted(self._here))
