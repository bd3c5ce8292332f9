"""The program of a task process: runs tasks one after another until the worker that started it closes the pipe.

Light to import. One thread runs tasks; another reads what the worker says, so that the end of the worker, however it
came, ends this process in the middle of a task.
"""

import contextlib
import logging
import os
import queue
import sys
import threading
import time
from collections.abc import Callable, Mapping
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Final

from atoll_core import task_frames as frames
from atoll_core.logs import fields
from atoll_core.machine import collect_rarely, memory_bytes
from atoll_core.signals import ENDING, ignore
from atoll_core.task_frames import OTHER_VERSION, version

_STDIN: Final = 0
_STDOUT: Final = 1
_STDERR: Final = 2
_MORE_LIKELY: Final = "500"
_POLL_S: Final = 0.25
_SHOWN: Final = 12
"""Digits of a task's name in a line of the log."""
_LOG = logging.getLogger(__name__)


def main(descriptor: int, level: int, of: str) -> None:
    """Run tasks until the worker at the other end of the pipe `descriptor`, whose version is `of`, is gone.

    `level` is the least that is logged.
    """
    if of != version():
        sys.exit(OTHER_VERSION)
    serve(Connection(descriptor), level)


def serve(connection: "Connection[frames.FromProcess, frames.ToProcess]", level: int) -> None:
    """Run the tasks that come through a pipe until the worker at its other end is gone."""
    ignore(ENDING)  # the worker's to handle, also where a whole group of processes is told to end
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # matrices are small: threads of numpy's library wait
    if sys.platform == "linux":
        with contextlib.suppress(OSError):  # where memory runs out, this is to go before its worker
            Path("/proc/self/oom_score_adj").write_text(_MORE_LIKELY, "ascii")
    collect_rarely()
    _turn_away_streams()
    TaskLoop(connection, level).work()


def _turn_away_streams() -> None:
    """Have nothing to read on stdin, and what is printed go to stderr: stdout is the worker's."""
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, _STDIN)
    os.close(nothing)
    os.dup2(_STDERR, _STDOUT)


class TaskLoop:
    """Runs the tasks, and computes the batches of others, that come through a pipe."""

    def __init__(self, connection: "Connection[frames.FromProcess, frames.ToProcess]", level: int) -> None:
        from atoll.tasks.team import Team

        self._connection = connection
        self._sending = threading.Lock()
        self._waiting: queue.SimpleQueue[frames.Run | frames.Load | frames.Batch] = queue.SimpleQueue()
        self._team: Final = Team(self._send)
        logging.basicConfig(level=level, handlers=[_LogSender(self._send)], force=True)

    def work(self) -> None:
        """Run what comes, one after the other, for ever: the end of the pipe ends the process."""
        self._send(frames.Started(os.getpid()))
        threading.Thread(target=self._read, name="reading tasks", daemon=True).start()
        while True:
            match self._waiting.get():
                case frames.Run() as run:
                    self._run(run)
                    del run
                case frames.Load() as load:
                    self._load(load)
                case frames.Batch() as batch:
                    from atoll.tasks.team import compute

                    self._send(frames.Computed(batch.number, compute(batch)))
                    del batch

    def _load(self, load: frames.Load) -> None:
        from atoll.tasks.functions import FUNCTIONS

        if self._waiting.empty():
            FUNCTIONS[load.function].load()  # type: ignore[index]  # a name of the table, by the type of the message

    def _run(self, run: frames.Run) -> None:
        from atoll.tasks.functions import FUNCTIONS

        about = {"job": run.job or None, "task": run.task[:_SHOWN], "function": run.function}
        try:
            function = FUNCTIONS[run.function]  # type: ignore[index]
            (function.load if run.seconds is None else function.ready)()
            self._send(frames.Begun(run.task))
            self._team.begin(run.task, run.threads)
            _LOG.info("a task begins", extra=fields(**about, threads=run.threads))
            began = time.monotonic()
            result = function.call(run.inputs, run.seconds, self._team)
        except MemoryError as error:
            self._send(frames.Failed(run.task, "memory", f"memory ran out: {error}"))
        except Exception as error:
            _LOG.exception("a task broke", extra=fields(**about))
            self._send(frames.Failed(run.task, "error", " ".join(f"{type(error).__name__}: {error}".split())[:2000]))
        else:
            spent = {"seconds": round(time.monotonic() - began, 3), "size": len(result)}
            _LOG.info("a task is done", extra=fields(**about, **spent, **self._team.counts))
            self._send(frames.Finished(run.task, result, memory_bytes()))
        finally:
            self._team.end()

    def _read(self) -> None:
        """Hand on what comes; end this process when there can be no more."""
        try:
            while True:
                if self._connection.poll(_POLL_S):
                    self._take_in(self._connection.recv())
                self._team.expire()
        except (EOFError, OSError):  # the worker is gone, perhaps in the middle of a message
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
        """Send a message, from any thread; this process ends when nobody is there to hear it."""
        with self._sending:
            try:
                self._connection.send(message)
            except OSError:
                os._exit(0)


class _LogSender(logging.Handler):
    """Sends log records to the worker, their messages formatted and their tracebacks as text."""

    def __init__(self, send: Callable[[frames.FromProcess], None]) -> None:
        super().__init__()
        self._send = send

    def emit(self, record: logging.LogRecord) -> None:
        """Send a record; one that cannot be sent is told on stderr, as any handler does."""
        try:
            self._send(self._logged(record))
        except Exception:
            self.handleError(record)

    def _logged(self, record: logging.LogRecord) -> frames.Logged:
        values: Mapping[str, object] = dict(vars(record))
        if record.exc_info:
            values = {**values, "exc_text": logging.Formatter().formatException(record.exc_info)}
        return frames.Logged({**values, "msg": record.getMessage(), "args": None, "exc_info": None})
