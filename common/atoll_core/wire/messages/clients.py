"""The messages of clients: what they ask a coordinator, and what it answers."""

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
"""Most bytes of a question about a result, such as the equations of rivals."""


class Upload(Frozen):
    """One chunk of a table, or, with `data` None, the question which chunks are missing.

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
    """A job under an id that the client made. The same id with the same contents again is the same job.

    Others than its submitter and admins know nothing of it, unless it is `shared`.
    """

    kind: Literal["submit"] = "submit"
    job: Id
    name: Annotated[str, Field(max_length=200)]
    config: JobConfig
    table: Digest
    priority: Priority = 0
    shared: bool = False


class Jobs(Frozen):
    """List jobs whose ids begin with `prefix`: the last that came; all, or with `is_open` those that have not ended, or
    those in one `state`.

    `before` is the cursor that the list of those behind them gave; at most `limit` are listed.
    """

    kind: Literal["jobs"] = "jobs"
    prefix: Id | Literal[""] = ""
    is_open: bool = False
    state: JobState | None = None
    before: Count | None = None
    limit: Annotated[int, Field(ge=1, le=MAX_PAGE_JOBS)] = MAX_PAGE_JOBS


class FindJob(Frozen):
    """Tell the id of the one job whose id is `prefix` or begins with it."""

    kind: Literal["find-job"] = "find-job"
    prefix: Id


class Status(Frozen):
    """Tell how a job is getting on."""

    kind: Literal["job-status"] = "job-status"
    job: Id


class Workers(Frozen):
    """List workers whose names begin with `prefix`, by name, those behind `after`: at most `limit` of them."""

    kind: Literal["workers"] = "workers"
    prefix: Id | Literal[""] = ""
    after: Id | Literal[""] = ""
    limit: Annotated[int, Field(ge=1, le=MAX_PAGE_WORKERS)] = MAX_PAGE_WORKERS


class GetQueueDepth(Frozen):
    """Tell how much work waits."""

    kind: Literal["get-queue-depth"] = "get-queue-depth"


class GetResult(Frozen):
    """Give a job's result; while it runs, the best so far."""

    kind: Literal["get-result"] = "get-result"
    job: Id


class GetTable(Frozen):
    """Give chunk `index` of the table that a job was submitted with."""

    kind: Literal["get-table"] = "get-table"
    job: Id
    index: Count = 0


class GetIslands(Frozen):
    """Say where the islands of a job are, and how far."""

    kind: Literal["get-islands"] = "get-islands"
    job: Id


class Analyse(Frozen):
    """Have a worker answer a `question` about the result of a job that has ended, and give chunk `index` of the answer.

    Until it is there, asking again is what keeps it wanted. `table` is the digest of uploaded measurements that take
    the place of those of the result.
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
    """Forget a job that has ended, with its result, its events and the data that no other job uses. Idempotent."""

    kind: Literal["delete"] = "delete"
    job: Id


class Pause(Frozen):
    """Have a job wait until it is resumed (`paused` false); its islands stop at a checkpoint. It keeps its place."""

    kind: Literal["pause"] = "pause"
    job: Id
    paused: bool = True


class SetPriority(Frozen):
    """Change the priority of a job that has not ended."""

    kind: Literal["set-priority"] = "set-priority"
    job: Id
    priority: Priority


class Share(Frozen):
    """Let everybody see a job, or (`shared` false) its submitter and admins only."""

    kind: Literal["share"] = "share"
    job: Id
    shared: bool = True


class Retry(Frozen):
    """Submit what a job that failed or was cancelled was submitted with once more, under an id that the client made."""

    kind: Literal["retry"] = "retry"
    job: Id
    again: Id


class SetWorker(Frozen):
    """Give a worker no more islands (cordon), take those away that it has as well (drain), or let it have some again.

    It lasts until it is taken back; for admins.
    """

    kind: Literal["set-worker"] = "set-worker"
    worker: Id
    service: WorkerService


class SetQueue(Frozen):
    """Take up no more jobs (`paused`), or go on; what is under way goes on. It lasts; for admins."""

    kind: Literal["set-queue"] = "set-queue"
    paused: bool


class GetEvents(Frozen):
    """Tell what happened to a job, or at all (`job` None), after the event of number `after`: `limit` of it at most.

    With `after` 0 these are the last ones. `of_workers`: only lines of workers' logs.
    """

    kind: Literal["get-events"] = "get-events"
    job: Id | None = None
    after: Count = 0
    limit: Annotated[int, Field(ge=1, le=1000)] = 200
    of_workers: bool = False


class Follow(Frozen):
    """Put changes of a job, or (`job` None) all that happens, on the client's key `changes`, for a lease.

    Asked again, it renews the lease.

    `after` is the number of the last event that the client has; None: it wants none that came before. `sequence` is
    that of the last change it has.
    """

    kind: Literal["follow"] = "follow"
    job: Id | None = None
    after: Count | None = None
    sequence: Count = 0


RequestBody = (
    Upload | Submit | Jobs | FindJob | Status | Workers | GetQueueDepth | GetResult | GetIslands | GetTable
    | Analyse | Cancel | Delete | GetEvents | Follow | Pause | SetPriority | Share | Retry | SetWorker | SetQueue
)  # fmt: skip


class Request(Frozen):
    """A request of a client."""

    body: Annotated[RequestBody, Field(discriminator="kind")]


class Uploaded(Frozen):
    """Chunks of an upload that are still missing; none: the table is stored."""

    kind: Literal["uploaded"] = "uploaded"
    blob: Digest
    missing: tuple[Count, ...]


class JobList(Frozen):
    """Jobs, newest last; `before` is the cursor for those that came before them, None when there are none."""

    kind: Literal["job-list"] = "job-list"
    jobs: tuple[JobView, ...]
    before: Count | None = None


class JobFound(Frozen):
    """The id that was asked for."""

    kind: Literal["job-found"] = "job-found"
    job: Id


class JobStatus(Frozen):
    """One job; the answer to what is done to one."""

    kind: Literal["job-view"] = "job-view"
    job: JobView


class WorkerList(Frozen):
    """Workers seen since the coordinator started, by name, and the coordinator itself; SetWorker tells the one.

    `after` is the cursor for those behind them, None when there are none.
    """

    kind: Literal["worker-list"] = "worker-list"
    workers: tuple[WorkerView, ...]
    after: Id | None = None
    coordinator: CoordinatorView | None = None


class QueueDepth(Frozen):
    """How many jobs are in which state; how many tasks, such as islands, could be computed at once.

    `workers_wanted`: how many worker processes would have work now, or as soon as data are prepared.
    """

    kind: Literal["queue-depth"] = "queue-depth"
    queued: Count
    preparing: Count
    running: Count
    refining: Count
    tasks_ready: Count
    workers_wanted: Count


class EventList(Frozen):
    """What happened, in order."""

    kind: Literal["event-list"] = "event-list"
    events: tuple[EventView, ...]


class Change(Frozen):
    """How a job stands now, and what has happened to it since the change of the sequence number `previous`.

    Who does not have that one has missed some, and asks anew. Sequence numbers rise through all lives of a store. `job`
    None: all that happens is followed, and there is no view. `last` is the number of the last event that has been told;
    with `has_more` there are others already.
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
    """The client hears of changes for `lease_s` seconds; `change` is what it does not have yet, None: nothing."""

    kind: Literal["following"] = "following"
    lease_s: Seconds
    change: Change | None = None


class Result(Frozen):
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
    """The islands of a job, by equation and number; none unless it is searched now."""

    kind: Literal["island-list"] = "island-list"
    islands: Annotated[tuple[IslandView, ...], Field(max_length=MAX_SHOWN_ISLANDS)]


class AnalysisAnswer(Frozen):
    """Chunk `index` of the answer to a question about a job, of `size` bytes in all, whose SHA-256 is `digest`.

    Without `data` the answer is not there yet; `waits_for` says in words what for, None while it is made.
    """

    kind: Literal["analysis-answer"] = "analysis-answer"
    job: Id
    index: Count = 0
    size: Count = 0
    digest: Digest | Literal[""] = ""
    data: Annotated[bytes, Field(max_length=CHUNK_SIZE)] | None = None
    waits_for: Sentence | None = None


class Deleted(Frozen):
    """There is no job of this id any more."""

    kind: Literal["deleted"] = "deleted"
    job: Id


FailureKind = Literal["unknown-job", "no-table", "refused", "data", "too-early", "protocol", "internal"]


class Failure(Frozen):
    """The question cannot be answered; `sentence` is for the person who asked."""

    kind: Literal["failure"] = "failure"
    failure: FailureKind
    sentence: Sentence


AnswerBody = (
    Uploaded | JobList | JobFound | JobStatus | WorkerList | QueueDepth | Result | IslandList | TableChunk
    | AnalysisAnswer | Deleted | EventList | Following | Failure
)  # fmt: skip


class Answer(Frozen):
    """Answer to a client."""

    body: Annotated[AnswerBody, Field(discriminator="kind")]
