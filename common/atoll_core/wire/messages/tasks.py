"""What coordinator and workers tell each other of tasks: leases, results, and batches between workers.

A task is a pure function of inputs that are named by their digests. The coordinator leases it to a worker, which pulls
the inputs, runs it in a process of its own and pushes the result. Other workers may help: they pull batches of its
work from the worker that has it. Messages are those of `atoll_core.wire.messages.workers` and
`atoll_core.wire.messages.epochs`, whose envelopes carry them.
"""

from typing import Annotated, Literal

from pydantic import Field

from atoll_core.config import Frozen
from atoll_core.wire.messages.limits import CHUNK_SIZE, Count, Digest, Id, Seconds, Sentence, Term

AnalysisFunction = Literal["analyse", "profile", "suggest", "report"]
"""What can be asked of the result of a job."""

TaskFunction = Literal["prepare", "refine", AnalysisFunction]
TaskState = Literal["fetching", "waiting", "running", "done", "failed", "helping"]
"""Of a task on its worker: inputs are on their way; its process is loading; it runs; its result is kept; or it is that
of another worker, which is helped."""

MAX_INPUTS = 8
MAX_RESULT = 2**31
"""Largest result of a task, in bytes."""

MAX_BATCH = 12 * 1024 * 1024
"""Most bytes of a batch, its context included: what is larger is not given to helpers."""


class TaskInput(Frozen):
    """An input of a task: its digest and size; small ones travel with the lease as `data`."""

    digest: Digest
    size: Count
    data: Annotated[bytes, Field(max_length=CHUNK_SIZE)] | None = None


class Lease(Frozen):
    """Run this task and push its result; said again, push the result again.

    `task` is the digest of job, function and inputs. A higher `term` has it tried again where it failed before.
    `seconds`: how long it may take, None: any time. `threads`: how many it may use.
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
    """Pull batches of this task from `worker`, and compute them, until it is released or there are no more."""

    kind: Literal["help"] = "help"
    task: Digest
    job: Id
    worker: Id


class Release(Frozen):
    """Have nothing more to do with this task: its result has come, or nobody needs it."""

    kind: Literal["release"] = "release"
    task: Digest


class TaskStatus(Frozen):
    """What a worker has of a task of this job, and how many candidates the task has compared."""

    task: Digest
    job: Id
    state: TaskState
    compared: Count = 0


class TaskChunk(Frozen):
    """Bytes of the result of a task, from `offset` on; the whole has `size` bytes and the SHA-256 `digest`."""

    kind: Literal["chunk"] = "chunk"
    task: Digest
    digest: Digest
    size: Annotated[int, Field(ge=0, le=MAX_RESULT)]
    offset: Count
    data: Annotated[bytes, Field(max_length=CHUNK_SIZE)]
    seconds: Seconds = 0.0


class TaskFailed(Frozen):
    """A task has no result: something of ours broke, memory ran out, its process died, or it took too long.

    `term` is that of the lease: a failure that is said twice counts once.
    """

    kind: Literal["failed"] = "failed"
    task: Digest
    term: Term
    failure: Literal["error", "memory", "crash", "time"]
    sentence: Sentence


class TaskReport(Frozen):
    """From a worker to the coordinator: what came of a task."""

    body: Annotated[TaskChunk | TaskFailed, Field(discriminator="kind")]


class BatchResult(Frozen):
    """What a helper made of a batch; None: it could not be made."""

    number: Count
    result: bytes | None


class PullBatch(Frozen):
    """A helper has room for a batch of this task of yours; `result` is what it made of the one before.

    `contexts` are the digests of those that it has.
    """

    kind: Literal["pull-batch"] = "pull-batch"
    task: Digest
    result: BatchResult | None = None
    contexts: Annotated[tuple[Digest, ...], Field(max_length=64)] = ()


class GivenBatch(Frozen):
    """A batch: a named function, its context by digest (without bytes: you have it), and the item."""

    kind: Literal["batch"] = "batch"
    number: Count
    function: Annotated[str, Field(max_length=64)]
    digest: Digest
    context: bytes
    item: bytes


class NoTask(Frozen):
    """The task is not, or no longer, here."""

    kind: Literal["no-task"] = "no-task"
