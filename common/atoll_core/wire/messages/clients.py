"""The messages of clients: requests to a coordinator, and its answers."""

from typing import Annotated, Literal

from pydantic import Field

from atoll_core.config import Frozen, JobConfig
from atoll_core.wire.messages.limits import (
    CHUNK_SIZE,
    MAX_PAGE_JOBS,
    MAX_PAGE_WORKERS,
    MAX_SHOWN_ISLANDS,
    MAX_UPLOAD,
    Count,
    Digest,
    Id,
    Priority,
    Seconds,
    Sentence,
)
from atoll_core.wire.messages.tasks import AnalysisFunction
from atoll_core.wire.messages.views import (
    CoordinatorView,
    EventView,
    IslandView,
    JobState,
    JobView,
    WorkerService,
    WorkerView,
    Workforce,
)

MAX_QUESTION = 64 * 1024
"""Most bytes of a question about a result, such as the equations of alternative models."""


class Upload(Frozen):
    """One chunk of a table, or with `data` None a request for the list of missing chunks.

    `blob` is the SHA-256 of all `size` bytes; chunk `index` holds bytes from ``index * CHUNK_SIZE``; `sha256` is the
    chunk's own. Idempotent.
    """

    kind: Literal["upload"] = "upload"
    blob: Digest
    size: Annotated[int, Field(ge=1, le=MAX_UPLOAD)]
    index: Count = 0
    sha256: Digest | None = None
    data: Annotated[bytes, Field(max_length=CHUNK_SIZE)] | None = None


class Submit(Frozen):
    """A job under an id that the client made. A repeated submission with the same id and contents means the same job.

    Unless the job is `shared`, only its submitter and admins can see it.
    """

    kind: Literal["submit"] = "submit"
    job: Id
    name: Annotated[str, Field(max_length=200)]
    config: JobConfig
    table: Digest
    priority: Priority = 0
    shared: bool = False


class ListJobs(Frozen):
    """List the latest jobs whose ids begin with `prefix`, at most `limit` of them.

    `is_open`: only jobs that have not ended; `state`: only jobs in this state; `before`: the cursor of the last list,
    for the jobs before it.
    """

    kind: Literal["jobs"] = "jobs"
    prefix: Id | Literal[""] = ""
    is_open: bool = False
    state: JobState | None = None
    before: Count | None = None
    limit: Annotated[int, Field(ge=1, le=MAX_PAGE_JOBS)] = MAX_PAGE_JOBS


class FindJob(Frozen):
    """Return the one job whose id is `prefix` or begins with it."""

    kind: Literal["find-job"] = "find-job"
    prefix: Id


class Status(Frozen):
    """Return the state and progress of a job."""

    kind: Literal["job-status"] = "job-status"
    job: Id


class ListWorkers(Frozen):
    """List workers whose names begin with `prefix`, sorted by name, after the name `after`, at most `limit` of them."""

    kind: Literal["workers"] = "workers"
    prefix: Id | Literal[""] = ""
    after: Id | Literal[""] = ""
    limit: Annotated[int, Field(ge=1, le=MAX_PAGE_WORKERS)] = MAX_PAGE_WORKERS


class GetQueueDepth(Frozen):
    """Return the numbers of jobs, tasks and workers in `QueueDepth`."""

    kind: Literal["get-queue-depth"] = "get-queue-depth"


class GetResult(Frozen):
    """Return a job's result; while it runs, the best result so far."""

    kind: Literal["get-result"] = "get-result"
    job: Id


class GetTable(Frozen):
    """Return chunk `index` of the table that a job was submitted with."""

    kind: Literal["get-table"] = "get-table"
    job: Id
    index: Count = 0


class GetIslands(Frozen):
    """Return the worker and the last epoch of each island of a job."""

    kind: Literal["get-islands"] = "get-islands"
    job: Id


class AskAnalysis(Frozen):
    """Have a worker answer a `question` about the result of a job that has ended; return chunk `index` of the answer.

    Until the answer exists, the client repeats the request; otherwise the answer is no longer computed. `table` is the
    digest of uploaded measurements to be used in place of the measurements of the result.
    """

    kind: Literal["analyse"] = "analyse"
    job: Id
    function: AnalysisFunction
    question: Annotated[bytes, Field(max_length=MAX_QUESTION)]
    table: Digest | None = None
    index: Count = 0


class Cancel(Frozen):
    """End a job and keep the best models; without effect on a job that has ended."""

    kind: Literal["cancel"] = "cancel"
    job: Id


class Delete(Frozen):
    """Delete a job that has ended, with its result, its events and the data that no other job uses. Idempotent."""

    kind: Literal["delete"] = "delete"
    job: Id


class Pause(Frozen):
    """Pause a job at a checkpoint, or resume it (`paused` false). The job keeps its position in the queue."""

    kind: Literal["pause"] = "pause"
    job: Id
    paused: bool = True


class SetPriority(Frozen):
    """Change the priority of a job that has not ended."""

    kind: Literal["set-priority"] = "set-priority"
    job: Id
    priority: Priority


class Share(Frozen):
    """Let all users see a job, or (`shared` false) only its submitter and admins."""

    kind: Literal["share"] = "share"
    job: Id
    shared: bool = True


class Retry(Frozen):
    """Submit a job that failed or was cancelled once more, under an id that the client made."""

    kind: Literal["retry"] = "retry"
    job: Id
    again: Id


class SetWorker(Frozen):
    """Give a worker no more islands (cordon), also move its present islands (drain), or give it islands again (open).

    Durable; for admins.
    """

    kind: Literal["set-worker"] = "set-worker"
    worker: Id
    service: WorkerService


class SetQueue(Frozen):
    """Start no more jobs (`paused`), or start them again; running jobs go on. Durable; for admins."""

    kind: Literal["set-queue"] = "set-queue"
    paused: bool


class GetEvents(Frozen):
    """Return events of a job, or all events (`job` None), after the event number `after`, at most `limit` of them.

    With `after` 0 these are the latest events. `of_workers`: only lines of workers' logs.
    """

    kind: Literal["get-events"] = "get-events"
    job: Id | None = None
    after: Count = 0
    limit: Annotated[int, Field(ge=1, le=1000)] = 200
    of_workers: bool = False


class Follow(Frozen):
    """Put changes of a job, or of all jobs (`job` None), on the client's key `changes`, for a lease.

    A repeated request renews the lease. `after` is the number of the last event that the client has; None: it wants no
    earlier events. `sequence` is the sequence number of the last change it has.
    """

    kind: Literal["follow"] = "follow"
    job: Id | None = None
    after: Count | None = None
    sequence: Count = 0


RequestBody = (
    Upload | Submit | ListJobs | FindJob | Status | ListWorkers | GetQueueDepth | GetResult | GetIslands | GetTable
    | AskAnalysis | Cancel | Delete | GetEvents | Follow | Pause | SetPriority | Share | Retry | SetWorker | SetQueue
)  # fmt: skip


class ClientRequest(Frozen):
    """A request of a client."""

    body: Annotated[RequestBody, Field(discriminator="kind")]


class Uploaded(Frozen):
    """Chunks of an upload that are still missing; without any, the table is stored."""

    kind: Literal["uploaded"] = "uploaded"
    blob: Digest
    missing: tuple[Count, ...]


class JobList(Frozen):
    """Jobs, newest last; `before` is the cursor for earlier jobs, None when there are none."""

    kind: Literal["job-list"] = "job-list"
    jobs: tuple[JobView, ...]
    before: Count | None = None


class JobStatus(Frozen):
    """One job; the answer to all requests that change a job."""

    kind: Literal["job-view"] = "job-view"
    job: JobView


class WorkerList(Frozen):
    """Workers seen since the coordinator started, by name, and the coordinator itself.

    The answer to SetWorker has only the worker that was set. `after` is the cursor for further workers, None when there
    are none.
    """

    kind: Literal["worker-list"] = "worker-list"
    workers: tuple[WorkerView, ...]
    after: Id | None = None
    coordinator: CoordinatorView | None = None


class QueueDepth(Frozen):
    """Numbers of jobs by state, and of islands and tasks that could be computed at once (`tasks_ready`).

    `workers_wanted`: number of worker processes that would have work now, or as soon as data are prepared.
    """

    kind: Literal["queue-depth"] = "queue-depth"
    queued: Count
    preparing: Count
    running: Count
    refining: Count
    tasks_ready: Count
    workers_wanted: Count


class EventList(Frozen):
    """Events, in order."""

    kind: Literal["event-list"] = "event-list"
    events: tuple[EventView, ...]


class JobChange(Frozen):
    """The view of a job now, and its events since the change with the sequence number `previous`.

    A client without that change has missed changes, and repeats its request. Sequence numbers rise over all restarts of
    a coordinator. `job` None: all events are followed, and there is no view. `last` is the number of the last event
    sent; with `has_more` there are further events already.
    """

    job: Id | None = None
    sequence: Count
    previous: Count
    view: JobView | None = None
    workforce: Workforce = Workforce()
    events: tuple[EventView, ...] = ()
    last: Count = 0
    has_more: bool = False


class Following(Frozen):
    """The client receives changes for `lease_s` seconds; `change` has the changes that it does not have yet, if any."""

    kind: Literal["following"] = "following"
    lease_s: Seconds
    change: JobChange | None = None


class ResultText(Frozen):
    """The contents of result.json, as JSON text."""

    kind: Literal["result"] = "result"
    json_text: str


class TableChunk(Frozen):
    """Chunk `index` of the table of a job, of `size` bytes in all, whose SHA-256 is `digest`."""

    kind: Literal["table-chunk"] = "table-chunk"
    job: Id
    index: Count
    size: Count
    digest: Digest
    data: Annotated[bytes, Field(max_length=CHUNK_SIZE)]


class IslandList(Frozen):
    """The islands of a job, by equation and number; empty unless the job is searching now."""

    kind: Literal["island-list"] = "island-list"
    islands: Annotated[tuple[IslandView, ...], Field(max_length=MAX_SHOWN_ISLANDS)]


class AnalysisAnswer(Frozen):
    """Chunk `index` of the answer to a question about a job, of `size` bytes in all, whose SHA-256 is `digest`.

    Without `data` there is no answer yet; `waits_for` says why not, None while the answer is computed.
    """

    kind: Literal["analysis-answer"] = "analysis-answer"
    job: Id
    index: Count = 0
    size: Count = 0
    digest: Digest | Literal[""] = ""
    data: Annotated[bytes, Field(max_length=CHUNK_SIZE)] | None = None
    waits_for: Sentence | None = None


class Deleted(Frozen):
    """The job of this id no longer exists."""

    kind: Literal["deleted"] = "deleted"
    job: Id


FailureKind = Literal["unknown-job", "no-table", "refused", "data", "too-early", "protocol", "internal"]


class Failure(Frozen):
    """The request failed; `sentence` is for the user."""

    kind: Literal["failure"] = "failure"
    failure: FailureKind
    sentence: Sentence


AnswerBody = (
    Uploaded | JobList | JobStatus | WorkerList | QueueDepth | ResultText | IslandList | TableChunk
    | AnalysisAnswer | Deleted | EventList | Following | Failure
)  # fmt: skip


class Answer(Frozen):
    """Answer to a client."""

    body: Annotated[AnswerBody, Field(discriminator="kind")]
