"""Workers by fork: one process loads libraries and kernels, then forks the workers, which so need not load them.

Neither a bus nor a thread survives a fork. So the process that loads opens no bus and starts no thread before the last
worker is forked, and every worker opens a bus of its own. Only where a fork is safe: not on macOS, nor on Windows.
"""

import contextlib
import ctypes
import gc
import importlib
import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from typing import Final

from atoll_core.errors import AtollError
from atoll_core.signals import ENDING, forget_handlers

_STOP_LIMIT_S: Final = 5.0
_WATCH_INTERVAL_S: Final = 1.0
_PR_SET_PDEATHSIG: Final = 1


def end_with_parent(parent: int) -> None:
    """End this process, by a SIGTERM to itself, as soon as `parent` is no longer its parent; if need be, forcibly."""
    request_parent_death_signal()
    threading.Thread(target=_watch, args=(parent,), name="watching the parent", daemon=True).start()


def request_parent_death_signal() -> None:
    """Have the system send this process a SIGTERM when its parent dies, at once; on Linux only, and not for sure."""
    if sys.platform == "linux":
        ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def _watch(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_WATCH_INTERVAL_S)
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(_STOP_LIMIT_S)
    os._exit(1)


Work = Callable[[], int]
"""What a forked worker does; returns its exit code."""

_STDIN: Final = 0


def can_fork() -> bool:
    """Say whether workers may be forked on this system."""
    return sys.platform == "linux"


def load_ahead() -> None:
    """Load libraries, and kernels if they have been compiled; errors are ignored: every worker reports them.

    Compiling is left to the workers, which tell the coordinator that they are compiling.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # else numpy's library starts threads, though we never use it
    with contextlib.suppress(Exception):
        importlib.import_module("atoll_core.wire.bus.zenoh_bus")
        importlib.import_module("atoll_island_worker.worker")
        from atoll_core.compilation.cache import is_compiled
        from atoll_island_worker.compute.warmup import run_small_epochs

        if is_compiled("atoll_island_worker"):
            run_small_epochs()
    gc.freeze()  # what is loaded is shared by all workers, as long as the search for garbage does not write to it


class Forked:
    """A worker forked from this process, with as much of `subprocess.Popen` as is needed to end it."""

    def __init__(self, work: Work) -> None:
        """Fork; the child does `work` in a session of its own and ends with the code that it returns."""
        self._code: int | None = None
        self.pid: int = _fork(work)

    def poll(self) -> int | None:
        """Return the exit code, negative for a signal; None while it lives."""
        if self._code is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            self._code = os.waitstatus_to_exitcode(status) if pid else None
        return self._code

    def terminate(self) -> None:
        """Tell it to end."""
        self._send(signal.SIGTERM)

    def kill(self) -> None:
        """End it."""
        self._send(signal.SIGKILL)

    def _send(self, number: int) -> None:
        if self._code is None:  # else the number may be another process's
            os.kill(self.pid, number)


def _fork(work: Work) -> int:
    """Fork a child that does `work` and never returns; return its process id."""
    sys.stdout.flush()
    sys.stderr.flush()
    with _signals_held_back():
        try:
            pid = os.fork()
        except OSError as error:
            raise AtollError(f"the system starts no more processes ({error.strerror}); ask for fewer") from error
        if pid == 0:
            forget_handlers()
    if pid == 0:
        _live(work)
    return pid


def _live(work: Work) -> None:
    code = 1
    try:
        os.setsid()  # a Ctrl-C on the terminal is the parent's to handle
        nothing = os.open(os.devnull, os.O_RDONLY)
        os.dup2(nothing, _STDIN)
        os.close(nothing)
        code = work()
        sys.stdout.flush()
        sys.stderr.flush()
    except BaseException:  # nothing may pass: what follows in this process is the parent's business
        traceback.print_exc()
    finally:
        os._exit(code)


@contextlib.contextmanager
def _signals_held_back() -> Iterator[None]:
    """Have no signal arrive inside, so that a child never takes one for its parent."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
