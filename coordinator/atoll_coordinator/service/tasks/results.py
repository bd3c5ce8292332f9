"""Reads what came of a task from the bytes that its worker sent; for a background thread, since there may be many."""

import hashlib
import json
from dataclasses import dataclass

from atoll_coordinator.service.tasks.outcomes import JobPrepared, JobRefined, PreparationFailed
from atoll_coordinator.service.tasks.task_table import ANALYSES
from atoll_coordinator.tasks.preparing import PreparationOutcome
from atoll_core.errors import RemoteProtocolError
from atoll_core.wire.messages.tasks import TaskFunction
from atoll_core.wire.values import decode_value


@dataclass(frozen=True, slots=True)
class TaskResult:
    """All parts of the result of a task under a term, which is to have the SHA-256 `digest`; `seconds` it ran."""

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

    `outcome` is what is posted for its job, or the bytes of an answer. Without one, the result was `damaged` on its
    way, cannot be read for the reason `unreadable`, or reading it raised `error`.
    """

    result: TaskResult
    outcome: JobPrepared | JobRefined | PreparationFailed | bytes | None = None
    is_damaged: bool = False
    unreadable: str | None = None
    error: Exception | None = None


def read_result(result: TaskResult) -> ResultRead:
    """Join, check and decode a result."""
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
        return JobRefined(result.job, _text(result.job, data))
    made = decode_value(data, PreparationOutcome)
    if not made.is_prepared:
        return PreparationFailed(result.job, "data", made.sentence)
    prepared = made.prepared
    if hashlib.sha256(made.data).hexdigest() != prepared.blob or len(made.data) != prepared.size:
        raise RemoteProtocolError("its dataset is not the one that it names")  # workers would ask for that for ever
    return JobPrepared(result.job, prepared, made.encoded, hashlib.sha256(made.encoded).hexdigest(), made.data)


def _text(job: str, data: bytes) -> str:
    """Return a job's result as text; raises RemoteProtocolError where it is no JSON, or that of another job."""
    try:
        text = data.decode()
        content = json.loads(text)
    except ValueError as error:
        raise RemoteProtocolError(f"it is no JSON ({error})") from error
    if not isinstance(content, dict) or content.get("job") != job:
        raise RemoteProtocolError("it is not that of its job")
    return text
