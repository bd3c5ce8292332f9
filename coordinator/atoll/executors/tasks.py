"""The functions that run on the workers of an executor. All are pure, so a lost task can be computed again anywhere.

How it works. `perform` gets a `Call`: the name of a function, its arguments, and the digests of shared data. A process
keeps the last shared data by digest; if data are missing, `perform` returns `Missing`, and the driver sends the call
again with them. So each process gets a dataset once, from any executor, without a file system that all machines see.

All work is done in a task process (`TaskProcess`), as on a worker of the service: a fresh interpreter with the same
settings of linear algebra, so that the bits do not depend on what the executor's process has loaded before. The task
process is the one that the system ends if memory runs out. Then it is started again, and the executor notices nothing.
It ends with the executor's process, or after two minutes without a task.

A process of a pool waits for calls forever if its caller is killed, because the other processes of the pool hold the
pipe open. So `perform` lets such a process end when its parent has ended. Dask, MPI and Ray end their own workers.

Doubtful: an executor that starts another process for each task would also start a task process for each task.
"""

import atexit
import contextlib
import functools
import multiprocessing
import os
import platform
import queue
import secrets
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from atoll_core import task_frames as frames
from atoll_core.errors import AtollError, DataError
from atoll_core.task_frames import TaskBatch, version
from atoll_island_worker.downloads import ByteCache

if TYPE_CHECKING:
    from atoll.executors.driver import SubmittedTable
    from atoll_island_worker.tasks.task_process import TaskProcess

Inbox = queue.SimpleQueue[object]

MAX_LOSSES: Final = 5
"""Number of lost workers or processes after which a task fails, as on the service."""

_LESS_MEMORY: Final = "; let fewer tasks run at a time (workers=...), use machines with more memory, or fewer rows"


def what_to_do(failure: frames.Failure) -> str:
    """Return the end of a sentence about a failure of this kind; "" if there is no advice."""
    return _LESS_MEMORY if failure == "memory" else ""


@dataclass(frozen=True, slots=True)
class Call:
    """A call of a function of this module.

    `number` is unique for its driver, so that no executor takes two calls for the same. `shared` are digests of shared
    data; `data` are the shared data that are sent along, by digest. `of` is the version of the caller.
    """

    number: int
    function: str
    arguments: tuple[Any, ...]
    shared: tuple[str, ...] = ()
    data: Mapping[str, bytes] = field(default_factory=dict)
    of: str = ""


@dataclass(frozen=True, slots=True)
class Done:
    """The result of a call."""

    value: Any


@dataclass(frozen=True, slots=True)
class Missing:
    """The process has not got the shared data with these digests."""

    digests: frozenset[str]


@dataclass(frozen=True, slots=True)
class OtherVersion:
    """The process has this version of Atoll, and the caller another one."""

    version: str


@dataclass(frozen=True, slots=True)
class FunctionFailed:
    """The function raised an error. The sentence is for users; `what_to_do` has its end."""

    sentence: str
    failure: frames.Failure = "error"


class BatchFailedError(AtollError):
    """Raised when a batch cannot be computed; `failure` is the cause."""

    def __init__(self, failure: frames.Failure, sentence: str) -> None:
        super().__init__(sentence)
        self.failure: Final = failure


_PARENT_CHECK_S: Final = 1.0
_shared: Final = ByteCache()
_lock: Final = threading.Lock()


def perform(call: Call) -> Done | Missing | OtherVersion | FunctionFailed:
    """Return the outcome of a call. No exception is raised, so an exception of a future is always a lost task."""
    _end_with_parent(os.getpid())
    if call.of != version():
        return OtherVersion(version())
    with _lock:
        for digest, data in call.data.items():
            _shared.add(digest, data)
        shared = [call.data.get(digest, _shared.get(digest)) for digest in call.shared]
    missing = frozenset(digest for digest, data in zip(call.shared, shared, strict=True) if data is None)
    if missing:
        return Missing(missing)
    try:
        return Done(FUNCTIONS[call.function](*call.arguments, *shared))
    except BatchFailedError as error:
        return FunctionFailed(str(error), error.failure)
    except MemoryError:
        return FunctionFailed(f"memory ran out on a worker of the executor ({platform.node()})", "memory")
    except Exception as error:
        return FunctionFailed(str(error) if isinstance(error, AtollError) else f"{type(error).__name__}: {error}")


@functools.cache
def _end_with_parent(pid: int) -> None:
    """Let a process of a pool end when its parent has ended; called by each process `pid`, does so once.

    A process of a pool is one that multiprocessing or loky has started, and that computes in its main thread. No other
    process is ended: a worker of Dask may have been started by a shell that has ended since.
    """
    if multiprocessing.parent_process() is None or threading.current_thread() is not threading.main_thread():
        return
    parent = os.getppid()

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(_PARENT_CHECK_S)
        os._exit(1)

    threading.Thread(target=watch, name="watching the parent", daemon=True).start()


# ---------------------------------------------------------------------------------------------------------- functions


def compute_batch(function: str, item: bytes, context: bytes) -> bytes:
    """Return the result of a batch, see `atoll_coordinator.model.batches`; epochs of islands are batches, too."""
    inbox: Inbox = queue.SimpleQueue()
    failure: frames.Failure = "crash"
    why = ""
    with borrowed_process(inbox) as process:
        for _ in range(MAX_LOSSES):
            process.send(TaskBatch(0, function, "", context, item))
            answer = _answer(inbox)
            if isinstance(answer, frames.Ended):
                failure, why = answer.failure, answer.why
            elif answer.result is not None:
                return answer.result
            elif answer.failure == "memory":
                failure, why = answer.failure, answer.sentence
                process.stop()
            else:
                raise BatchFailedError(answer.failure, f"a batch could not be computed ({answer.sentence})")
    where = f"on a worker of the executor ({platform.node()})"
    raise BatchFailedError(failure, f"a task failed {MAX_LOSSES} times {where}: {why}")


class StopSign:
    """Is set when a caller does not need its calls any more.

    Threads of the caller's process see an event. Processes that see the caller's folder of temporary files see a file
    there. In other processes, such as those of other machines, the sign is never set. The file exists only after the
    sign was set, so a lost file can end no call.
    """

    def __init__(self, file: str = "") -> None:
        """`file` is the path of the file; a sign that is sent gets a new name in the folder of temporary files."""
        self._event = threading.Event()
        self._file = file

    def __reduce__(self) -> tuple[type["StopSign"], tuple[str]]:
        with contextlib.suppress(OSError):  # without such a folder, calls in other processes compute to their end
            self._file = self._file or str(Path(tempfile.gettempdir()) / f"atoll-stop-{secrets.token_hex(16)}")
        if self._event.is_set():  # the executor sends a call that began just before
            self._write()
        return StopSign, (self._file,)

    def set(self) -> None:
        """Let the calls end. If the sign was sent to other processes, its file exists until this process ends."""
        self._event.set()
        self._write()

    def _write(self) -> None:
        if not self._file:  # the sign was not sent, or there is no folder of temporary files
            return
        with contextlib.suppress(OSError):  # then calls in other processes compute to their end
            Path(self._file).touch(exist_ok=True)
            atexit.register(_remove_seen, Path(self._file), time.monotonic() + _SEEN_S)

    @property
    def is_set(self) -> bool:
        """Whether the results are not needed any more."""
        # unlike Path.exists, this is False, too, for a folder into which another user may not look
        return self._event.is_set() or (self._file != "" and os.path.exists(self._file))  # noqa: PTH110


_SEEN_S: Final = 1.0
"""Time after which all processes have seen the file of a sign: they look several times a second."""


def _remove_seen(file: Path, until: float) -> None:
    """Remove the file of a sign, at the earliest at a time of the monotonic clock."""
    time.sleep(max(0.0, until - time.monotonic()))
    with contextlib.suppress(OSError):
        file.unlink(missing_ok=True)


@dataclass(frozen=True, slots=True)
class Solved:
    """The result of a job as JSON, or the sentence why it failed; `is_of_data`: the data caused the error."""

    text: str = ""
    sentence: str = ""
    is_of_data: bool = False


def solve_table(submitted: "SubmittedTable", stop: StopSign) -> Solved:
    """Solve a whole job in this process and its task process, unless `stop` is set meanwhile."""
    from atoll.executors.driver import solve
    from atoll.executors.executors import InlineExecutor

    try:
        return Solved(solve(submitted, InlineExecutor(), 1, stop=stop))
    except AtollError as error:
        return Solved(sentence=str(error), is_of_data=isinstance(error, DataError))


FUNCTIONS: Final[Mapping[str, Callable[..., Any]]] = {
    "batch": compute_batch, "table": solve_table,
}  # fmt: skip


# ------------------------------------------------------------------------------------------------------ task processes

_IDLE_CHECK_S: Final = 10.0
_free: Final[list["TaskProcess"]] = []
"""Task processes without a task; each thread that computes takes one."""


@contextmanager
def borrowed_process(inbox: Inbox) -> "Iterator[TaskProcess]":
    """Context manager: a task process, which puts its messages into `inbox`. After an error it is ended."""
    from atoll_island_worker.tasks.task_process import TaskProcess

    _end_idle_processes(os.getpid())
    try:
        process = _free.pop()
    except IndexError:
        process = TaskProcess()
    process.attach(inbox.put)
    try:
        yield process
    except BaseException:
        process.stop()
        raise
    _free.append(process)


def _answer(inbox: Inbox) -> frames.BatchComputed | frames.Ended:
    """Return the next batch, or the end of the process."""
    while True:
        match inbox.get():
            case frames.ProcessMessage(message=(frames.BatchComputed() | frames.Ended()) as message):
                return message


@functools.cache
def _end_idle_processes(pid: int) -> None:
    """Start the thread that ends task processes after a long time without a task; once for each process `pid`."""

    def watch() -> None:
        while True:
            time.sleep(_IDLE_CHECK_S)
            end_idle_processes()

    threading.Thread(target=watch, name="ending idle task processes", daemon=True).start()


def end_idle_processes() -> None:
    """End the free task processes that have had no task for a long time.

    Each is taken out of the free ones meanwhile, so that no thread gives it a task while it is ended.
    """
    for _ in range(len(_free)):
        try:
            process = _free.pop(0)
        except IndexError:  # other threads have taken the rest
            return
        process.stop_if_idle()
        _free.append(process)


def _forget_parent() -> None:
    """Forget, in a fork, what belongs to the parent: its task processes, and a lock that another thread may hold."""
    global _lock
    _lock = threading.Lock()  # type: ignore[misc]
    _free.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_parent)
