"""The program of a child process: runs tasks one after another until the coordinator closes its pipe. Light to import.

Tasks come as pickles on stdin and outcomes go back on stdout; nothing else uses the two pipes. A thread reads, so that
the end of the coordinator, however it came, ends the child in the middle of a task.
"""

import contextlib
import logging
import os
import pickle
import queue
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO, Final

from atoll_coordinator.service.background.child_process import OTHER_VERSION, version
from atoll_core.machine.usage import collect_rarely, memory_bytes
from atoll_core.signals import ENDING, ignore

Task = tuple[bool, Callable[[], object]]
"""Whether an answer is awaited, and what is to be called."""

_STDIN: Final = 0
_STDOUT: Final = 1
_STDERR: Final = 2
_MORE_LIKELY: Final = "500"
_LOG = logging.getLogger(__name__)


def load_preparation() -> None:
    """Load what preparing needs; its kernels are loaded as they are needed."""
    import atoll_coordinator.data.prepare  # noqa: F401
    import atoll_core.data.table  # noqa: F401


def ready_preparation() -> None:
    """Load what preparing needs, compiling its kernels if need be; an error is logged, since preparing meets it too."""
    try:
        load_preparation()
        import atoll_coordinator.model.sparse.rates.screening  # noqa: F401
        from atoll_coordinator.data.differentiation.warmup import warm_up as warm_up_data
        from atoll_coordinator.model.sparse.warmup import warm_up as warm_up_sparse

        warm_up_data()
        warm_up_sparse()
    except Exception:
        _LOG.exception("warm-up failed")


def load_refinement() -> None:
    """Load what refining needs, compiling its kernels if need be; an error is logged, since refining meets it too."""
    try:
        import scipy.special  # noqa: F401

        import atoll_coordinator.model.pipeline  # noqa: F401
        from atoll_coordinator.warmup import warm_up

        warm_up(_LOG.debug)
    except Exception:
        _LOG.exception("warm-up failed")


def main(level: int, of: str) -> None:
    """Run tasks until the coordinator, whose version is `of`, is gone. `level` is the least that is logged."""
    if of != version():
        sys.exit(OTHER_VERSION)
    ignore(ENDING)  # the coordinator's to handle, also where a whole group of processes is told to end
    if sys.platform == "linux":
        with contextlib.suppress(OSError):  # where memory runs out, this is to go before the coordinator
            Path("/proc/self/oom_score_adj").write_text(_MORE_LIKELY, "ascii")
    collect_rarely()
    requests, answers = _pipes()
    sender = _Sender(answers)
    logging.basicConfig(level=level, handlers=[sender], force=True)
    waiting: queue.SimpleQueue[Task] = queue.SimpleQueue()
    threading.Thread(target=_read, args=(requests, waiting), name="reading tasks", daemon=True).start()
    while True:
        is_awaited, function = waiting.get()
        outcome = function()
        if is_awaited:
            sender.send("answer", (outcome, memory_bytes()))
        else:
            sender.send("done", None)
        del outcome, function  # neither is to be kept while there is nothing to do


def _pipes() -> tuple[BinaryIO, BinaryIO]:
    """Return the two pipes; what is printed from now on goes to stderr, and stdin is empty."""
    pipes = os.fdopen(os.dup(_STDIN), "rb"), os.fdopen(os.dup(_STDOUT), "wb")
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, _STDIN)
    os.close(nothing)
    os.dup2(_STDERR, _STDOUT)
    return pipes


def _read(requests: BinaryIO, waiting: "queue.SimpleQueue[Task]") -> None:
    """Hand on tasks; end this process when there can be no more."""
    try:
        while True:
            waiting.put(pickle.load(requests))
    except (EOFError, pickle.UnpicklingError, OSError):  # the coordinator is gone, perhaps in the middle of a message
        os._exit(0)
    except BaseException as error:
        sys.excepthook(type(error), error, error.__traceback__)
        os._exit(1)


class _Sender(logging.Handler):
    """Sends answers and log records to the coordinator. Its methods may be called from any thread."""

    def __init__(self, pipe: BinaryIO) -> None:
        super().__init__()
        self._pipe = pipe

    def send(self, kind: str, content: object) -> None:
        """Send one thing; this process ends when nobody is there to hear it."""
        with self.lock:  # type: ignore[union-attr]  # made by the base class, which logging itself relies on
            try:
                pickle.dump((kind, content), self._pipe, pickle.HIGHEST_PROTOCOL)
                self._pipe.flush()
            except BrokenPipeError:
                os._exit(0)

    def emit(self, record: logging.LogRecord) -> None:
        """Send a record, its message formatted and its traceback as text."""
        values = dict(vars(record))
        if record.exc_info:
            values["exc_text"] = logging.Formatter().formatException(record.exc_info)
        values |= {"msg": record.getMessage(), "args": None, "exc_info": None}
        self.send("log", values)
