"""Messages between a worker and its task process, through a pipe on one machine.

`multiprocessing.connection.Connection` carries them as pickles. That is safe because one of the two processes started
the other and both load the same version (`version`); none of these messages goes over a network.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal

from atoll_core import ENGINE_REVISION, PROTOCOL_VERSION, VERSION

Failure = Literal["error", "memory", "crash", "time"]
"""Why a task has no result: an internal error; no memory; its process died; it took too long."""


@dataclass(frozen=True, slots=True)
class Run:
    """To the process: run this task of `job` with `threads` threads and a time limit of `seconds`."""

    task: str
    function: str
    inputs: tuple[bytes, ...]
    seconds: float | None = None
    threads: int = 1
    job: str = ""


@dataclass(frozen=True, slots=True)
class Load:
    """To the process: load the modules for tasks of this function, as soon as the process is idle."""

    function: str


@dataclass(frozen=True, slots=True)
class Ask:
    """To the process of a task: a helper asks for a batch, and has the contexts with these digests."""

    token: int
    contexts: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True)
class Give:
    """From the process of a task: the batch for the asking helper; None: there is none now, ask again."""

    token: int
    batch: "TaskBatch | None"


@dataclass(frozen=True, slots=True)
class TaskBatch:
    """One item of a call of `atoll_coordinator.model.batches.FUNCTIONS`.

    `digest` is the SHA-256 of the context, `context` its bytes (none: the helper has them).
    """

    number: int
    function: str
    digest: str
    context: bytes
    item: bytes


@dataclass(frozen=True, slots=True)
class Take:
    """To the process of a task: a helper's result of a batch; None: it could not be computed."""

    number: int
    result: bytes | None


@dataclass(frozen=True, slots=True)
class BatchComputed:
    """From a helper's process: the result of a batch; None: it could not be computed, for the reason `sentence`."""

    number: int
    result: bytes | None
    failure: Failure = "error"
    sentence: str = ""


@dataclass(frozen=True, slots=True)
class Started:
    """From the process, as its first message: its process id.

    `is_complete`: it was started with the modules for all tasks, or loads them itself; otherwise, with those for
    preparing alone.
    """

    pid: int
    is_complete: bool = True


@dataclass(frozen=True, slots=True)
class Begun:
    """From the process: loading is done, and the task begins."""

    task: str


@dataclass(frozen=True, slots=True)
class Progressed:
    """From the process: the number of candidates that its task has compared."""

    task: str
    compared: int


@dataclass(frozen=True, slots=True)
class TaskFinished:
    """From the process: the result of a task, and the memory that the process uses."""

    task: str
    result: bytes
    memory_bytes: int = 0


@dataclass(frozen=True, slots=True)
class Failed:
    """From the process: the task has no result; the sentence is for users."""

    task: str
    failure: Failure
    sentence: str


@dataclass(frozen=True, slots=True)
class Logged:
    """From the process: the fields of a log record."""

    values: Mapping[str, object]


@dataclass(frozen=True, slots=True)
class Ended:
    """Posted by the thread that watches the process: it has ended; `why` is the reason in a few words."""

    failure: Failure
    why: str


@dataclass(frozen=True, slots=True)
class ProcessMessage:
    """Posted to the worker's loop: a message of its task process. `life` is the process's number on this worker."""

    life: int
    message: "FromProcess"


ToProcess = Run | Load | Ask | Take | TaskBatch
FromProcess = Started | Begun | Progressed | TaskFinished | Failed | Give | BatchComputed | Logged | Ended


OTHER_VERSION: Final = 71
"""Exit code of a task process that was loaded from another version than its worker's: the program was replaced."""


def version() -> str:
    """Return the versions that decide the bits of a task's result, in one word."""
    return f"{VERSION}/{PROTOCOL_VERSION}/{ENGINE_REVISION}"
