"""The task process of a worker: started when there is a task, kept for later ones, ended by a signal.

What it says is posted to the worker's loop by a thread that reads the pipe.
"""

import contextlib
import logging
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Final, Protocol

from atoll_core.errors import AtollError
from atoll_core.tasks.frames import Ended, Failure, Finished, FromProcess, Load, Logged, Run, Started, ToProcess

END_LIMIT_S: Final = 2.0
"""How long a process that was killed may take to be gone."""

IDLE_S: Final = 120.0
"""A process that has had no task for so long is ended, and its memory is given back."""

MAX_TASKS: Final = 100
MAX_MEMORY: Final = 1 << 30
"""A process that has run so many tasks, or occupies so many bytes, runs no further task: its leaks are given back."""

_PROGRAM: Final = """
import sys
descriptor, level, *sys.path = sys.argv[1:]
from atoll_coordinator.tasks.process import main
main(int(descriptor), int(level))
"""
_LOG = logging.getLogger(__name__)


class Process(Protocol):
    """A process that was started for tasks."""

    def set_pid(self, pid: int) -> None:
        """Take in the number of the process, which it says itself."""

    def kill(self) -> None:
        """End it."""

    def wait(self, timeout: float) -> int | None:
        """Wait for its end; return its exit code, negative for a signal, or None where that cannot be told."""


class _Interpreter(subprocess.Popen[bytes]):
    def set_pid(self, pid: int) -> None:
        """Do nothing: it is our child, and its number is known."""

    def wait(self, timeout: float | None = None) -> int | None:  # type: ignore[override]
        """Wait for its end; return its exit code, None when it does not end in time."""
        try:
            return super().wait(timeout)
        except subprocess.TimeoutExpired:
            return None


class Starter(Protocol):
    """Starts task processes."""

    def start(self, connection: "Connection[object, object]") -> Process:
        """Start a process whose end of a pipe is given; raises AtollError when the system starts no more."""
        ...

    def load(self, function: str) -> bool:
        """Have processes that are started later loaded for tasks of this function; False: that cannot be."""
        ...


class Interpreters(Starter):
    """Starts a new interpreter for each process, which takes a second or two to load what a task needs."""

    def start(self, connection: "Connection[object, object]") -> Process:
        """See `start_process`."""
        return start_process(connection)

    def load(self, function: str) -> bool:
        """Return False: each loads for itself."""
        return False


def start_process(connection: "Connection[object, object]") -> Process:
    """Start a new interpreter; raises AtollError when the system starts no more processes."""
    level = logging.getLogger().getEffectiveLevel()
    descriptor = connection.fileno()
    command = [sys.executable, "-P", "-c", _PROGRAM, str(descriptor), str(level), *sys.path]  # it finds what we found
    try:
        return _Interpreter(
            command,
            stdin=subprocess.DEVNULL,
            pass_fds=(descriptor,),
            start_new_session=True,  # a Ctrl-C on the terminal is the worker's to handle
            env={"OPENBLAS_NUM_THREADS": "1", **os.environ},  # matrices are small: threads of numpy's library wait
        )
    except OSError as error:
        raise AtollError(f"no process could be started for it: {error.strerror}") from error


class TaskProcess:
    """The process of one worker, as often as it is started. Methods return at once; its messages are posted."""

    def __init__(self, starter: Starter | None = None, clock: Callable[[], float] = time.monotonic) -> None:
        """`starter` starts the process; a new interpreter unless given."""
        self._starter = starter or Interpreters()
        self._clock = clock
        self._post: Callable[[object], None] = lambda message: None
        self._running: _Running | None = None
        self._done = 0
        self._memory = 0
        self._used_at = 0.0

    def attach(self, post: Callable[[object], None]) -> None:
        """Have what the process says posted."""
        self._post = post

    @property
    def is_started(self) -> bool:
        """Whether a process is there, which need not be started for the next task."""
        return self._running is not None and self._running.is_alive

    def send(self, message: ToProcess) -> None:
        """Send a message to the process, starting one for a task or a batch if need be.

        When the system starts no more processes, `Ended` is posted.
        """
        self._used_at = self._clock()
        if isinstance(message, Run) and (self._done >= MAX_TASKS or self._memory >= MAX_MEMORY):
            self.stop()
        if not self.is_started:
            self._done = self._memory = 0
            try:
                self._running = _Running(self._starter, self._take)
            except AtollError as error:
                self._post(Ended("crash", str(error)))
                return
        assert self._running is not None
        self._running.send(message)

    def load_next(self, function: str) -> None:
        """Have the next task of this function find loaded what it needs."""
        if self._starter.load(function):
            self.stop()  # the next one is forked with it
        elif self.is_started:
            self.send(Load(function))

    def stop(self) -> None:
        """End the process with what it runs; nothing more of it is posted."""
        if self._running is not None:
            self._running.stop()
            self._running = None

    def stop_if_idle(self) -> None:
        """End the process if it has had nothing to do for long."""
        if self._running is not None and self._clock() - self._used_at > IDLE_S:
            self.stop()

    def _take(self, running: "_Running", message: FromProcess) -> None:
        """Take in a message, on the reading thread; what comes of a process that was stopped is void."""
        if running is not self._running:
            return
        if isinstance(message, Logged):
            record = logging.makeLogRecord(dict(message.values))
            logging.getLogger(record.name).handle(record)
            return
        if isinstance(message, Finished):
            self._done, self._memory = self._done + 1, message.memory_bytes
        self._used_at = self._clock()
        self._post(message)


class _Running:
    """One process and the thread that reads what it says."""

    def __init__(self, starter: Starter, take: "Callable[[_Running, FromProcess], None]") -> None:
        self._connection, theirs = Pipe()
        try:
            self._process = starter.start(theirs)
        finally:
            theirs.close()
        self._take = take
        self._thread = threading.Thread(target=self._read, name="reading results of tasks", daemon=True)
        self._thread.start()

    @property
    def is_alive(self) -> bool:
        return self._thread.is_alive()

    def send(self, message: ToProcess) -> None:
        with contextlib.suppress(OSError, ValueError):  # it has ended, of which the reading thread tells
            self._connection.send(message)

    def stop(self) -> None:
        self._process.kill()
        with contextlib.suppress(OSError), socket.socket(fileno=os.dup(self._connection.fileno())) as end:
            end.shutdown(socket.SHUT_RDWR)  # also ends a process whose number is not known yet
        self._thread.join(END_LIMIT_S)

    def _read(self) -> None:
        why = ""
        try:
            while True:
                message = self._connection.recv()
                if isinstance(message, Started):
                    self._process.set_pid(message.pid)
                else:
                    self._take(self, message)
        except (EOFError, OSError):
            pass
        except Exception as error:  # also words that the end of the process cut short, or memory that ran out here
            why = f"what it said could not be read: {type(error).__name__}: {error}"
        self._process.kill()
        code = self._process.wait(END_LIMIT_S)
        self._connection.close()
        failure, sentence = cause_of(code)
        self._take(self, Ended(failure, why or sentence))


def cause_of(code: int | None) -> tuple[Failure, str]:
    """Return in words how a process ended by itself."""
    if code is None:
        return "crash", "its process ended"
    if code >= 0:
        return "crash", f"its process ended with exit code {code}"
    name = signal.Signals(-code).name if -code in set(signal.Signals) else "unknown"
    if -code == signal.SIGKILL:
        return "memory", f"its process was ended by signal {-code} ({name}), as happens when memory runs out"
    return "crash", f"its process was ended by signal {-code} ({name})"
