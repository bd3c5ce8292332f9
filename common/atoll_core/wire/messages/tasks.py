"""Messages about tasks: leases and results between coordinator and workers, batches between workers.

A task is a pure function of inputs that are named by their digests. The coordinator leases it to a worker, which pulls
the inputs, runs the task in a separate process and pushes the result. Other workers may help: they pull batches of its
work from the worker that runs it. The envelopes are in `atoll_core.wire.messages.workers` and
`atoll_core.wire.messages.epochs`.
"""

from typing import Annotated, Literal

from pydantic import Field

from atoll_core.config import Frozen
from atoll_core.wire.messages.limits import CHUNK_SIZE, Count, Digest, Id, Seconds, Sentence, Term

AnalysisFunction = Literal["analyse", "profile", "suggest", "report"]
"""Analyses of the result of a job."""

TaskFunction = Literal["prepare", "refine", AnalysisFunction]
TaskState = Literal["fetching", "waiting", "running", "done", "failed", "helping"]
"""State of a task on a worker: inputs are downloaded; its process loads; it runs; its result is kept; it failed; or it
runs on another worker, which this one helps."""

MAX_INPUTS = 8
MAX_RESULT = 2**31
"""Largest result of a task, in bytes."""

MAX_BATCH = 12 * 1024 * 1024
"""Most bytes of a batch, its context included: larger batches are not given to helpers."""


class TaskInput(Frozen):
    """An input of a task: its digest and size; small inputs are sent with the lease, as `data`."""

    digest: Digest
    size: Count
    data: Annotated[bytes, Field(max_length=CHUNK_SIZE)] | None = None


class Lease(Frozen):
    """Run this task and push its result; a repeated lease asks for the result again.

    `task` is the digest of job, function and inputs. A higher `term` retries a task that failed before. `seconds` is
    its time limit, None: unlimited. `threads` is the number of threads it may use.
    """

    kind: Literal["lease"] = "lease"
    task: Digest
    term: Term
    job: Id
    function: TaskFunction
    inputs: Annotated[tuple[TaskInput, ...], Field(max_length=MAX_INPUTS)]
    seconds: Seconds | None = None
    threads: Annotated[int, Field(ge=1, le=4096)] = 1


class Help(Frozen):
    """Pull batches of this task from `worker` and compute them, until the task is released or has no more batches."""

    kind: Literal["help"] = "help"
    task: Digest
    job: Id
    worker: Id


class Release(Frozen):
    """Forget this task: its result has arrived, or is no longer needed."""

    kind: Literal["release"] = "release"
    task: Digest


class TaskStatus(Frozen):
    """The state of a task on a worker, and how many candidates it has compared."""

    task: Digest
    job: Id
    state: TaskState
    compared: Count = 0


class TaskChunk(Frozen):
    """Bytes of the result of a task, from `offset` on; the whole result has `size` bytes and the SHA-256 `digest`."""

    kind: Literal["chunk"] = "chunk"
    task: Digest
    digest: Digest
    size: Annotated[int, Field(ge=0, le=MAX_RESULT)]
    offset: Count
    data: Annotated[bytes, Field(max_length=CHUNK_SIZE)]
    seconds: Seconds = 0.0


class TaskFailed(Frozen):
    """A task has no result: an internal error, no memory, its process died, or it took too long.

    `term` is the term of the lease, so that a failure that is reported twice counts once.
    """

    kind: Literal["failed"] = "failed"
    task: Digest
    term: Term
    failure: Literal["error", "memory", "crash", "time"]
    sentence: Sentence


class TaskReport(Frozen):
    """From a worker to the coordinator: the result of a task, or its failure."""

    body: Annotated[TaskChunk | TaskFailed, Field(discriminator="kind")]


class BatchResult(Frozen):
    """The result of a batch; None: it could not be computed."""

    number: Count
    result: bytes | None


class PullBatch(Frozen):
    """A helper asks for a batch of this task; `result` is the result of its last batch.

    `contexts` are the digests of the contexts that it has.
    """

    kind: Literal["pull-batch"] = "pull-batch"
    task: Digest
    result: BatchResult | None = None
    contexts: Annotated[tuple[Digest, ...], Field(max_length=64)] = ()


class GivenBatch(Frozen):
    """A batch: a named function, its context by digest (without bytes if the helper has it), and the item."""

    kind: Literal["batch"] = "batch"
    number: Count
    function: Annotated[str, Field(max_length=64)]
    digest: Digest
    context: bytes
    item: bytes
