"""A process that has loaded what tasks need, and forks task processes for the workers of one command.

Loading takes a second and tens of megabytes, once for all workers in place of once for each. It has no thread and no
bus, so that its forks are safe, and is forked itself before anything else is loaded. The socket to it is inherited by
the workers; when all ends of it are closed, it ends.
"""

import contextlib
import gc
import importlib
import logging
import os
import select
import signal
import socket
import threading
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Final

from atoll_core.task_frames import version
from atoll_island_worker.processes.fork_server import Forked
from atoll_island_worker.processes.parent import request_parent_death_signal
from atoll_island_worker.tasks.task_process import Process, Starter, start_process

IDLE_S: Final = 2.0
"""After so long without a request, once there was one, what refining needs is loaded as well: whoever refines first
has loaded it by then, and those that help later find it loaded."""

_MOST: Final = 256


class TaskServer(Starter):
    """The server as the workers see it, which inherit it."""

    def __init__(self) -> None:
        """Fork the server; raises AtollError when the system starts no more processes."""
        self._ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        Forked(lambda: _Server(theirs).serve(self._ours))
        theirs.close()

    def start(self, connection: "Connection[object, object]") -> Process:
        """Have a process forked; where the server is gone, start an interpreter."""
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
        """Close this process's end; the server ends when nobody has one any more."""
        self._ours.close()


class _ForkedTask:
    """A task process that the server has forked: it says itself which number it has, the server how it ended."""

    def __init__(self, codes: "Connection[object, object]") -> None:
        """`codes` is where the server sends its exit code."""
        self._codes = codes
        self._code: int | None = None
        self._pidfd: int | None = None
        self._is_killed = False
        self._closing = threading.Lock()

    def set_pid(self, pid: int) -> None:
        """Take in the number of the process."""
        with contextlib.suppress(OSError, AttributeError):  # it has ended already, or the system has no such thing
            self._pidfd = os.pidfd_open(pid)

    def kill(self) -> None:
        """End it; one that has not said its number yet ends when its pipe is closed."""
        with self._closing, contextlib.suppress(OSError):
            if self._pidfd is not None:
                signal.pidfd_send_signal(self._pidfd, signal.SIGKILL)
                self._is_killed = True

    def wait(self, timeout: float) -> int | None:
        """Return its exit code once it has ended, None where the server does not say it in time.

        Of one that was killed here it is not waited for: the server may be loading, for more than a second.
        """
        if self._is_killed:
            timeout = 0.0
        with contextlib.suppress(OSError, EOFError):
            if self._code is None and self._codes.poll(timeout):
                self._code = int(self._codes.recv_bytes())
        return self._code

    def close(self) -> None:
        """Close what tells of it."""
        self._codes.close()
        with self._closing:
            if self._pidfd is not None:
                os.close(self._pidfd)
                self._pidfd = None


class _Server:
    """The server itself. `forks` has of each living fork its number and where its exit code goes, by a pipe that is
    readable when it has ended."""

    def __init__(self, requests: socket.socket) -> None:
        self._requests = requests
        self._forks: dict[int, tuple[int, Connection[object, object]]] = {}
        self._is_loaded = self._was_asked = False
        self._poll = select.poll()
        self._poll.register(requests, select.POLLIN)

    def serve(self, others_end: socket.socket) -> int:
        """Fork a process for each request until no end of the socket is open any more; return the exit code."""
        others_end.close()
        request_parent_death_signal()
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)  # else the system would not tell how they end
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # else numpy's library starts threads
        _load("prepare")
        while True:
            events = self._poll.poll(None if self._is_loaded or not self._was_asked else 1000.0 * IDLE_S)
            if not events:
                _load("refine")
                self._is_loaded = True
            for descriptor, _ in events:
                if descriptor in self._forks:
                    self._see_off(descriptor)
                elif not self._handle():
                    return 0

    def _handle(self) -> bool:
        """Do what a worker asks; return False when there is none any more."""
        message, descriptors, _, _ = socket.recv_fds(self._requests, _MOST, 2)
        if len(descriptors) == 2:
            self._was_asked = True
            self._fork(descriptors[0], descriptors[1], int(message))
        return bool(message)

    def _fork(self, descriptor: int, codes: int, level: int) -> None:
        """Fork a process for the pipe `descriptor`; how it ends will be said at `codes`."""
        sentinel, held_by_it = os.pipe()
        telling: Connection[object, object] = Connection(codes, readable=False)

        def work() -> int:
            self._forget_forks()
            os.close(sentinel)
            telling.close()
            importlib.import_module("atoll.tasks.process").main(descriptor, level, version())
            return 0

        try:
            pid = Forked(work).pid
        except Exception:  # the system starts no more processes: the end of the pipe tells the worker
            os.close(sentinel)
            telling.close()
        else:
            self._forks[sentinel] = (pid, telling)
            self._poll.register(sentinel, select.POLLIN)
        os.close(held_by_it)
        os.close(descriptor)

    def _forget_forks(self) -> None:
        """Close, in a fork, what is the server's."""
        self._requests.close()
        for sentinel, (_, telling) in self._forks.items():
            os.close(sentinel)
            telling.close()

    def _see_off(self, sentinel: int) -> None:
        """Tell the worker how its process ended."""
        pid, telling = self._forks.pop(sentinel)
        self._poll.unregister(sentinel)
        os.close(sentinel)
        _, status = os.waitpid(pid, 0)
        with telling, contextlib.suppress(OSError):  # the worker may have ended before
            telling.send_bytes(str(os.waitstatus_to_exitcode(status)).encode())


def _load(function: str) -> None:
    with contextlib.suppress(Exception):  # whoever runs the task meets it, and says it
        importlib.import_module("atoll.tasks.functions").FUNCTIONS[function].load()
    gc.freeze()  # what is loaded is shared by all processes, as long as the search for garbage does not write to it
