"""Submits calls to an executor: shared data once for each process, lost calls again.

The driver's thread calls all methods. The executor's threads only put `Finished` into the driver's inbox. Any exception
of a future means that the call was lost, because `tasks.perform` raises none: its worker was killed, or the executor
could not send it. It is submitted again, up to `MAX_LOSSES` times. Calls are pure, so it does no harm if one is
computed twice. A pool that is broken, as the pools of concurrent.futures are after the death of a worker, is replaced
if the user gave a function that makes another one.

At the end, such as after Ctrl-C, calls that have not begun are cancelled. If a function of the user has made the
executor, the processes of a process pool are killed. Tables that are computed elsewhere end when they see the
`StopSign`.
"""

import hashlib
import itertools
import queue
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future
from dataclasses import dataclass, replace
from typing import Any, Final, Self

from atoll.executors.executors import Adapted, ExecutorError, OtherVersionError, adapted, workers_of
from atoll.executors.tasks import (
    MAX_LOSSES,
    Call,
    Done,
    FunctionFailed,
    Inbox,
    Missing,
    OtherVersion,
    StopSign,
    perform,
)
from atoll_core.task_frames import Failure, version


@dataclass(frozen=True, slots=True, eq=False)
class Finished:
    """Put into the inbox: a future is done. `executor` is the executor that had the call."""

    number: int
    future: "Future[Any]"
    executor: Executor


@dataclass(frozen=True, slots=True)
class Computed:
    """The result of a call, with the `tag` under which it was submitted; `sentence`: its function raised an error.

    `failure` is the kind of the error.
    """

    tag: Any
    value: Any = None
    sentence: str = ""
    failure: Failure = "error"


@dataclass(slots=True)
class _OpenCall:
    """A call without a result; `data` are its shared data, by digest."""

    tag: Any
    call: Call
    data: Mapping[str, bytes]
    future: "Future[Any] | None" = None
    losses: int = 0


class Dispatcher:
    """The calls of one driver; a context manager.

    `workers` is the number of calls that the executor runs at the same time. `inbox` gets a `Finished` for each future
    that is done; the driver may put other events into it. `stop` is set at the end.
    """

    def __init__(self, executor: object, workers: int | None = None) -> None:
        """Use an executor (see `executors.adapted`) with this number of workers; None: as many as it has.

        Several dispatchers may share one that is `Adapted` already; it is not shut down.
        """
        self._is_shared: Final = isinstance(executor, Adapted)
        self._adapted = executor if isinstance(executor, Adapted) else adapted(executor)
        self.workers: Final = workers or workers_of(self._adapted.executor)
        self.inbox: Final[Inbox] = queue.SimpleQueue()
        self.stop: Final = StopSign()
        self._numbers = itertools.count()
        self._open: dict[int, _OpenCall] = {}
        self._sent: Counter[str] = Counter()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        has_open_calls = bool(self._open)
        if has_open_calls:
            self.stop.set()
        self.cancel()
        if not self._is_shared:
            self._adapted.close(is_done=not has_open_calls)

    def submit(self, tag: object, function: str, arguments: tuple[Any, ...], *shared: bytes) -> None:
        """Submit a call of a function of `tasks.FUNCTIONS`.

        Args:
            tag: comes back with the result.
            function: its name.
            arguments: its first arguments.
            shared: data that many calls share, the last arguments of the function.
        """
        data = {hashlib.sha256(one).hexdigest(): one for one in shared}
        call = Call(next(self._numbers), function, arguments, tuple(data), of=version())
        self._open[call.number] = _OpenCall(tag, call, data)
        # There are about as many processes as workers, so most of them get the data with their first call.
        new = {digest: one for digest, one in data.items() if self._sent[digest] < self.workers}
        self._sent.update(new.keys())
        self._send(self._open[call.number], new)

    def wait(self) -> Computed | None:
        """Wait for the next finished future, and return as `take`; for drivers without other events."""
        while True:
            event = self.inbox.get()
            if isinstance(event, Finished):
                return self.take(event)

    def results(self, within: float | None = None) -> Iterator[Computed]:
        """Yield the results of all calls, as they are ready; only those of the next `within` seconds (None: all)."""
        end = None if within is None else time.monotonic() + within
        while self._open:
            try:
                event = self.inbox.get(timeout=None if end is None else max(0.0, end - time.monotonic()))
            except queue.Empty:
                return
            computed = self.take(event) if isinstance(event, Finished) else None
            if computed is not None:
                yield computed

    def take(self, finished: Finished) -> Computed | None:
        """Return the result of a finished future; None: its call was submitted again, or is not needed any more.

        Raises:
            ExecutorError: the call was lost too often, the executor is broken and cannot be replaced, or a worker has
                another version.
        """
        entry = self._open.get(finished.number)
        if entry is None or entry.future is not finished.future:
            return None
        try:
            error = finished.future.exception()
        except CancelledError as cancelled:
            error = cancelled
        if error is not None:  # also a KeyboardInterrupt of the process there, which is not one of this process
            self._lose(entry, finished.executor, error)
            return None
        outcome = finished.future.result()
        if isinstance(outcome, Missing):
            self._send(entry, {digest: entry.data[digest] for digest in outcome.digests})
            return None
        del self._open[finished.number]
        if isinstance(outcome, FunctionFailed):
            return Computed(entry.tag, sentence=outcome.sentence, failure=outcome.failure)
        if isinstance(outcome, OtherVersion):
            raise OtherVersionError(
                f"a worker of the executor has Atoll {outcome.version}, but the caller has {version()}; install the "
                "same version on all machines of the executor, and start its workers again"
            )
        assert isinstance(outcome, Done)
        return Computed(entry.tag, outcome.value)

    def cancel(self, is_needed: Callable[[Any], bool] = lambda tag: False) -> None:
        """Forget the calls whose tags are not needed; calls that have not begun are cancelled."""
        for number, entry in [*self._open.items()]:
            if not is_needed(entry.tag):
                del self._open[number]
                if entry.future is not None:
                    entry.future.cancel()

    def _send(self, entry: _OpenCall, data: Mapping[str, bytes]) -> None:
        executor, number = self._adapted.executor, entry.call.number
        try:
            future = executor.submit(perform, replace(entry.call, data=data))
        except BrokenExecutor as error:  # found by this call first
            self._lose(entry, executor, error)
            return
        except RuntimeError as error:
            raise ExecutorError(
                f"the executor takes no tasks ({error}); give an executor that has not been shut down"
            ) from error
        entry.future = future
        future.add_done_callback(lambda done: self.inbox.put(Finished(number, done, executor)))

    def _lose(self, entry: _OpenCall, executor: Executor, error: BaseException) -> None:
        """Submit a lost call again, to another executor if this one is broken."""
        entry.losses += 1
        if entry.losses > MAX_LOSSES:
            raise ExecutorError(
                f"the executor lost the same task {entry.losses} times ({type(error).__name__}: {error}); check that "
                "its workers have the same version of Atoll as the caller, and enough memory"
            ) from error
        if isinstance(error, BrokenExecutor):
            self._replace(executor, error)
        self._send(entry, entry.data)

    def _replace(self, executor: Executor, error: BrokenExecutor) -> None:
        if self._adapted.make is None:
            raise ExecutorError(
                f"a worker of the {type(executor).__name__} has died, as happens when memory runs out, and such "
                "an executor cannot be used after this; give a function that makes another one, such as "
                "executor=lambda: ProcessPoolExecutor(4), or use loky, Dask or the service"
            ) from error
        self._adapted.replace(executor)
