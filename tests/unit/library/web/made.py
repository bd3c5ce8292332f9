"""A coordinator that a test speaks for, behind the web process."""

from typing import Any

from atoll.web.access import LOCAL_HOSTS, Access, digest_of
from atoll.web.reading import Readers
from atoll.web.server import build_application
from atoll_core.errors import RefusedError, UnknownJobError, UnreachableError
from atoll_core.wire.addresses import destination
from atoll_core.wire.messages.clients import JobList, QueueDepth
from atoll_core.wire.messages.views import EventView, JobView, WorkerView
from tests.views import job_view

TOKEN = "a-token-of-sixteen-and-more"
AUTHORIZED = f"Bearer {TOKEN}"


class Asked:
    """Stands for a client: it has jobs and events, and notes what it was asked."""

    def __init__(self, *jobs: JobView) -> None:
        self.views = {job.job: job for job in jobs}
        self.happened: list[EventView] = []
        self.calls: list[tuple[Any, ...]] = []
        self.is_silent, self.asked_for_pages = False, 0
        self.tables: dict[str, bytes] = {}
        self.contents: dict[str, object] = {}

    def _view(self, job: str, *call: Any) -> JobView:
        if self.is_silent:
            raise UnreachableError("the coordinator does not answer")
        if job not in self.views:
            raise UnknownJobError(f"there is no job {job}")
        if call:
            self.calls.append((*call, job))
        return self.views[job]

    def status(self, job: str) -> JobView:
        return self._view(job)

    def cancel(self, job: str) -> JobView:
        return self._view(job, "cancel")

    def pause_job(self, job: str, *, paused: bool = True) -> JobView:
        return self._view(job, "pause", paused)

    def set_priority(self, job: str, priority: int) -> JobView:
        return self._view(job, "priority", priority)

    def share(self, job: str, *, shared: bool = True) -> JobView:
        return self._view(job, "share", shared)

    def retry(self, job: str, again: str) -> JobView:
        return self._view(job, "retry", again)

    def delete(self, job: str) -> None:
        if self._view(job, "delete").state == "running":
            raise RefusedError(f"job {job} is running; cancel it")

    def jobs(self, prefix: str = "", *, is_open: bool = False, last: int | None = None) -> tuple[JobView, ...]:
        return tuple(job for job in self.views.values() if not is_open or job.state == "running")

    def page_of_jobs(
        self, prefix: str = "", *, state: str | None = None, before: int | None = None, limit: int = 100, **_: Any
    ) -> JobList:
        self.asked_for_pages += 1
        jobs = [job for job in self.views.values() if job.job.startswith(prefix) and state in (None, job.state)]
        end = len(jobs) if before is None else before
        start = max(0, end - limit)
        return JobList(jobs=tuple(jobs[start:end]), before=start if start else None)

    def events(self, job: str | None, after: int = 0, limit: int = 200, **_: Any) -> tuple[EventView, ...]:
        if job is not None:
            self._view(job)
        found = [event for event in self.happened if event.number > after and job in (None, event.job)]
        return tuple(found[:limit])

    def queue_depth(self) -> QueueDepth:
        if self.is_silent:
            raise UnreachableError("the coordinator does not answer")
        return QueueDepth(queued=0, preparing=0, running=1, refining=0, tasks_ready=0, workers_wanted=0)

    def workers(self, prefix: str = "") -> tuple[WorkerView, ...]:
        return ()

    def table(self, job: str) -> bytes:
        self._view(job, "table")
        return self.tables[job]

    def result(self, job: str) -> dict[str, object]:
        self._view(job, "result")
        return self.contents

    def islands(self, job: str) -> tuple[Any, ...]:
        self._view(job, "islands")
        return ()

    def analysis(self, job: str, *question: Any) -> tuple[str | None, bytes | None]:
        self._view(job, "analysis")
        return "waits", None

    def exchange(self, question: Any) -> bytes:
        self.calls.append(("exchange", question))
        return b""

    def hand_in(
        self, job: str, name: str, config: Any, data: bytes, priority: int = 0, *, shared: bool = False
    ) -> JobView:
        self.calls.append(("submit", job, name, config, data, priority, shared))
        self.views.setdefault(job, job_view(job=job, name=name))
        return self.views[job]


class AtHand:
    """Stands for a gateway: questions are answered at once."""

    def __init__(self, client: Asked) -> None:
        self.client = client
        self.destination = destination("tcp/127.0.0.1:1")

    async def ask(self, question: Any) -> Any:
        return question(self.client)

    def close(self) -> None:
        """Nothing is open."""


def access(gateway: Any, *, is_shown: bool = True) -> Access:
    """Return access for one token, and without one if `is_shown`."""
    return Access({digest_of(TOKEN): gateway}, gateway if is_shown else None, LOCAL_HOSTS)


READERS = Readers()
"""One process reads the files of all tests; it ends with them."""


def application(client: Asked, *, is_shown: bool = True) -> Any:
    """Return the application behind which a client stands."""
    return build_application(access(AtHand(client), is_shown=is_shown), READERS)
