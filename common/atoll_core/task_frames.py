"""Messages between a worker and its task process, through a pipe on one machine.

`multiprocessing.connection.Connection` carries them as pickles. That is safe because one of the two processes started
the other and both load the same version (`version`); none of these messages goes over a network.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal

from atoll_core import ENGINE_REVISION, PROTOCOL_VERSION, VERSION

Failure = Literal["error", "memory", "crash", "time"]
"""Why a task has no result: something of ours broke; memory ran out; its process died; it took too long."""


@dataclass(frozen=True, slots=True)
class Run:
    """To the process: run this task of `job`. It may use so many `threads`, and take so many `seconds`."""

    task: str
    function: str
    inputs: tuple[bytes, ...]
    seconds: float | None = None
    threads: int = 1
    job: str = ""


@dataclass(frozen=True, slots=True)
class Load:
    """To the process: load what tasks of this function need, as soon as there is nothing else to do."""

    function: str


@dataclass(frozen=True, slots=True)
class Ask:
    """To the process of a task: a helper has room for a batch, and knows these contexts by digest."""

    token: int
    contexts: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True)
class Give:
    """From the process of a task: the batch for the helper that asked; None: there is none now, ask again."""

    token: int
    batch: "Batch | None"


@dataclass(frozen=True, slots=True)
class Batch:
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
    """To the process of a task: what a helper made of a batch; None: it could not be made."""

    number: int
    result: bytes | None


@dataclass(frozen=True, slots=True)
class Computed:
    """From a helper's process: what it made of a batch; None: it could not be made."""

    number: int
    result: bytes | None


@dataclass(frozen=True, slots=True)
class Started:
    """From the process, first of all: its number."""

    pid: int


@dataclass(frozen=True, slots=True)
class Begun:
    """From the process: all is loaded, and the task begins."""

    task: str


@dataclass(frozen=True, slots=True)
class Progressed:
    """From the process: how many candidates its task has compared."""

    task: str
    compared: int


@dataclass(frozen=True, slots=True)
class Finished:
    """From the process: the result of a task, and the memory that the process occupies."""

    task: str
    result: bytes
    memory_bytes: int = 0


@dataclass(frozen=True, slots=True)
class Failed:
    """From the process: the task has no result; the sentence is for people."""

    task: str
    failure: Failure
    sentence: str


@dataclass(frozen=True, slots=True)
class Logged:
    """From the process: the fields of a log record."""

    values: Mapping[str, object]


@dataclass(frozen=True, slots=True)
class Ended:
    """Posted by who started the process: it has ended, and why in a few words."""

    failure: Failure
    why: str


@dataclass(frozen=True, slots=True)
class Said:
    """Posted to the worker's loop: what its process says. `life` counts the processes that it has started."""

    life: int
    message: "FromProcess"


ToProcess = Run | Load | Ask | Take | Batch
FromProcess = Started | Begun | Progressed | Finished | Failed | Give | Computed | Logged | Ended


OTHER_VERSION: Final = 71
"""Exit code of a task process that was loaded from another version than its worker: the program was replaced."""


def version() -> str:
    """Return in one word what of an installation decides which bits come of a task."""
    return f"{VERSION}/{PROTOCOL_VERSION}/{ENGINE_REVISION}"
