"""The task process of a worker: started when there is a task, kept for later ones, ended by a signal.

What it says is posted to the worker's loop by a thread that reads the pipe. Another one writes to it, so that a process
that takes nothing in keeps nobody waiting.
"""

import contextlib
import logging
import os
import queue
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
from atoll_core.task_frames import (
    OTHER_VERSION,
    Batch,
    Ended,
    Failure,
    Finished,
    FromProcess,
    Load,
    Logged,
    Run,
    Said,
    Started,
    ToProcess,
    version,
)

END_LIMIT_S: Final = 2.0
"""How long a process that was killed, or that has closed its pipe, may take to be gone."""

IDLE_S: Final = 120.0
"""A process that has had no task for so long is ended, and its memory is given back."""

MAX_TASKS: Final = 100
MAX_MEMORY: Final = 1 << 30
"""A process that has run so many tasks, or occupies so many bytes, runs no further task: its leaks are given back."""

_PROGRAM: Final = """
import sys
descriptor, level, version, *sys.path = sys.argv[1:]
from atoll.tasks.process import main
main(int(descriptor), int(level), version)
"""


class Process(Protocol):
    """A process that was started for tasks. Any thread may call these."""

    def set_pid(self, pid: int) -> None:
        """Take in the number of the process, which it says itself."""

    def kill(self) -> None:
        """End it."""

    def wait(self, timeout: float) -> int | None:
        """Wait for its end; return its exit code, negative for a signal, or None where that cannot be told."""

    def close(self) -> None:
        """Have nothing more to do with it."""


class _Interpreter(subprocess.Popen[bytes]):
    def set_pid(self, pid: int) -> None:
        """Do nothing: it is our child, and its number is known."""

    def wait(self, timeout: float | None = None) -> int | None:  # type: ignore[override]
        """Wait for its end; return its exit code, None when it does not end in time."""
        try:
            return super().wait(timeout)
        except subprocess.TimeoutExpired:
            return None

    def close(self) -> None:
        """Do nothing: it has been waited for."""


class Starter(Protocol):
    """Starts task processes."""

    def start(self, connection: "Connection[object, object]") -> Process:
        """Start a process whose end of a pipe is given; raises AtollError when the system starts no more."""
        ...


class Interpreters(Starter):
    """Starts a new interpreter for each process, which takes a second or two to load what a task needs."""

    def start(self, connection: "Connection[object, object]") -> Process:
        """See `start_process`."""
        return start_process(connection)


def start_process(connection: "Connection[object, object]") -> Process:
    """Start a new interpreter; raises AtollError when the system starts no more processes."""
    level = logging.getLogger().getEffectiveLevel()
    descriptor = connection.fileno()
    words = [str(descriptor), str(level), version(), *sys.path]  # it finds what we found
    try:
        return _Interpreter(
            [sys.executable, "-P", "-c", _PROGRAM, *words],
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
        self._life = 0
        self._done = 0
        self._memory = 0
        self._used_at = 0.0

    def attach(self, post: Callable[[object], None]) -> None:
        """Have what the process says posted, as `Said`."""
        self._post = post

    @property
    def is_started(self) -> bool:
        """Whether a process is there, which need not be started for the next task."""
        return self._running is not None and self._running.is_alive

    def send(self, message: ToProcess) -> int:
        """Send a message to the process, starting one for a task or a batch if need be; return its `Said.life`.

        When the system starts no more processes, `Ended` is posted.
        """
        self._used_at = self._clock()
        if isinstance(message, Run) and (self._done >= MAX_TASKS or self._memory >= MAX_MEMORY):
            self.stop()
        if not self.is_started and isinstance(message, Run | Batch):
            self._start()
        if self._running is not None:
            self._running.send(message)
        return self._life

    def load_next(self, function: str) -> None:
        """Have a process that is there load what tasks of this function need."""
        if self.is_started:
            self.send(Load(function))

    def stop(self) -> None:
        """End the process with what it runs; that it has ended is not posted."""
        if self._running is not None:
            self._running.stop()
            self._running = None

    def stop_if_idle(self) -> None:
        """End the process if it has had nothing to do for long."""
        if self._running is not None and self._clock() - self._used_at > IDLE_S:
            self.stop()

    def _start(self) -> None:
        self._life += 1
        self._done = self._memory = 0
        life = self._life
        try:
            self._running = _Running(self._starter, lambda message: self._take(life, message))
        except AtollError as error:
            self._running = None
            self._post(Said(life, Ended("crash", str(error))))

    def _take(self, life: int, message: FromProcess) -> None:
        """Take in a message, on the reading thread."""
        if isinstance(message, Logged):
            record = logging.makeLogRecord(dict(message.values))
            logging.getLogger(record.name).handle(record)
            return
        if isinstance(message, Finished) and life == self._life:
            self._done, self._memory = self._done + 1, message.memory_bytes
        self._used_at = self._clock()
        self._post(Said(life, message))


class _Running:
    """One process, the thread that reads what it says, and the one that writes to it."""

    def __init__(self, starter: Starter, take: Callable[[FromProcess], None]) -> None:
        """Start them; raises AtollError when the system starts no more."""
        self._connection, theirs = Pipe()
        self._outgoing: queue.SimpleQueue[ToProcess | None] = queue.SimpleQueue()
        self._take = take
        self._is_stopped = False
        try:
            self._process = starter.start(theirs)
        finally:
            theirs.close()
        self._writing = threading.Thread(target=self._write, name="handing on tasks", daemon=True)
        self._reading = threading.Thread(target=self._read, name="reading results of tasks", daemon=True)
        try:
            self._writing.start()
            self._reading.start()
        except RuntimeError as error:
            self._outgoing.put(None)
            self._process.kill()
            self._process.wait(END_LIMIT_S)
            self._process.close()
            raise AtollError(f"no thread could be started for it: {error}") from error

    @property
    def is_alive(self) -> bool:
        return self._reading.is_alive()

    def send(self, message: ToProcess) -> None:
        self._outgoing.put(message)

    def stop(self) -> None:
        self._is_stopped = True
        self._process.kill()
        self._shut_down()
        self._reading.join(2.0 * END_LIMIT_S)

    def _shut_down(self) -> None:
        """Close the pipe to both sides, which also ends a process whose number is not known yet."""
        with contextlib.suppress(OSError), socket.socket(fileno=os.dup(self._connection.fileno())) as end:
            end.shutdown(socket.SHUT_RDWR)

    def _write(self) -> None:
        with contextlib.suppress(OSError):  # it has ended, of which the reading thread tells
            while (message := self._outgoing.get()) is not None:
                self._connection.send(message)

    def _read(self) -> None:
        why = self._read_all()
        code = self._process.wait(END_LIMIT_S)  # first of all: who is killed now was not ended by that
        if code is None:
            self._process.kill()
            code = self._process.wait(END_LIMIT_S)
        self._shut_down()
        self._outgoing.put(None)
        self._writing.join(END_LIMIT_S)
        self._connection.close()
        self._process.close()
        if not self._is_stopped:
            failure, sentence = cause_of(code)
            self._take(Ended(failure, why or sentence))

    def _read_all(self) -> str:
        """Hand on what the process says until its end; return in words why that could not be read, if so."""
        try:
            while True:
                message = self._connection.recv()
                if isinstance(message, Started):
                    self._process.set_pid(message.pid)
                else:
                    self._take(message)
        except (EOFError, OSError):
            return ""
        except Exception as error:  # also words that the end of the process cut short, or memory that ran out here
            return f"what it said could not be read: {type(error).__name__}: {error}"


def cause_of(code: int | None) -> tuple[Failure, str]:
    """Return in words how a process ended by itself."""
    if code is None:
        return "crash", "its process ended"
    if code == OTHER_VERSION:
        return "crash", "its program is of another version than the worker, which must be started again"
    if code >= 0:
        return "crash", f"its process ended with exit code {code}"
    name = signal.Signals(-code).name if -code in set(signal.Signals) else "unknown"
    if -code == signal.SIGKILL:
        return "memory", f"its process was ended by signal {-code} ({name}), as happens when memory runs out"
    return "crash", f"its process was ended by signal {-code} ({name})"
