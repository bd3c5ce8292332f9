"""Background work: a separate thread works on large values, one after another, and posts outcomes to the loop.

The thread writes checkpoints, checks tables, reads results of tasks, composes results of jobs that are not refined, and
writes the equations of views. So the service's loop never handles more bytes at a time than the bytes of one message.

The thread changes the store, but no job: an outcome is posted to the loop, and only the loop changes jobs. The loop may
have ended or deleted the job meanwhile, so each handler of an outcome must check this. Exceptions are part of outcomes,
and the loop raises them. *Doubts.* There is one thread, so a result that takes long to compose delays the checkpoints
of all jobs.
"""

import hashlib
import json
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime

from atoll_coordinator.model.refinement import Refinement
from atoll_coordinator.service.jobs.job import Fault
from atoll_coordinator.service.monitoring.job_views import Draft
from atoll_coordinator.service.monitoring.view_equations import FrontWritten, ViewFront
from atoll_coordinator.service.search.archipelago import Checkpoint
from atoll_coordinator.service.store.retention import KEEP_ALL, Retention
from atoll_coordinator.service.store.store import Store
from atoll_coordinator.service.tasks.task_table import ANALYSES
from atoll_coordinator.tasks.preparing import PreparationOutcome, Prepared
from atoll_core.errors import RemoteProtocolError
from atoll_core.wire.messages.tasks import TaskFunction
from atoll_core.wire.values import decode_value


def iso_now() -> str:
    """Return the time of day, UTC, to the millisecond."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")


@dataclass(frozen=True, slots=True)
class Dependencies:
    """Dependencies of a service in addition to bus and store; tests replace them.

    `clock` returns the time of day as ISO text, `background` executes functions in order, and `retention` decides which
    ended jobs are kept.
    """

    clock: Callable[[], str] = iso_now
    retention: Retention = KEEP_ALL
    background: Callable[[Callable[[], None]], object] = field(
        default_factory=lambda: ThreadPoolExecutor(1, "background").submit
    )


# ----------------------------------------------------------------------------------------------------------- outcomes


@dataclass(frozen=True, slots=True)
class TableChecked:
    """The table of a job was checked. `is_sound`: the table is stored undamaged; `error`: the error of reading it."""

    job: str
    is_sound: bool
    error: Exception | None = None


@dataclass(frozen=True, slots=True)
class PreparationBegun:
    """A loaded process has begun to prepare a job: its `--max-time` counts from now on."""

    job: str


@dataclass(frozen=True, slots=True)
class JobPrepared:
    """A job is prepared. `encoded` are the prepared data as bytes with the SHA-256 `digest`, `data` is its dataset.

    When this outcome is posted, both are stored, and `data` is empty. `former` is the digest of the dataset that was
    stored for the job earlier (None: there was none).
    """

    job: str
    prepared: Prepared
    encoded: bytes
    digest: str
    data: bytes = b""
    former: str | None = None


@dataclass(frozen=True, slots=True)
class PreparationFailed:
    """A job cannot be prepared, for the reason in `sentence`."""

    job: str
    fault: Fault
    sentence: str


@dataclass(frozen=True, slots=True)
class JobRefined:
    """A job is refined. `text` is its result as JSON, without the duration of the job (`result.result.timed`)."""

    job: str
    text: str


@dataclass(frozen=True, slots=True)
class RefiningFailed:
    """A job could not be refined: `refinement` has a warning instead."""

    job: str
    refinement: Refinement


@dataclass(frozen=True, slots=True)
class ResultComposed:
    """A result was composed: `text` is JSON without the duration of the job; `error`: the error of composing it."""

    draft: Draft
    text: str = ""
    error: Exception | None = None


@dataclass(frozen=True, slots=True)
class CheckpointWritten:
    """A checkpoint was written; `error`: the error of writing it."""

    checkpoint: Checkpoint
    error: Exception | None = None


Outcome = (
    TableChecked | PreparationBegun | JobPrepared | PreparationFailed | JobRefined | RefiningFailed | CheckpointWritten
    | FrontWritten
)  # fmt: skip
"""Items posted to the loop and handled by `JobController.take_outcome`."""


@dataclass(frozen=True, slots=True)
class TaskResult:
    """All parts of the result of a task under a term. Their SHA-256 must be `digest`; the task ran for `seconds`."""

    task: str
    term: int
    job: str
    function: TaskFunction
    parts: tuple[bytes, ...]
    digest: str
    seconds: float


@dataclass(frozen=True, slots=True)
class ResultRead:
    """The result of a task was read.

    `outcome` is the item to post for its job, or the bytes of an answer. Without an outcome, the result was damaged in
    transit, is `unreadable` for this reason, or reading it raised `error`.
    """

    result: TaskResult
    outcome: JobPrepared | JobRefined | PreparationFailed | bytes | None = None
    is_damaged: bool = False
    unreadable: str | None = None
    error: Exception | None = None


# --------------------------------------------------------------------------------------------------------- background


class Background:
    """Executes work by `act`, in order, and posts its outcomes."""

    def __init__(
        self, act: Callable[[Callable[[], None]], object], store: Store, post: Callable[[object], None]
    ) -> None:
        self._act = act
        self._store = store
        self._post = post

    def write_checkpoint(self, checkpoint: Checkpoint, progress: bytes, elapsed: float) -> None:
        """Make a checkpoint durable; `CheckpointWritten` is posted."""

        def write() -> CheckpointWritten:
            key = checkpoint.job, checkpoint.variable, checkpoint.epoch
            try:
                self._store.commit_checkpoint(*key, progress, checkpoint.states, elapsed)
            except Exception as error:  # the loop raises it
                return CheckpointWritten(checkpoint, error)
            return CheckpointWritten(checkpoint)

        self._act(lambda: self._post(write()))

    def check_table(self, job: str, digest: str) -> None:
        """Read the table of a job, which takes a second for 100 MB; `TableChecked` is posted."""

        def check() -> TableChecked:
            try:
                return TableChecked(job, self._store.is_sound(digest))
            except Exception as error:  # the loop raises it
                return TableChecked(job, False, error)

        self._act(lambda: self._post(check()))

    def read_result(self, result: TaskResult) -> None:
        """Read the result of a task, and store prepared data; `ResultRead` is posted."""

        def read() -> ResultRead:
            unread = replace(result, parts=())
            try:
                done = read_result(result)
                if isinstance(done.outcome, JobPrepared):
                    made = done.outcome
                    former = self._store.keep_prepared(made.job, made.data, made.encoded)
                    done = replace(done, outcome=replace(made, data=b"", former=former))
                return replace(done, result=unread)
            except Exception as error:  # the loop raises it; any error but a StoreError ends only the job
                return ResultRead(unread, error=error)

        self._act(lambda: self._post(read()))

    def write_front(self, front: ViewFront) -> None:
        """Write the shown equation of a front for views; `FrontWritten` is posted."""
        self._act(lambda: self._post(front.write()))

    def compose_result(self, draft: Draft) -> None:
        """Compose the result of a job, which judges equations on all rows; `ResultComposed` is posted."""

        def compose() -> ResultComposed:
            try:
                return ResultComposed(draft, draft.compose())
            except Exception as error:  # the loop raises it
                return ResultComposed(draft, error=error)

        self._act(lambda: self._post(compose()))


def read_result(result: TaskResult) -> ResultRead:
    """Join, check and decode the result of a task."""
    data = b"".join(result.parts)
    if hashlib.sha256(data).hexdigest() != result.digest:
        return ResultRead(result, is_damaged=True)
    try:
        return ResultRead(result, _outcome(result, data))
    except RemoteProtocolError as error:
        return ResultRead(result, unreadable=f"its result cannot be read: {error}")


def _outcome(result: TaskResult, data: bytes) -> JobPrepared | JobRefined | PreparationFailed | bytes:
    if result.function in ANALYSES:
        return data
    if result.function == "refine":
        try:
            text = data.decode()
            content = json.loads(text)
        except ValueError as error:
            raise RemoteProtocolError(f"it is not JSON ({error})") from error
        if not isinstance(content, dict) or content.get("job") != result.job:
            raise RemoteProtocolError("it belongs to another job")
        return JobRefined(result.job, text)
    made = decode_value(data, PreparationOutcome)
    if not made.is_prepared:
        return PreparationFailed(result.job, "data", made.sentence)
    prepared = made.prepared
    if hashlib.sha256(made.data).hexdigest() != prepared.blob or len(made.data) != prepared.size:
        # Workers would request the named dataset for ever.
        raise RemoteProtocolError("its dataset does not have the digest and size that it names")
    return JobPrepared(result.job, prepared, made.encoded, hashlib.sha256(made.encoded).hexdigest(), made.data)
