"""The program of a task process: runs tasks one after another until its worker closes the pipe.

How it works: one thread runs tasks; another thread reads the messages of the worker, so that this process ends with the
worker, even in the middle of a task. A task may split its work into batches (`Team.map`): a batch is a function name, a
context that all batches share, and an item, all encoded. This process computes batches from the front of the list.
Other workers without a task (helpers) ask for batches through their worker and the bus, and get batches from the back.
Results are stored by the position of their item, and each batch is a pure function of context and item, so the result
does not depend on where or when a batch was computed. A batch that fails at a helper is computed here. If all batches
are taken, this process also computes the oldest batch of a helper after a while; the first result is used.

Doubtful: the waiting time for a helper (`LATE` times the longest batch here) is a guess, so a slow helper costs a batch
that is computed twice. `Team.workers` counts only helpers that asked recently.
"""

import contextlib
import hashlib
import importlib
import logging
import os
import queue
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Final

from atoll.tasks.functions import FUNCTIONS as TASK_FUNCTIONS
from atoll.tasks.functions import load_kernels_of_batches
from atoll_core import task_frames as frames
from atoll_core.logs import fields
from atoll_core.machine import collect_rarely, memory_bytes
from atoll_core.signals import ENDING, ignore
from atoll_core.task_frames import OTHER_VERSION, Ask, FromProcess, Give, Progressed, TaskBatch, version
from atoll_core.wire.messages.tasks import MAX_BATCH

HOLD_S: Final = 2.0
"""Seconds after which a helper that waits for a batch must ask again; shorter than the helper's timeout."""

NOTED_S: Final = 1.0
"""Shortest interval of progress messages to the worker, in seconds; its heartbeats need no shorter interval."""

LATE: Final = 2.0
"""A batch of a helper is also computed here after `LATE` times the longest duration of a batch here."""

_LOG = logging.getLogger(__name__)


@dataclass(eq=False, slots=True)
class _Call:
    """One call of `Team.map`: its items and their states, by position. `first` is the number of its first batch."""

    function: str
    digest: str
    context: bytes
    items: Sequence[bytes]
    first: int
    waiting: deque[int]
    given: dict[int, float] = field(default_factory=dict)
    results: dict[int, bytes] = field(default_factory=dict)
    longest_s: float = 0.0

    @property
    def is_complete(self) -> bool:
        return len(self.results) == len(self.items)


class Team:
    """Distributes batches between this process and helpers; implements `atoll_coordinator.model.batches.Batches`.

    `threads` is the number of threads that this process may use.
    """

    def __init__(self, send: Callable[[FromProcess], None], clock: Callable[[], float] = time.monotonic) -> None:
        """`send` sends a message to the worker and may be called from any thread."""
        self.threads = 1
        self._task = ""
        self._here = self._elsewhere = self._compared = 0
        self._noted_at = 0.0
        self._send = send
        self._clock = clock
        self._changed = threading.Condition()
        self._asked: deque[tuple[Ask, float]] = deque()
        self._asked_at: float | None = None
        self._calls: list[_Call] = []
        self._numbers = int.from_bytes(os.urandom(5))  # random, so that late answers for another process match no batch

    # ----------------------------------------------------------------------------------- the task's threads

    @property
    def workers(self) -> int:
        """Approximate number of helpers; 0: values need not be encoded."""
        if self._asked_at is None or self._clock() - self._asked_at > 2.0 * HOLD_S:
            return 0
        with self._changed:
            return max(1, len(self._asked) + sum(len(call.given) for call in self._calls))

    def begin(self, task: str, threads: int) -> None:
        """Begin a task that may use `threads` threads."""
        self._task, self.threads = task, threads
        self._here = self._elsewhere = self._compared = 0
        self._noted_at = self._clock()

    def note(self, compared: int) -> None:
        """Add to the number of compared candidates, from any thread, and report it to the worker."""
        with self._changed:
            self._compared += compared
            now = self._clock()
            if now - self._noted_at >= NOTED_S:
                self._noted_at = now
                self._send(Progressed(self._task, self._compared))

    @property
    def counts(self) -> dict[str, int]:
        """Numbers of candidates compared, of batches computed here, and of batches computed by helpers."""
        return {
            "compared": self._compared, "batches_here": self._here, "batches_elsewhere": self._elsewhere,
        }  # fmt: skip

    def end(self) -> None:
        """End a task, and tell waiting helpers that there is no batch."""
        with self._changed:
            self._asked_at = None
            while self._asked:
                self._give(None)

    def map(
        self, function: str, context: bytes, items: Sequence[bytes], cancel_after: float | None = None
    ) -> list[bytes]:
        """See `atoll_coordinator.model.batches.Batches.map`."""
        from atoll_coordinator.model.batches import CANCELLED

        end = None if cancel_after is None else self._clock() + cancel_after
        digest = hashlib.sha256(context).hexdigest()
        with self._changed:
            call = _Call(function, digest, context, items, self._numbers, deque(range(len(items))))
            self._numbers += len(items)
            self._calls.append(call)
            self._serve_waiting()
        try:
            while not call.is_complete and (end is None or self._clock() < end):
                place = self._next(call, end)
                if place is not None:
                    began = self._clock()
                    result = _computed(call.function, call.context, call.items[place])
                    with self._changed:
                        call.longest_s = max(call.longest_s, self._clock() - began)
                        if self._settle(call, place, result):
                            self._here += 1
        finally:
            with self._changed:
                self._calls.remove(call)
        return [call.results.get(place, CANCELLED) for place in range(len(items))]

    def _next(self, call: _Call, end: float | None) -> int | None:
        """Return the position of the next item to compute here; None: check again for answers of helpers."""
        with self._changed:
            if call.waiting:
                return call.waiting.popleft()
            out = [(given, place) for place, given in call.given.items()]
            if not out:
                return None
            now = self._clock()
            given, place = min(out)
            due = given + LATE * call.longest_s
            if now < due:
                self._changed.wait((due if end is None else min(due, end)) - now)
                return None
            call.given[place] = now
            return place

    # ----------------------------------------------------------------------------------- the reading thread

    def ask(self, question: Ask) -> None:
        """Register that a helper asks for a batch: it gets a batch as soon as there is one."""
        with self._changed:
            self._asked_at = self._clock()
            self._asked.append((question, self._asked_at))
            self._serve_waiting()

    def take(self, number: int, result: bytes | None) -> None:
        """Process a helper's result of a batch; if the batch failed there (None), it is computed here next."""
        with self._changed:
            call = next((one for one in self._calls if one.first <= number < one.first + len(one.items)), None)
            if call is None or number - call.first not in call.given:
                return
            place = number - call.first
            if result is None:
                del call.given[place]
                call.waiting.appendleft(
                    place
                )  # not to another helper, which might fail, too: helpers get batches from the back
            else:
                self._elsewhere += self._settle(call, place, result)
            self._changed.notify_all()

    def expire(self) -> None:
        """Make helpers that have waited too long ask again."""
        now = self._clock()
        with self._changed:
            while self._asked and now - self._asked[0][1] >= HOLD_S:
                self._give(None)

    def _settle(self, call: _Call, place: int, result: bytes) -> bool:
        """Store a result; return whether it is the first result of the item."""
        is_first = place not in call.results
        call.results.setdefault(place, result)
        call.given.pop(place, None)
        return is_first

    def _serve_waiting(self) -> None:
        while self._asked:
            batch = self._batch(self._asked[0][0])
            if batch is None:
                return
            self._give(batch)

    def _give(self, batch: TaskBatch | None) -> None:
        """Answer the helper that has waited longest."""
        question, _ = self._asked.popleft()
        self._send(Give(question.token, batch))

    def _batch(self, question: Ask) -> TaskBatch | None:
        """Return a batch for a helper: the last item of the call with most waiting items; the first item stays here."""
        fit = [call for call in self._calls if len(call.waiting) > 1 and _size(call) <= MAX_BATCH]
        if not fit:
            return None
        call = max(fit, key=lambda one: len(one.waiting))
        place = call.waiting.pop()
        call.given[place] = self._clock()
        context = b"" if call.digest in question.contexts else call.context
        return TaskBatch(call.first + place, call.function, call.digest, context, call.items[place])


def _size(call: _Call) -> int:
    return len(call.context) + len(call.items[call.waiting[-1]])


def compute(batch: TaskBatch) -> frames.BatchComputed:
    """Return the result of a batch of another worker's task; if it fails here, that worker computes it."""
    try:
        load_kernels_of_batches(batch.function)
        return frames.BatchComputed(batch.number, _computed(batch.function, batch.context, batch.item))
    except MemoryError:
        return frames.BatchComputed(batch.number, None, "memory", "memory ran out")
    except Exception as error:
        _LOG.exception("a batch failed")
        return frames.BatchComputed(batch.number, None, "error", _in_one_line(error))


def _in_one_line(error: Exception) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())[:2000]


def _computed(function: str, context: bytes, item: bytes) -> bytes:
    from atoll_coordinator.model.batches import FUNCTIONS

    if function not in FUNCTIONS:
        importlib.import_module(_MODULES.get(function, _OTHERS))
    return FUNCTIONS[function](context, item)


_MODULES: Final = {
    "epochs": "atoll.executors.epochs",
    "profile": "atoll.experiments.identifiability",
    **dict.fromkeys(("trials", "improvements", "outcomes"), "atoll.experiments.suggestion"),
    "cycles": "atoll.analysis.limit_cycles",
    "dynamics": "atoll.analysis.analyse",
    "trajectory starts": "atoll_coordinator.model.shooting.many_starts",
    "hidden courses": "atoll_coordinator.model.hidden.alternation",
}
_OTHERS: Final = "atoll_coordinator.model.pipeline"
"""Modules that add to the table of batch functions: by function, and the module of all others."""


_STDIN: Final = 0
_STDOUT: Final = 1
_STDERR: Final = 2
_MORE_LIKELY: Final = "500"
_POLL_S: Final = 0.25
_NAME_DIGITS: Final = 12
"""Digits of a task's name in a log line."""


def main(descriptor: int, level: int, of: str) -> None:
    """Run tasks until the worker at the other end of the pipe `descriptor` has ended; `of` is the worker's version.

    `level`: minimum level of log records.
    """
    if of != version():
        sys.exit(OTHER_VERSION)
    serve(Connection(descriptor), level)


def serve(
    connection: "Connection[frames.FromProcess, frames.ToProcess]", level: int, *, is_complete: bool = True
) -> None:
    """Run the tasks that come through a pipe until the worker at its other end has ended.

    `is_complete`: see `frames.Started`.
    """
    ignore(ENDING)  # signals to the process group are for the worker
    os.environ.setdefault(
        "OPENBLAS_NUM_THREADS", "1"
    )  # matrices are small, so threads of numpy's library would mostly wait
    if sys.platform == "linux":
        with contextlib.suppress(OSError):  # if memory runs out, the system should end this process before its worker
            Path("/proc/self/oom_score_adj").write_text(_MORE_LIKELY, "ascii")
    collect_rarely()
    # stdout belongs to the worker: printed text goes to stderr
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, _STDIN)
    os.close(nothing)
    os.dup2(_STDERR, _STDOUT)
    TaskLoop(connection, level).work(is_complete)


class TaskLoop:
    """Runs the tasks of this worker and computes batches for other workers, as messages from the pipe request."""

    def __init__(self, connection: "Connection[frames.FromProcess, frames.ToProcess]", level: int) -> None:

        self._connection = connection
        self._sending = threading.Lock()
        self._waiting: queue.SimpleQueue[frames.Run | frames.Load | frames.TaskBatch] = queue.SimpleQueue()
        self._team: Final = Team(self._send)
        logging.basicConfig(level=level, handlers=[_LogSender(self._send)], force=True)

    def work(self, is_complete: bool = True) -> None:
        """Run tasks and batches one after another, without end; the end of the pipe ends the process."""
        self._send(frames.Started(os.getpid(), is_complete))
        threading.Thread(target=self._read, name="reading tasks", daemon=True).start()
        while True:
            match self._waiting.get():
                case frames.Run() as run:
                    self._run(run)
                    del run
                case frames.Load() as load:
                    self._load(load)
                case frames.TaskBatch() as batch:
                    self._send(compute(batch))
                    del batch

    def _load(self, load: frames.Load) -> None:
        if self._waiting.empty():
            TASK_FUNCTIONS[load.function].load()  # type: ignore[index]  # a name of the table, by the type of the message

    def _run(self, run: frames.Run) -> None:
        about = {"job": run.job or None, "task": run.task[:_NAME_DIGITS], "function": run.function}
        try:
            function = TASK_FUNCTIONS[run.function]  # type: ignore[index]
            (function.load if run.seconds is None else function.ready)()
            self._send(frames.Begun(run.task))
            self._team.begin(run.task, run.threads)
            _LOG.info("a task begins", extra=fields(**about, threads=run.threads))
            began = time.monotonic()
            result = function.call(run.inputs, run.seconds, self._team)
        except MemoryError as error:
            self._send(frames.Failed(run.task, "memory", f"memory ran out: {error}"))
        except Exception as error:
            _LOG.exception("a task failed", extra=fields(**about))
            self._send(frames.Failed(run.task, "error", _in_one_line(error)))
        else:
            spent = {"seconds": round(time.monotonic() - began, 3), "size": len(result)}
            _LOG.info("a task is done", extra=fields(**about, **spent, **self._team.counts))
            self._send(frames.TaskFinished(run.task, result, memory_bytes()))
        finally:
            self._team.end()

    def _read(self) -> None:
        """Read messages; end this process when the pipe is closed."""
        try:
            while True:
                if self._connection.poll(_POLL_S):
                    self._take_in(self._connection.recv())
                self._team.expire()
        except (EOFError, OSError):  # the worker has ended, perhaps in the middle of a message
            os._exit(0)
        except BaseException as error:
            sys.excepthook(type(error), error, error.__traceback__)
            os._exit(1)

    def _take_in(self, message: frames.ToProcess) -> None:
        match message:
            case frames.Ask():
                self._team.ask(message)
            case frames.Take():
                self._team.take(message.number, message.result)
            case _:
                self._waiting.put(message)

    def _send(self, message: frames.FromProcess) -> None:
        """Send a message, from any thread; if the pipe is closed, end this process."""
        with self._sending:
            try:
                self._connection.send(message)
            except OSError:
                os._exit(0)


class _LogSender(logging.Handler):
    """Sends log records to the worker, with messages and tracebacks formatted as text."""

    def __init__(self, send: Callable[[frames.FromProcess], None]) -> None:
        super().__init__()
        self._send = send

    def emit(self, record: logging.LogRecord) -> None:
        """Send a record; errors are printed on stderr, as in any handler."""
        try:
            values: Mapping[str, object] = dict(vars(record))
            if record.exc_info:
                values = {**values, "exc_text": logging.Formatter().formatException(record.exc_info)}
            self._send(frames.Logged({**values, "msg": record.getMessage(), "args": None, "exc_info": None}))
        except Exception:
            self.handleError(record)
