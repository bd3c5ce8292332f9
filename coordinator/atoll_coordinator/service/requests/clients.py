"""Requests of clients: uploads, submissions, questions about jobs and workers. Whatever is wrong becomes a Failure."""

from collections.abc import Callable
from typing import Final

from atoll_coordinator.service.job_controller import JobController
from atoll_coordinator.service.monitoring.followers import Followers
from atoll_coordinator.service.monitoring.queue_depth import queue_depth
from atoll_coordinator.service.requests.authorization import Authorization
from atoll_coordinator.service.requests.deletion import JobDeletion
from atoll_coordinator.service.requests.uploads import Uploads
from atoll_coordinator.service.store.store import Store
from atoll_core.errors import RefusedError, RemoteProtocolError, StoreError, TableMissingError
from atoll_core.wire.messages.clients import (
    Cancel,
    Delete,
    Deleted,
    EventList,
    Failure,
    FailureKind,
    FindJob,
    Follow,
    Following,
    GetEvents,
    GetQueueDepth,
    GetResult,
    JobFound,
    JobList,
    Jobs,
    JobStatus,
    QueueDepth,
    Request,
    Result,
    Status,
    Submit,
    Upload,
    Uploaded,
    WorkerList,
    Workers,
)
from atoll_core.wire.messages.limits import CHUNK_SIZE
from atoll_core.wire.messages.views import CoordinatorView, JobView

MAX_PAGE_BYTES: Final = CHUNK_SIZE
"""Of a list of jobs, as JSON, unless a single one has more: each item of a message has two bytes of JSON at least, so
that the list keeps to `atoll_core.wire.codec.MAX_ITEMS`."""

MAX_RESULT_BYTES: Final = 1024 * 1024
"""Of results of jobs that ended under an earlier version, of which a list has views made: for 10 ms and not longer."""

_SHOWN: Final = 5

Body = (
    Uploaded | JobList | JobFound | JobStatus | WorkerList | QueueDepth | Result | Deleted | EventList | Following
    | Failure
)  # fmt: skip
Asked = Upload | Submit | Jobs | FindJob | Status | Workers | GetQueueDepth | GetResult | Cancel | Delete | GetEvents


class ClientRequests:
    """Answers the questions of clients, one by one."""

    def __init__(  # noqa: PLR0913  # what answers are made of
        self, controller: JobController, store: Store, authorization: Authorization, deletion: JobDeletion,
        now: Callable[[], float], coordinator: Callable[[], CoordinatorView | None] = lambda: None,
        followers: Followers | None = None,
    ) -> None:  # fmt: skip
        """`now` gives the bus's seconds, `coordinator` the view of the coordinator itself; without `followers` nobody
        can follow."""
        self._controller = controller
        self._store = store
        self._authorization = authorization
        self._deletion = deletion
        self.uploads: Final = Uploads(store, now)
        self._now = now
        self._coordinator = coordinator
        self._followers = followers

    def answer(self, client: str, request: Request) -> Body:
        """Return the answer to a question of `client`.

        Raises:
            StoreError: A job was to be cancelled, and that could not be made durable.
        """
        refusal = self._authorization.refuse_request(client, request)
        if refusal is not None:
            return Failure(failure="refused", sentence=refusal)
        try:
            if isinstance(request.body, Follow):
                return self._follow(client, request.body)
            return self._answer(request.body, self._authorization.submitter(client))
        except TableMissingError as error:
            return Failure(failure="no-table", sentence=str(error))
        except (RefusedError, RemoteProtocolError) as error:
            return Failure(failure="refused", sentence=str(error)[:4000])
        except StoreError as error:
            # The job has left its search already, and only a coordinator that starts again finds its way back.
            if isinstance(request.body, Cancel):
                raise
            return Failure(failure="internal", sentence=str(error)[:4000])

    def _follow(self, client: str, question: Follow) -> Following | Failure:
        if self._followers is None:
            return Failure(failure="refused", sentence="nothing can be followed here; ask for the status instead")
        return self._followers.follow(client, question, self._now()) or _unknown(question.job or "of any name")

    def _answer(self, body: Asked, submitter: str | None) -> Body:
        match body:
            case Upload():
                return self.uploads.take(body)
            case Submit():
                self._controller.submit(body, self._now(), submitter)
                return self._status(body.job)
            case Cancel():
                self._controller.cancel(body.job, self._now())
                return self._status(body.job)
            case Delete():
                self._deletion.delete(body.job, "a client asked for it")
                return Deleted(job=body.job)
            case _:
                return self._tell(body)

    def _tell(self, body: Jobs | FindJob | Status | Workers | GetQueueDepth | GetResult | GetEvents) -> Body:
        """Answer a question that changes nothing."""
        match body:
            case Jobs():
                return self._page(body)
            case FindJob():
                return self._find(body.prefix)
            case Status():
                return self._status(body.job)
            case Workers():
                return self._workers(body)
            case GetQueueDepth():
                queue = self._controller.queue
                return queue_depth(self._controller.begun.values(), queue.queued, queue.limits.total.running)
            case GetResult():
                return self._result(body.job)
            case GetEvents():
                return self._events(body)

    def _workers(self, question: Workers) -> WorkerList:
        """Return a page of workers, by name."""
        views = self._controller.workers.membership.views(self._now())
        wanted = [view for view in views if view.worker > question.after and view.worker.startswith(question.prefix)]
        page = tuple(wanted[: question.limit])
        after = page[-1].worker if len(page) < len(wanted) else None
        return WorkerList(workers=page, after=after, coordinator=self._coordinator())

    def _events(self, question: GetEvents) -> EventList | Failure:
        """Return what happened; as much of it as one answer bears."""
        if question.job is not None and self._controller.shown.view(question.job, self._now()) is None:
            return _unknown(question.job)
        events = self._controller.events
        return EventList(
            events=events.read(question.job, question.after, question.limit, of_workers=question.of_workers)
        )

    def _page(self, question: Jobs) -> JobList:
        """Return a page of jobs, newest last, that an answer bears."""
        page = self._store.job_page(
            question.prefix, is_open=question.is_open, before=question.before, limit=question.limit
        )
        numbers = {job: number for number, job in page}
        views: list[JobView] = []
        size, shown = 0, self._controller.shown
        read = shown.bytes_read
        for view in shown.views(numbers, self._now()):
            size += len(view.model_dump_json())
            if views and (size > MAX_PAGE_BYTES or shown.bytes_read - read > MAX_RESULT_BYTES):
                return JobList(jobs=tuple(reversed(views)), before=numbers[views[-1].job])
            views.append(view)
        is_last = len(numbers) < question.limit
        return JobList(jobs=tuple(reversed(views)), before=None if is_last else min(numbers.values()))

    def _find(self, prefix: str) -> JobFound | Failure:
        """Return the one job whose id is `prefix` or begins with it."""
        if self._store.job(prefix) is not None:
            return JobFound(job=prefix)
        count = self._store.count_jobs(prefix)
        ids = [job for _, job in self._store.job_page(prefix if count else "", limit=_SHOWN)]
        if count == 1:
            return JobFound(job=ids[0])
        shown = ", ".join(reversed(ids))
        if count:
            shown += f" and {count - _SHOWN} more" if count > _SHOWN else ""
            return Failure(
                failure="refused", sentence=f"{count} jobs begin with {prefix!r} ({shown}); write more of the id"
            )
        there = f"the last that came are {shown}" if ids else "there is none at all yet"
        return Failure(failure="unknown-job", sentence=f"the coordinator has no job {prefix!r}; {there}")

    def _status(self, job: str) -> JobStatus | Failure:
        view = self._controller.shown.view(job, self._now())
        return JobStatus(job=view) if view is not None else _unknown(job)

    def _result(self, job: str) -> Result | Failure:
        view = self._controller.shown.view(job, self._now())
        if view is None:
            return _unknown(job)
        text = self._controller.shown.result(job, self._now())
        if text is not None:
            return Result(json_text=text)
        if view.state == "failed":
            kind: FailureKind = "data" if view.fault == "data" else "internal"
            return Failure(failure=kind, sentence=view.reason or f"job {job} failed")
        if view.state == "cancelled":
            return Failure(failure="refused", sentence=f"job {job} was cancelled before its search began")
        return Failure(failure="too-early", sentence=f"job {job} is {view.state} and has no equations yet; ask again")


def _unknown(job: str) -> Failure:
    return Failure(failure="unknown-job", sentence=f"there is no job {job}; 'coordinator jobs' lists all of them")
