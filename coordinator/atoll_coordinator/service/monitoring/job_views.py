"""All jobs as people are shown them: live ones as they stand, those that have ended as they were left.

Views are made by `atoll_coordinator.service.monitoring.views`, when they are asked for. Results of live jobs are
composed in the background (`atoll_coordinator.service.monitoring.drafts`).
"""

import contextlib
from collections.abc import Iterable, Iterator, Mapping
from typing import Protocol

from pydantic import ValidationError

from atoll_coordinator.service.jobs.job import Job
from atoll_coordinator.service.monitoring.breakages import Breakages
from atoll_coordinator.service.monitoring.counters import CounterRegistry
from atoll_coordinator.service.monitoring.drafts import Draft, Ending, draft_of
from atoll_coordinator.service.monitoring.views import (
    ended_view,
    job_view,
    view_of_record,
    with_equations,
)
from atoll_coordinator.service.scheduling.job_queue import JobQueue
from atoll_coordinator.service.store.store import Store
from atoll_core.errors import StoreError
from atoll_core.wire.messages.views import FINAL_STATES, JobState, JobView, TaskView


class JobWorkers(Protocol):
    """The part of `atoll_coordinator.service.job_controller.JobController` that views tell of."""

    @property
    def counters(self) -> CounterRegistry: ...

    def waiting_reason(self, job: Job) -> str | None: ...

    def stalls(self, job_id: str) -> tuple[str, ...]: ...

    def task_views(self, job_id: str) -> tuple[TaskView, ...]: ...


class JobViews:
    """The views and results of jobs, by id."""

    def __init__(
        self, jobs: Mapping[str, Job], ending: Mapping[str, Ending], queue: JobQueue, workers: JobWorkers, store: Store,
        breakages: Breakages,
    ) -> None:  # fmt: skip
        """`jobs` are the live ones by id, `ending` those whose ends have not taken effect, as they come and go."""
        self._queue = queue
        self.bytes_read = 0
        """Bytes of results of which views have been made so far: that takes long, and is done once for each."""
        self._jobs = jobs
        self._ending = ending
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
        ids = [*job_ids]
        kept = self._store.views([job_id for job_id in ids if not self.is_open(job_id)])
        made: dict[str, str] = {}
        try:
            for job_id in ids:
                view = self._guarded_view(job_id, kept.get(job_id), made, now)
                if view is not None:
                    yield view
        finally:
            if made:
                with contextlib.suppress(StoreError):  # the disk is full, perhaps: then they are made again
                    self._store.keep_views(made)

    def _guarded_view(
        self, job_id: str, kept: str | None, made: dict[str, str], now: float
    ) -> JobView | None:  # fmt: skip
        try:
            return self._view(job_id, kept, made, now)
        except StoreError:
            raise
        except Exception as error:
            record, sentence = self._store.job(job_id), self._breakages.add("showing a job", error)
            return view_of_record(record, sentence) if record else None

    def is_open(self, job_id: str) -> bool:
        """Tell whether a job is live, or its end has not taken effect."""
        return job_id in self._jobs or job_id in self._ending

    def state(self, job_id: str) -> JobState | None:
        """Return the state in which a job is shown; None: it has ended, or is unknown."""
        ending, job = self._ending.get(job_id), self._jobs.get(job_id)
        if ending is not None:
            return ending.was
        return job.state if job is not None else None

    def result(self, job_id: str) -> str | Draft | None:
        """Return a job's result as JSON text; of a live job what the best so far is composed of. None: there is none.

        One whose end has not taken effect has none.
        """
        job = self._jobs.get(job_id)
        return draft_of(job) if job is not None else self._store.result(job_id)

    def last_view(self, job: Job, now: float) -> JobView:
        """Return the view of a job that ends now."""
        view = self._live_view(job, now).model_copy(
            update={"reason": job.reason, "workers": 0, "stalls": (), "ahead": None, "paused": False, "held": False,
                    "tasks": ()}
        )  # fmt: skip
        return view if job.result_text is None else with_equations(view, job.result_text)

    def _view(
        self, job_id: str, kept: str | None, made: dict[str, str], now: float
    ) -> JobView | None:  # fmt: skip
        """Return the view of a job; what had to be made for an ended one is added to `made`."""
        if job_id in self._jobs:
            return self._live_view(self._jobs[job_id], now)
        ending = self._ending.get(job_id)
        if ending is not None and ending.sentence is None:  # else it may be half changed: the store knows it
            as_it_was = {"state": ending.was, "reason": None, "fault": None}
            return self._live_view(ending.job, now).model_copy(update=as_it_was)
        if kept is not None:
            with contextlib.suppress(ValidationError):  # else another version has kept it
                return JobView.model_validate_json(kept)
        record = self._store.job(job_id)
        if record is None:
            return None
        result = self._store.result(job_id)
        self.bytes_read += len(result or "")
        view = ended_view(record, result)
        if record.is_sound and record.state in FINAL_STATES:
            made[job_id] = view.model_dump_json()
        return view

    def _live_view(self, job: Job, now: float) -> JobView:
        waiting_reason, stalls = self._workers.waiting_reason(job), self._workers.stalls(job.id)
        view = job_view(job, self._queue, now, waiting_reason, self._workers.counters.counters(job), stalls)
        tasks = self._workers.task_views(job.id)
        at_tasks = sum((task.worker is not None) + task.helpers for task in tasks)
        return view.model_copy(update={"tasks": tasks, "workers": max(view.workers, at_tasks)})
