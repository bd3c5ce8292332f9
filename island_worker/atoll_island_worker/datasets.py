"""The datasets of a worker's jobs: fetched chunk by chunk, checked, loaded by the compute thread, forgotten."""

from collections.abc import Callable

from atoll_core.errors import RemoteProtocolError
from atoll_core.wire.codec import decode
from atoll_core.wire.messages.limits import MAX_MESSAGE, chunk_count
from atoll_core.wire.messages.workers import Control, JobAnnouncement
from atoll_island_worker.compute.compute_thread import ComputeThread
from atoll_island_worker.connection.requests import Requests
from atoll_island_worker.tasks.downloads import Download


class Datasets:
    """The datasets of all jobs: announced, on their way, here."""

    def __init__(self, requests: Requests, compute: ComputeThread, is_wanted: Callable[[str], bool]) -> None:
        """`is_wanted` tells whether islands of a job are placed here."""
        self._requests = requests
        self._compute = compute
        self._is_wanted = is_wanted
        self._announcements: dict[str, JobAnnouncement] = {}
        self._downloads: dict[str, Download] = {}
        self._here: set[str] = set()
        self._loading: dict[str, int] = {}

    def announced(self, announcement: JobAnnouncement) -> None:
        """Begin to fetch a job's dataset, once; a later announcement may give it another share of the worker.

        Raises RemoteProtocolError when the announcement cannot be.
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
        """Take in the answer to `Requests.ask_announcement`; raises RemoteProtocolError for another message."""
        if payload is None:
            if self._is_wanted(job):
                self._requests.ask_later(job)
            return
        body = decode(payload, Control, MAX_MESSAGE).body
        if not isinstance(body, JobAnnouncement) or body.job != job:
            raise RemoteProtocolError(f"the announcement of job {job} was asked for, and {body.kind!r} came")
        self.announced(body)

    def chunk_came(self, job: str, index: int, payload: bytes | None) -> None:
        """Take in the answer to `Requests.ask_chunk`."""
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
        """Return whether a dataset that has been loaded is the one that is here, and not one forgotten since."""
        left = self._loading.pop(job, 1) - 1
        if left:
            self._loading[job] = left
        return left == 0 and job in self._here

    def forget(self, job: str) -> None:
        """Stop fetching a job's dataset; have it discarded when it is here."""
        self._downloads.pop(job, None)
        self._announcements.pop(job, None)
        if job in self._here:
            self._here.discard(job)
            self._compute.discard_job(job)

    def jobs(self) -> tuple[str, ...]:
        """Return the jobs whose datasets are here or on their way."""
        return (*self._downloads, *self._here)
