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
import signal
import socket
from multiprocessing.connection import Connection
from typing import Final

from atoll_island_worker.processes.fork_server import Forked
from atoll_island_worker.processes.parent import request_parent_death_signal
from atoll_island_worker.tasks.task_process import Process, Starter, start_process

_FORK: Final = b"fork"
_LOAD: Final = b"load "
_MOST: Final = 256


class TaskServer(Starter):
    """The server as the workers see it, which inherit it."""

    def __init__(self) -> None:
        """Fork the server; raises AtollError when the system starts no more processes."""
        self._ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        Forked(lambda: _serve(theirs, self._ours))
        theirs.close()

    def start(self, connection: "Connection[object, object]") -> Process:
        """Have a process forked; where the server is gone, start an interpreter."""
        try:
            socket.send_fds(self._ours, [_FORK], [connection.fileno()])
        except OSError:
            return start_process(connection)
        return _ForkedTask()

    def load(self, function: str) -> bool:
        """Have the server load what tasks of this function need, so that later forks have it."""
        try:
            self._ours.send(_LOAD + function.encode())
        except OSError:
            return False
        return True


class _ForkedTask:
    """A task process that the server has forked; it says itself which number it has."""

    def __init__(self) -> None:
        self._pidfd: int | None = None

    def set_pid(self, pid: int) -> None:
        """Take in the number of the process."""
        with contextlib.suppress(OSError, AttributeError):  # it has ended already
            self._pidfd = os.pidfd_open(pid)

    def kill(self) -> None:
        """End it; one that has not said its number yet ends when its pipe is closed."""
        if self._pidfd is not None:
            with contextlib.suppress(OSError):
                signal.pidfd_send_signal(self._pidfd, signal.SIGKILL)
            os.close(self._pidfd)
            self._pidfd = None

    def wait(self, timeout: float) -> int | None:
        """Return None: it is the server's child, and nobody learns how it ended."""
        return None


def _serve(requests: socket.socket, others_end: socket.socket) -> int:
    """Fork a process for each request until no end of the socket is open any more; return the exit code."""
    others_end.close()
    request_parent_death_signal()
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # nobody waits for them
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # else numpy's library starts threads
    _load("prepare")
    while True:
        message, descriptors, _, _ = socket.recv_fds(requests, _MOST, 1)
        if not message:
            return 0
        if message.startswith(_LOAD):
            _load(message.removeprefix(_LOAD).decode())
        for descriptor in descriptors:
            _fork(requests, descriptor)


def _load(function: str) -> None:
    with contextlib.suppress(Exception):  # whoever runs the task meets it, and says it
        importlib.import_module("atoll_coordinator.tasks.functions").FUNCTIONS[function].load()
    gc.freeze()  # what is loaded is shared by all processes, as long as the search for garbage does not write to it


def _fork(requests: socket.socket, descriptor: int) -> None:
    level = logging.getLogger().getEffectiveLevel()

    def work() -> int:
        requests.close()
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        importlib.import_module("atoll_coordinator.tasks.process").main(descriptor, level)
        return 0

    with contextlib.suppress(Exception):  # the system starts no more processes: the end of the pipe tells the worker
        Forked(work)
    os.close(descriptor)
