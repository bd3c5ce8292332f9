"""The task process of a worker: started when there is a task, kept for later tasks, ended by a signal.

One thread reads the messages of the process from a pipe and posts them to the worker's loop. Another thread writes to
the pipe, so that the loop never waits for a process that does not read.

Loading the modules for a task takes one or two seconds and tens of megabytes. So all workers of one command share a
server (`TaskServer`) that loads the modules once and forks task processes. The server has neither a thread nor a bus,
so forking it is safe; it is itself forked before other modules are loaded. The workers inherit its socket, and the
server ends when all workers have closed it. If the system cannot fork, or if the server is gone, a new interpreter is
started.

A process pool of a library was tried and needs no less code. While a task runs, its process exchanges batches with
helpers through the worker; this needs the pipe and the threads in addition to the pool. The fork server of
multiprocessing belongs to one process, so each worker would load the modules again.
"""

import contextlib
import gc
import importlib
import logging
import os
import queue
import select
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

from atoll_core import task_frames as frames
from atoll_core.errors import AtollError
from atoll_core.machine import use_common_instructions
from atoll_core.task_frames import OTHER_VERSION, version
from atoll_island_worker.processes import Forked, request_parent_death_signal

END_LIMIT_S: Final = 2.0
"""Time limit for the end of a process that was killed, or that has closed its pipe."""

IDLE_S: Final = 120.0
"""After this time without a task a process is ended to free its memory."""

MAX_TASKS: Final = 1000
MAX_MEMORY: Final = 1 << 30
"""After this number of tasks, or above this memory in bytes, a process runs no further task, because of memory
leaks. Another process takes about a second of a processor to start, and its caches are empty. With tasks of 0.2 s, this
is 5 % of the time after 100 tasks, and 0.5 % after 1,000. In a campaign of 954 tables, memory stopped growing."""

_PROGRAM: Final = """
import sys
descriptor, level, version, *sys.path = sys.argv[1:]
from atoll.tasks.process import main
main(int(descriptor), int(level), version)
"""


class StartedProcess(Protocol):
    """A process that was started for tasks. Any thread may call its methods."""

    def set_pid(self, pid: int) -> None:
        """Record the process id, which the process itself sends."""

    def kill(self) -> None:
        """End the process."""

    def wait(self, timeout: float) -> int | None:
        """Wait for the end of the process; return its exit code, negative for a signal, None if unknown or too late."""

    def close(self) -> None:
        """Release the resources of the process."""


class _Interpreter(subprocess.Popen[bytes]):
    def set_pid(self, pid: int) -> None:
        """Do nothing: the process id is known."""

    def wait(self, timeout: float | None = None) -> int | None:  # type: ignore[override]
        """See `StartedProcess.wait`."""
        try:
            return super().wait(timeout)
        except subprocess.TimeoutExpired:
            return None

    def close(self) -> None:
        """Do nothing: `wait` has released the process."""


class Starter(Protocol):
    """Starts task processes."""

    def start(self, connection: "Connection[object, object]") -> StartedProcess:
        """Start a process with one end of a pipe; raises AtollError if the system starts no more processes."""
        ...


class Interpreters(Starter):
    """Starts a new interpreter for each process; loading the modules for a task takes it one or two seconds."""

    def start(self, connection: "Connection[object, object]") -> StartedProcess:
        """See `start_process`."""
        return start_process(connection)


def start_process(connection: "Connection[object, object]") -> StartedProcess:
    """Start a new interpreter; raises AtollError if the system starts no more processes."""
    level = logging.getLogger().getEffectiveLevel()
    descriptor = connection.fileno()
    words = [str(descriptor), str(level), version(), *sys.path]  # so that the same modules are found
    environment = dict(os.environ)
    use_common_instructions(environment)  # both programs have done so; the worker of another engine has not
    try:
        return _Interpreter(
            [sys.executable, "-P", "-c", _PROGRAM, *words],
            stdin=subprocess.DEVNULL,
            pass_fds=(descriptor,),
            start_new_session=True,  # Ctrl-C on the terminal is for the worker
            env=environment,
        )
    except OSError as error:
        raise AtollError(f"no process could be started for it: {error.strerror}") from error


class TaskProcess:
    """The task process of one worker, restarted as needed.

    Methods return at once; messages of the process are posted.
    """

    def __init__(self, starter: Starter | None = None, clock: Callable[[], float] = time.monotonic) -> None:
        """`starter` starts the process; by default a new interpreter."""
        self._starter = starter or Interpreters()
        self._clock = clock
        self._post: Callable[[object], None] = lambda message: None
        self._running: _Running | None = None
        self._life = 0
        self._done = 0
        self._memory = 0
        self._used_at = 0.0

    def attach(self, post: Callable[[object], None]) -> None:
        """Post all messages of the process through `post`, as `ProcessMessage`."""
        self._post = post

    @property
    def is_started(self) -> bool:
        """Whether a process is running already."""
        return self._running is not None and self._running.is_alive

    def send(self, message: frames.ToProcess) -> int:
        """Send a message to the process, which is started for a task or a batch if necessary.

        Return the number of its life, see `ProcessMessage`.

        If the system starts no more processes, `Ended` is posted.
        """
        self._used_at = self._clock()
        if isinstance(message, frames.Run) and (
            self._done >= MAX_TASKS or self._memory >= MAX_MEMORY or self._should_replace
        ):
            self.stop()
        if not self.is_started and isinstance(message, frames.Run | frames.TaskBatch):
            self._start()
        if self._running is not None:
            self._running.send(message)
        return self._life

    def load_next(self, function: str) -> None:
        """Let a running process load the modules for tasks of this function, or one that replaces it."""
        if not self.is_started:
            return
        if self._should_replace:
            self.stop()
            self._start()
        self.send(frames.Load(function))  # also compiles kernels, if they are not compiled yet

    @property
    def _should_replace(self) -> bool:
        """Whether the server now forks processes with more modules than the running one, which has done its task."""
        return self._done > 0 and self._running is not None and not self._running.is_complete

    def stop(self) -> None:
        """Let the process and its task end, without waiting for this; the end is not posted."""
        if self._running is not None:
            self._running.stop()
            self._running = None

    def stop_if_idle(self) -> None:
        """End the process after a long time without work."""
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
            self._post(frames.ProcessMessage(life, frames.Ended("crash", str(error))))

    def _take(self, life: int, message: frames.FromProcess) -> None:
        """Handle a message; called by the reading thread."""
        if isinstance(message, frames.Logged):
            record = logging.makeLogRecord(dict(message.values))
            logging.getLogger(record.name).handle(record)
            return
        if isinstance(message, frames.TaskFinished) and life == self._life:
            self._done, self._memory = self._done + 1, message.memory_bytes
        self._used_at = self._clock()
        self._post(frames.ProcessMessage(life, message))


class _Running:
    """One process, with the thread that reads from it and the thread that writes to it."""

    def __init__(self, starter: Starter, take: Callable[[frames.FromProcess], None]) -> None:
        """Start the process and both threads; raises AtollError if the system cannot start them."""
        self._connection, theirs = Pipe()
        self._outgoing: queue.SimpleQueue[frames.ToProcess | None] = queue.SimpleQueue()
        self._take = take
        self._is_stopped = False
        self.is_complete = True
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

    def send(self, message: frames.ToProcess) -> None:
        self._outgoing.put(message)

    def stop(self) -> None:
        """Let the process end; the reading thread waits for its end, since a busy server reports it seconds later."""
        self._is_stopped = True
        self._process.kill()
        self._shut_down()

    def _shut_down(self) -> None:
        """Close the pipe in both directions, which also ends a process whose id is not known yet."""
        with contextlib.suppress(OSError), socket.socket(fileno=os.dup(self._connection.fileno())) as end:
            end.shutdown(socket.SHUT_RDWR)

    def _write(self) -> None:
        with contextlib.suppress(OSError):  # the process has ended, which the reading thread notices
            while (message := self._outgoing.get()) is not None:
                self._connection.send(message)

    def _read(self) -> None:
        why = self._read_all()
        code = self._process.wait(END_LIMIT_S)  # before the kill below, which would change the code
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
            self._take(frames.Ended(failure, why or sentence))

    def _read_all(self) -> str:
        """Pass on messages until the process ends; return the reason if a message could not be read, else ""."""
        try:
            while True:
                message = self._connection.recv()
                if isinstance(message, frames.Started):
                    self._process.set_pid(message.pid)
                    self.is_complete = message.is_complete
                else:
                    self._take(message)
        except (EOFError, OSError):
            return ""
        except Exception as error:  # also for a truncated message, or if this process is out of memory
            return f"its message could not be read: {type(error).__name__}: {error}"


def cause_of(code: int | None) -> tuple[frames.Failure, str]:
    """Return why a process ended, and a sentence about it."""
    if code is None:
        return "crash", "its process ended"
    if code == OTHER_VERSION:
        return "crash", "its program and the worker have different versions; the worker must be started again"
    if code >= 0:
        return "crash", f"its process ended with exit code {code}"
    name = signal.Signals(-code).name if -code in set(signal.Signals) else "unknown"
    if -code == signal.SIGKILL:
        return "memory", f"its process was ended by signal {-code} ({name}), as happens when memory runs out"
    return "crash", f"its process was ended by signal {-code} ({name})"


_MOST: Final = 256


class TaskServer(Starter):
    """The workers' end of the server; workers inherit it."""

    def __init__(self) -> None:
        """Fork the server; raises AtollError if the system starts no more processes."""
        self._ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        Forked(lambda: _Server(theirs).serve(self._ours))
        theirs.close()

    def start(self, connection: "Connection[object, object]") -> StartedProcess:
        """Let the server fork a process; if the server is gone, start an interpreter."""
        level = logging.getLogger().getEffectiveLevel()
        codes, theirs = Pipe(duplex=False)
        with theirs:
            try:
                socket.send_fds(self._ours, [str(level).encode()], [connection.fileno(), theirs.fileno()])
            except OSError:
                codes.close()
                return start_process(connection)
        return _ForkedTask(codes)

    def close(self) -> None:
        """Close this end; the server ends when all ends are closed."""
        self._ours.close()


class _ForkedTask:
    """A task process that the server has forked: the process sends its id, the server its exit code."""

    def __init__(self, codes: "Connection[object, object]") -> None:
        """The server sends the exit code through `codes`."""
        self._codes = codes
        self._code: int | None = None
        self._pidfd: int | None = None
        self._is_killed = False
        self._closing = threading.Lock()

    def set_pid(self, pid: int) -> None:
        """See `StartedProcess.set_pid`."""
        with contextlib.suppress(OSError, AttributeError):  # the process has ended already, or the system has no pidfd
            self._pidfd = os.pidfd_open(pid)

    def kill(self) -> None:
        """End the process; a process that has not sent its id yet ends when its pipe is closed."""
        with self._closing, contextlib.suppress(OSError):
            if self._pidfd is not None:
                signal.pidfd_send_signal(self._pidfd, signal.SIGKILL)
                self._is_killed = True

    def wait(self, timeout: float) -> int | None:
        """See `StartedProcess.wait`.

        After `kill` it does not wait, because the server may be busy loading for a second.
        """
        if self._is_killed:
            timeout = 0.0
        with contextlib.suppress(OSError, EOFError):
            if self._code is None and self._codes.poll(timeout):
                self._code = int(self._codes.recv_bytes())
        return self._code

    def close(self) -> None:
        """See `StartedProcess.close`."""
        self._codes.close()
        with self._closing:
            if self._pidfd is not None:
                os.close(self._pidfd)
                self._pidfd = None


class _Server:
    """The server itself.

    `_forks` has the process id and the channel for the exit code of each running fork. Its keys are descriptors of
    pipes that become readable when the fork ends.
    """

    def __init__(self, requests: socket.socket) -> None:
        self._requests = requests
        self._is_complete = False
        self._forks: dict[int, tuple[int, Connection[object, object]]] = {}
        self._poll = select.poll()
        self._poll.register(requests, select.POLLIN)

    def serve(self, others_end: socket.socket) -> int:
        """Fork a process for each request until all other ends of the socket are closed; return the exit code."""
        others_end.close()
        request_parent_death_signal()
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)  # otherwise exit codes would be lost
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # otherwise numpy's library starts threads
        with contextlib.suppress(Exception):  # the process that runs a task will report the error
            for _ in importlib.import_module("atoll.tasks.functions").load_ahead():
                gc.freeze()
                if not self._handle_all(0):
                    return 0
        gc.freeze()  # all forks share this memory as long as the garbage collector does not write to it
        self._is_complete = True
        while self._handle_all(None):
            pass
        return 0

    def _handle_all(self, wait_ms: int | None) -> bool:
        """Handle all requests and ends of forks, waiting for one (None: without limit); False: no worker is left."""
        for descriptor, _ in self._poll.poll(wait_ms):
            if descriptor in self._forks:
                self._send_exit_code(descriptor)
            elif not self._handle():
                return False
        return True

    def _handle(self) -> bool:
        """Handle a request; return False if no worker is left."""
        message, descriptors, _, _ = socket.recv_fds(self._requests, _MOST, 2)
        if len(descriptors) == 2:
            self._fork(descriptors[0], descriptors[1], int(message))
        return bool(message)

    def _fork(self, descriptor: int, codes: int, level: int) -> None:
        """Fork a process for the pipe `descriptor`; its exit code will be sent to `codes`."""
        sentinel, held_by_it = os.pipe()
        telling: Connection[object, object] = Connection(codes, readable=False)

        def work() -> int:
            self._requests.close()
            for other, (_, channel) in self._forks.items():
                os.close(other)
                channel.close()
            os.close(sentinel)
            telling.close()
            program = importlib.import_module("atoll.tasks.process")
            program.serve(Connection(descriptor), level, is_complete=self._is_complete)
            return 0

        try:
            pid = Forked(work).pid
        except Exception:  # the system starts no more processes: the worker notices the closed pipe
            os.close(sentinel)
            telling.close()
        else:
            self._forks[sentinel] = (pid, telling)
            self._poll.register(sentinel, select.POLLIN)
        os.close(held_by_it)
        os.close(descriptor)

    def _send_exit_code(self, sentinel: int) -> None:
        pid, telling = self._forks.pop(sentinel)
        self._poll.unregister(sentinel)
        os.close(sentinel)
        _, status = os.waitpid(pid, 0)
        with telling, contextlib.suppress(OSError):  # the worker may have ended before
            telling.send_bytes(str(os.waitstatus_to_exitcode(status)).encode())
