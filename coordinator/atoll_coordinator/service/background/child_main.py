"""What a child process of the coordinator does: errands, one after another, until the coordinator closes its pipe.

Errands come as pickles on stdin, and what comes of them goes back on stdout, both of which belong to the two alone. A
thread of its own reads, so that the end of the coordinator, however it came, is the end of the child in the middle of
its work.
"""

import contextlib
import logging
import os
import pickle
import queue
import signal
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO, Final

from atoll.machine.garbage import collect_rarely
from atoll.machine.usage import memory_bytes
from atoll_coordinator.service.background.child_process import OTHER_VERSION, version

Errand = tuple[bool, Callable[[], Any]]
"""Whether an answer is awaited, and what is to be called."""

_ENDING: Final = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
_STDIN: Final = 0
_STDOUT: Final = 1
_STDERR: Final = 2
_MORE_LIKELY: Final = "500"


def load_preparing() -> None:
    """Load what preparing needs; its kernels are loaded as they are needed."""
    import atoll.data.table  # noqa: F401
    import atoll_coordinator.data.prepare  # noqa: F401


def main(level: int, of: str) -> None:
    """Do errands until the coordinator, whose version is `of`, is gone. `level` is the least that is logged."""
    if of != version():
        sys.exit(OTHER_VERSION)
    for number in _ENDING:  # the coordinator's to handle, also where a whole group of processes is told to end
        signal.signal(number, signal.SIG_IGN)
    if sys.platform == "linux":
        with contextlib.suppress(OSError):  # where memory runs out, this is to go before the coordinator
            Path("/proc/self/oom_score_adj").write_text(_MORE_LIKELY, "ascii")
    collect_rarely()
    errands, answers = _pipes()
    said = _Said(answers)
    logging.basicConfig(level=level, handlers=[said], force=True)
    waiting: queue.SimpleQueue[Errand] = queue.SimpleQueue()
    threading.Thread(target=_read, args=(errands, waiting), name="reading errands", daemon=True).start()
    while True:
        is_awaited, errand = waiting.get()
        outcome = errand()
        if is_awaited:
            said.say("answer", (outcome, memory_bytes()))
        else:
            said.say("done", None)
        del outcome, errand  # neither is to be kept while there is nothing to do


def _pipes() -> tuple[BinaryIO, BinaryIO]:
    """Return the two pipes; what is printed from now on goes to stderr, and stdin is empty."""
    pipes = os.fdopen(os.dup(_STDIN), "rb"), os.fdopen(os.dup(_STDOUT), "wb")
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, _STDIN)
    os.close(nothing)
    os.dup2(_STDERR, _STDOUT)
    return pipes


def _read(errands: BinaryIO, waiting: "queue.SimpleQueue[Errand]") -> None:
    """Hand on errands; end this process when there can be no more."""
    try:
        while True:
            waiting.put(pickle.load(errands))
    except (EOFError, pickle.UnpicklingError, OSError):  # the coordinator is gone, perhaps in the middle of a word
        os._exit(0)
    except BaseException:
        sys.excepthook(*sys.exc_info())
        os._exit(1)


class _Said(logging.Handler):
    """What goes back to the coordinator: answers, and the records of the log. Any thread may speak."""

    def __init__(self, pipe: BinaryIO) -> None:
        super().__init__()
        self._pipe = pipe

    def say(self, kind: str, what: object) -> None:
        """Send one thing; this process ends when nobody is there to hear it."""
        with self.lock:  # type: ignore[union-attr]  # made by the base class, which logging itself relies on
            try:
                pickle.dump((kind, what), self._pipe, pickle.HIGHEST_PROTOCOL)
                self._pipe.flush()
            except BrokenPipeError:
                os._exit(0)

    def emit(self, record: logging.LogRecord) -> None:
        """Send a record, its words put together and its traceback as text."""
        values = dict(vars(record))
        if record.exc_info:
            values["exc_text"] = logging.Formatter().formatException(record.exc_info)
        values |= {"msg": record.getMessage(), "args": None, "exc_info": None}
        self.say("log", values)
