"""Requests of clients: uploads, submissions, questions about jobs and workers. Whatever is wrong becomes a Failure."""

import hashlib
from collections.abc import Callable
from typing import Final

from atoll.errors import AtollError, RefusedError, RemoteProtocolError, StoreError
from atoll.wire.messages.clients import (
    Ask,
    Cancel,
    Delete,
    Deleted,
    EventList,
    Failure,
    FailureKind,
    GetEvents,
    GetResult,
    JobList,
    Jobs,
    JobStatus,
    Result,
    Status,
    Submit,
    Upload,
    Uploaded,
    WorkerList,
    Workers,
)
from atoll.wire.messages.views import CoordinatorView, JobView
from atoll_coordinator.service.controller import Controller
from atoll_coordinator.service.requests.authorization import Authorization
from atoll_coordinator.service.requests.deletion import JobDeletion
from atoll_coordinator.service.store.store import Store

MAX_STORED_BYTES: Final = 16 * 1024**3
"""Uploads are refused when all tables and datasets together would take more than this."""

Body = Uploaded | JobList | JobStatus | WorkerList | Result | Deleted | EventList | Failure


class ClientRequests:
    """Answers the questions of clients, one by one."""

    def __init__(
        self, controller: Controller, store: Store, authorization: Authorization, deletion: JobDeletion,
        now: Callable[[], float], coordinator: Callable[[], CoordinatorView | None] = lambda: None,
    ) -> None:  # fmt: skip
        """`now` gives the bus's seconds, `coordinator` the view of the coordinator itself."""
        self._controller = controller
        self._store = store
        self._authorization = authorization
        self._deletion = deletion
        self._now = now
        self._coordinator = coordinator

    def answer(self, client: str, ask: Ask) -> Body:
        """Return the answer to a question of `client`.

        Raises:
            StoreError: A job was to be cancelled, and that could not be made durable.
        """
        refusal = self._authorization.refuse_ask(client, ask)
        if refusal is not None:
            return Failure(failure="refused", sentence=refusal)
        try:
            return self._answer(ask, self._authorization.submitter(client))
        except (RefusedError, RemoteProtocolError) as error:
            return Failure(failure="refused", sentence=str(error)[:4000])
        except AtollError as error:
            # The job has left its search already, and only a coordinator that starts again finds its way back.
            if isinstance(error, StoreError) and isinstance(ask.body, Cancel):
                raise
            return Failure(failure="internal", sentence=str(error)[:4000])

    def _answer(self, ask: Ask, submitter: str | None) -> Body:
        body = ask.body
        match body:
            case Upload():
                return self._upload(body)
            case Submit():
                self._controller.submit(body, self._now(), submitter)
                return self._status(body.job)
            case Jobs():
                return JobList(jobs=self._views())
            case Status():
                return self._status(body.job)
            case Workers():
                views = self._controller.workers.membership.views(self._now())
                return WorkerList(workers=views, coordinator=self._coordinator())
            case GetResult():
                return self._result(body.job)
            case Cancel():
                self._controller.cancel(body.job, self._now())
                return self._status(body.job)
            case Delete():
                self._deletion.delete(body.job, "a client asked for it")
                return Deleted(job=body.job)
            case GetEvents():
                return self._events(body)

    def _events(self, question: GetEvents) -> EventList | Failure:
        """Return what happened; as much of it as one answer bears."""
        if question.job is not None and self._controller.view(question.job, self._now()) is None:
            return _unknown(question.job)
        return EventList(events=self._controller.events.read(question.job, question.after, question.limit))

    def _upload(self, upload: Upload) -> Uploaded:
        if upload.data is None:
            self._check_room(upload)
        else:
            if hashlib.sha256(upload.data).hexdigest() != upload.sha256:
                raise RefusedError(f"part {upload.index + 1} of an upload was damaged on its way; send it again")
            self._check_room(upload)
            self._store.put_chunk(upload.blob, upload.size, upload.index, upload.data)
        return Uploaded(blob=upload.blob, missing=self._store.missing_chunks(upload.blob, upload.size))

    def _check_room(self, upload: Upload) -> None:
        """Raise RefusedError for an upload that does not fit, also without the uploads that no job uses."""
        if self._fits(upload):
            return
        self._store.delete_unused_blobs(upload.blob)
        if not self._fits(upload):
            raise RefusedError(
                f"the coordinator's store holds {self._store.blob_bytes()} bytes of tables and datasets and takes at "
                f"most {MAX_STORED_BYTES}; an upload of {upload.size} bytes does not fit: delete jobs that have ended "
                "(coordinator delete ID), or have the coordinator started with a smaller --keep"
            )

    def _fits(self, upload: Upload) -> bool:
        return self._store.has_blob(upload.blob) or self._store.blob_bytes() + upload.size <= MAX_STORED_BYTES

    def _views(self) -> tuple[JobView, ...]:
        ids = [*self._controller.ended, *self._controller.jobs]
        views = [view for each in ids if (view := self._controller.view(each, self._now())) is not None]
        return tuple(sorted(views, key=lambda view: (view.submitted, view.job)))

    def _status(self, job: str) -> JobStatus | Failure:
        view = self._controller.view(job, self._now())
        return JobStatus(job=view) if view is not None else _unknown(job)

    def _result(self, job: str) -> Result | Failure:
        view = self._controller.view(job, self._now())
        if view is None:
            return _unknown(job)
        text = self._controller.result(job, self._now())
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
