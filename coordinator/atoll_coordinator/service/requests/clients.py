"""Requests of clients: uploads, submissions, questions about jobs and workers. Errors become a `Failure`."""

from collections.abc import Callable
from typing import Final

from atoll_coordinator.service.job_controller import JobController
from atoll_coordinator.service.monitoring.followers import Followers
from atoll_coordinator.service.monitoring.job_views import Draft
from atoll_coordinator.service.requests.admission import Admission
from atoll_coordinator.service.requests.authorization import Authorization
from atoll_coordinator.service.requests.deletion import JobDeletion
from atoll_coordinator.service.requests.uploads import Uploads
from atoll_coordinator.service.requests.waiting import FrontOf, NotYetError, ResultOf
from atoll_coordinator.service.store.jobs import MAX_COUNTED, Viewer
from atoll_coordinator.service.store.store import Store
from atoll_core.errors import RefusedError, RemoteProtocolError, StoreError, TableMissingError
from atoll_core.wire.messages import clients as messages
from atoll_core.wire.messages.clients import AnswerBody
from atoll_core.wire.messages.limits import CHUNK_SIZE, MAX_SHOWN_ISLANDS, chunk_count
from atoll_core.wire.messages.views import CoordinatorView, JobView, WorkerView

MAX_PAGE_BYTES: Final = CHUNK_SIZE
"""Largest number of JSON bytes of a list of jobs, unless a single job has more. Each item of a message has at least two
bytes of JSON, so that a list stays below `atoll_core.wire.codec.MAX_ITEMS`."""

MAX_RESULT_BYTES: Final = 1024 * 1024
"""Bytes of results that one list may read to make missing views, which takes 10 ms."""

_SHOWN: Final = 5


class ClientRequests:
    """Answers requests of clients, one by one."""

    def __init__(  # noqa: PLR0913  # the sources of answers
        self, controller: JobController, store: Store, authorization: Authorization, deletion: JobDeletion,
        now: Callable[[], float], coordinator: Callable[[], CoordinatorView | None] = lambda: None,
        followers: Followers | None = None,
    ) -> None:  # fmt: skip
        """`now` returns seconds of the bus, `coordinator` its view; without `followers` clients cannot follow."""
        self._controller = controller
        self._store = store
        self._authorization = authorization
        self._deletion = deletion
        self.uploads: Final = Uploads(store, now)
        self._admission = Admission(controller, store, self.uploads, deletion.retention)
        self._now = now
        self._coordinator = coordinator
        self._followers = followers

    def answer(self, client: str, request: messages.ClientRequest) -> AnswerBody:
        """Return the answer to a request of `client`.

        Raises:
            StoreError: The cancellation of a job could not be stored.
            NotYetError: The request can be answered when the result of a job, or its equations, have been written.
        """
        hidden = self._authorization.hides(client, request)
        if hidden is not None:
            return messages.Deleted(job=hidden) if isinstance(request.body, messages.Delete) else _unknown(hidden)
        refusal = self._authorization.refuse_request(client, request)
        if refusal is not None:
            return messages.Failure(failure="refused", sentence=refusal)
        try:
            submitter, viewer = self._authorization.submitter(client), self._authorization.viewer(client)
            return self._answer(client, request.body, submitter, viewer)
        except TableMissingError as error:
            return messages.Failure(failure="no-table", sentence=str(error))
        except (RefusedError, RemoteProtocolError) as error:
            return messages.Failure(failure="refused", sentence=str(error)[:4000])
        except StoreError as error:
            # The job has already stopped here; only a restarted coordinator continues it.
            if isinstance(request.body, messages.Cancel):
                raise
            return messages.Failure(failure="internal", sentence=str(error)[:4000])

    def _answer(  # noqa: C901  # one case for each kind of request
        self, client: str, body: messages.RequestBody, submitter: str | None, viewer: Viewer | None
    ) -> AnswerBody:
        now = self._now()
        match body:
            case messages.Upload():
                self._admission.admit_upload(body, submitter, client)
                return self.uploads.take(body, submitter, viewer, client)
            case messages.Submit():
                return self._submit(client, body, submitter, viewer)
            case messages.Retry():
                return self._submit(client, self._controller.submission_again(body.job, body.again), submitter, viewer)
            case messages.Cancel():
                self._controller.cancel(body.job, now)
                if body.job in self._controller.ending:  # the answer comes when the end is stored
                    raise NotYetError(ResultOf(body.job, is_final=True), lambda: self._status(body.job))
            case messages.Delete():
                self._deletion.delete(body.job, "a client asked for it")
                return messages.Deleted(job=body.job)
            case messages.Pause() | messages.SetPriority() | messages.Share():
                if self._controller.shown.view(body.job, now) is None:
                    return _unknown(body.job)
                if isinstance(body, messages.Pause):
                    self._controller.pause(body.job, body.paused, now)
                elif isinstance(body, messages.SetPriority):
                    self._controller.set_priority(body.job, body.priority, now)
                else:
                    self._controller.share(body.job, body.shared)
                    self.check_followers()
            case messages.AskAnalysis():
                return self._analyse(client, body, submitter, viewer)
            case messages.SetWorker():
                self._controller.set_worker(body.worker, body.service, now)
                return self._workers(messages.ListWorkers(prefix=body.worker, limit=1), viewer)
            case messages.SetQueue():
                self._controller.pause_queue(body.paused, now)
                return self._workers(messages.ListWorkers(limit=1), viewer)
            case messages.Follow():
                if self._followers is None:
                    sentence = "this coordinator does not notify followers; ask for the status instead"
                    return messages.Failure(failure="refused", sentence=sentence)
                return self._followers.follow(client, body, now, viewer) or _unknown(body.job or "of any name")
            case messages.ListJobs():
                return self._with_equations(lambda: self._page(body, viewer))
            case messages.FindJob():
                return self._find(body.prefix, viewer)
            case messages.ListWorkers():
                return self._workers(body, viewer)
            case messages.GetQueueDepth():
                return self._controller.queue_depth()
            case messages.GetResult():
                return self._result(body.job)
            case messages.GetIslands():
                return self._islands(body.job)
            case messages.GetTable():
                return self._table(body.job, body.index)
            case messages.GetEvents():
                return self._events(body, viewer)
            case messages.Status():
                return self._with_equations(lambda: self._status(body.job))
        return self._status(body.job)

    def _submit(self, client: str, body: messages.Submit, submitter: str | None, viewer: Viewer | None) -> AnswerBody:
        """Accept a job; refusals reveal nothing about other users' jobs and tables."""
        if (
            viewer is not None
            and self._store.job(body.job) is not None
            and self._store.submitter(body.job) != submitter
        ):
            raise RefusedError(f"the id {body.job} is taken; submit under another id")
        if not self.uploads.has(body.table, submitter, viewer, client):
            raise TableMissingError(
                f"the table of job {body.job} has not been uploaded; upload it, then submit again"
            )  # fmt: skip
        self._controller.submit(self._admission.admit(body, submitter, client), self._now(), submitter)
        self.uploads.end(body.table, submitter, client)
        return self._status(body.job)

    def _analyse(self, client: str, body: messages.AskAnalysis, user: str | None, viewer: Viewer | None) -> AnswerBody:
        """Answer a question about the result of a job; without an answer yet, return why its task waits."""
        if self._store.job(body.job) is None:
            return _unknown(body.job)
        if body.table is not None and not self.uploads.has(body.table, user, viewer, client):
            raise TableMissingError("the table of the question has not been uploaded; upload it, then ask again")
        if body.table is not None:
            self.uploads.renew(body.table)
        asked = self._controller.analyse(body, user, self._now())
        if asked.failed is not None:
            return messages.Failure(failure="internal", sentence=asked.failed[:4000])
        if asked.answer is None:
            return messages.AnalysisAnswer(job=body.job, waits_for=self._controller.tasks.waiting_reason(body.job))
        first = body.index * CHUNK_SIZE
        return messages.AnalysisAnswer(
            job=body.job, index=body.index, digest=asked.digest, size=len(asked.answer),
            data=asked.answer[first : first + CHUNK_SIZE],
        )  # fmt: skip

    def check_followers(self) -> None:
        """Stop notifying followers of jobs that they may no longer see."""
        if self._followers is not None:
            self._followers.keep(self._authorization.may_follow)

    def _table(self, job: str, index: int) -> AnswerBody:
        record = self._store.job(job)
        if record is None:
            return _unknown(job)
        size = self._store.blob_size(record.table_digest)
        if not size or index >= chunk_count(size):
            return messages.Failure(
                failure="refused", sentence=f"the table of job {job} is not kept, or has no part {index}"
            )
        data = self._store.get_chunk(record.table_digest, index)
        return messages.TableChunk(job=job, index=index, size=size, digest=record.table_digest, data=data)

    def _islands(self, job: str) -> AnswerBody:
        live = self._controller.jobs.get(job)
        if live is None:
            return (
                _unknown(job)
                if self._controller.shown.view(job, self._now()) is None
                else messages.IslandList(islands=())
            )
        views = [view for archipelago in live.open_archipelagos for view in archipelago.island_views()]
        return messages.IslandList(islands=tuple(views[:MAX_SHOWN_ISLANDS]))

    def _workers(self, question: messages.ListWorkers, viewer: Viewer | None) -> messages.WorkerList:
        """Return a page of workers, sorted by name, in which the jobs of other users are hidden."""
        views = self._controller.workers.membership.views(self._now())
        wanted = [view for view in views if view.worker > question.after and view.worker.startswith(question.prefix)]
        page = tuple(wanted[: question.limit])
        after = page[-1].worker if len(page) < len(wanted) else None
        coordinator = self._coordinator()
        if viewer is not None:
            page = tuple(_without_others(view, self._store, viewer) for view in page)
            seen = [user for user in coordinator.users if user.user == viewer.name] if coordinator else []
            coordinator = coordinator and coordinator.model_copy(update={"users": tuple(seen)})
        return messages.WorkerList(workers=page, after=after, coordinator=coordinator)

    def _events(self, question: messages.GetEvents, viewer: Viewer | None) -> messages.EventList | messages.Failure:
        if question.job is not None and self._controller.shown.view(question.job, self._now()) is None:
            return _unknown(question.job)
        log = self._controller.events
        return messages.EventList(
            events=log.read(question.job, question.after, question.limit, viewer, of_workers=question.of_workers)
        )

    def _page(self, question: messages.ListJobs, viewer: Viewer | None) -> messages.JobList:
        """Return a page of jobs, newest last, that fits into one answer."""
        page = self._store.job_page(
            question.prefix, is_open=question.is_open, before=question.before, limit=question.limit, viewer=viewer,
            state=question.state,
        )  # fmt: skip
        numbers = {job: number for number, job in page}
        views: list[JobView] = []
        size, shown = 0, self._controller.shown
        read = shown.bytes_read
        for view in shown.views(numbers, self._now()):
            size += len(view.model_dump_json())
            if views and (size > MAX_PAGE_BYTES or shown.bytes_read - read > MAX_RESULT_BYTES):
                return messages.JobList(jobs=tuple(reversed(views)), before=numbers[views[-1].job])
            # A job that waits again after a restart is listed by its stored state.
            if question.state in (None, view.state) or view.state == "queued":
                views.append(view)
        is_last = len(numbers) < question.limit
        return messages.JobList(jobs=tuple(reversed(views)), before=None if is_last else min(numbers.values()))

    def _find(self, prefix: str, viewer: Viewer | None) -> messages.JobStatus | messages.Failure:
        """Return the job whose id is `prefix`, or the only job whose id begins with it.

        Only jobs that the viewer sees are found.
        """
        if self._store.job(prefix) is not None and (viewer is None or self._store.is_seen(prefix, viewer)):
            return self._status(prefix)
        count = self._store.count_jobs(prefix, viewer)
        ids = [job for _, job in self._store.job_page(prefix if count else "", limit=_SHOWN, viewer=viewer)]
        if count == 1:
            return self._status(ids[0])
        shown = ", ".join(reversed(ids))
        if count:
            is_whole = count < MAX_COUNTED
            shown += f" and {count - _SHOWN if is_whole else 'many'} more" if count > _SHOWN else ""
            number = f"{count}" if is_whole else f"{count} and more"
            sentence = f"{number} jobs begin with {prefix!r} ({shown}); give more characters of the id"
            return messages.Failure(failure="refused", sentence=sentence)
        there = f"the latest jobs are {shown}" if ids else "there are no jobs yet"
        return messages.Failure(failure="unknown-job", sentence=f"the coordinator has no job {prefix!r}; {there}")

    def _with_equations(self, answer: Callable[[], AnswerBody]) -> AnswerBody:
        """Return the answer with views of jobs; raises NotYetError until the equations of their fronts are written."""
        body = answer()
        views = body.jobs if isinstance(body, messages.JobList) else ()
        shown = {body.job.job} if isinstance(body, messages.JobStatus) else {view.job for view in views}
        number = self._controller.equations.awaited(shown)
        if number is not None:
            raise NotYetError(FrontOf(number), answer)
        return body

    def _status(self, job: str) -> messages.JobStatus | messages.Failure:
        view = self._controller.shown.view(job, self._now())
        return messages.JobStatus(job=view) if view is not None else _unknown(job)

    def _result(self, job: str) -> messages.ResultText | messages.Failure:
        view = self._controller.shown.view(job, self._now())
        if view is None:
            return _unknown(job)
        if job in self._controller.ending:
            raise NotYetError(ResultOf(job, is_final=True))
        found = self._controller.shown.result(job)
        if isinstance(found, Draft):
            self._controller.compose(found)
            raise NotYetError(ResultOf(job, is_final=False))
        if found is not None:
            return messages.ResultText(json_text=found)
        if view.state == "failed":
            kind: messages.FailureKind = "data" if view.fault == "data" else "internal"
            return messages.Failure(failure=kind, sentence=view.reason or f"job {job} failed")
        if view.state == "cancelled":
            return messages.Failure(failure="refused", sentence=f"job {job} was cancelled before its search began")
        return messages.Failure(
            failure="too-early", sentence=f"job {job} is {view.state} and has no equations yet; ask again"
        )


def _unknown(job: str) -> messages.Failure:
    return messages.Failure(
        failure="unknown-job", sentence=f"there is no job {job}; 'coordinator jobs' lists all of them"
    )


def _without_others(view: WorkerView, store: Store, viewer: Viewer) -> WorkerView:
    """Return a worker's view that names its job only if the viewer sees the job."""
    job = view.doing.partition("/")[0]
    return view if not job or store.is_seen(job, viewer) else view.model_copy(update={"doing": "another user's job"})
