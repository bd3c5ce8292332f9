"""All jobs as people are shown them: live ones as they stand, those that have ended as they were left.

Views and results are made by `atoll_coordinator.service.monitoring.views`, when they are asked for.
"""

from collections.abc import Iterable, Iterator, Mapping
from typing import Protocol

from atoll_coordinator.service.jobs.job import Job
from atoll_coordinator.service.jobs.queue import Line
from atoll_coordinator.service.monitoring.breakages import Breakages
from atoll_coordinator.service.monitoring.counters import CounterRegistry
from atoll_coordinator.service.monitoring.views import ended_view, job_result, job_view, view_of_record
from atoll_coordinator.service.store.store import Store
from atoll_core.errors import StoreError
from atoll_core.wire.messages.views import JobView


class JobWorkers(Protocol):
    """The part of `atoll_coordinator.service.job_controller.JobController` that views tell of."""

    @property
    def counters(self) -> CounterRegistry: ...

    def waiting_reason(self, job: Job) -> str | None: ...

    def stalls(self, job_id: str) -> tuple[str, ...]: ...


class JobViews:
    """The views and results of jobs, by id."""

    def __init__(self, jobs: Mapping[str, Job], workers: JobWorkers, store: Store, breakages: Breakages) -> None:
        """`jobs` are the live ones by id, as they come and go."""
        self.ended: dict[str, JobView | None] = {}
        """Jobs that have ended; None: the view has not been made of what is stored yet."""
        self._jobs = jobs
        self._workers = workers
        self._store = store
        self._breakages = breakages

    def view(self, job_id: str, now: float) -> JobView | None:
        """Return what people are shown of a job; None for an unknown one."""
        return next(iter(self.views([job_id], now)), None)

    def views(self, job_ids: Iterable[str], now: float) -> Iterator[JobView]:
        """Yield what people are shown of jobs, leaving out unknown ones.

        One that cannot be shown whole is shown as far as the store knows it, and takes no list of jobs with it.
        """
        line = Line(self._jobs.values())
        for job_id in job_ids:
            try:
                view = self._view(job_id, line, now)
            except StoreError:
                raise
            except Exception as error:
                record, sentence = self._store.job(job_id), self._breakages.add("showing a job", error)
                view = view_of_record(record, sentence) if record else None
            if view is not None:
                yield view

    def result(self, job_id: str, now: float) -> str | None:
        """Return a job's result as JSON text, while it runs the best so far; None while there is none."""
        job = self._jobs.get(job_id)
        if job is not None:
            return job_result(job, now).to_json() if job.prepared is not None else None
        return self._store.result(job_id)

    def keep_last(self, job: Job, now: float) -> None:
        """Keep the view of a job that ends now."""
        self.ended[job.id] = self._live_view(job, Line(()), now).model_copy(
            update={"workers": 0, "stalls": (), "ahead": None}
        )

    def _view(self, job_id: str, line: Line, now: float) -> JobView | None:
        if job_id in self._jobs:
            return self._live_view(self._jobs[job_id], line, now)
        record = self._store.job(job_id) if job_id in self.ended and self.ended[job_id] is None else None
        if record is not None:
            self.ended[job_id] = ended_view(record, self._store.result(job_id))
        return self.ended.get(job_id)

    def _live_view(self, job: Job, line: Line, now: float) -> JobView:
        waiting_reason, stalls = self._workers.waiting_reason(job), self._workers.stalls(job.id)
        return job_view(job, line, now, waiting_reason, self._workers.counters.counters(job), stalls)
