"""Functions for tests of task processes, which know them once this is imported: they die, hang, print and log."""

import logging
import os
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from atoll.tasks.functions import FUNCTIONS, TaskHandler
from atoll.tasks.process import Team
from atoll_coordinator.model.batches import FUNCTIONS as BATCHES
from atoll_core.logs import fields

_loaded = b""


def pid() -> bytes:
    return b"%d" % os.getpid()


def echo(what: bytes) -> bytes:
    """Return what came; print, and read, what is nobody's business."""
    print("printed by a task")  # noqa: T201
    os.write(1, b"written by a task\n")
    assert sys.stdin.read() == ""
    return what


def die(number: bytes) -> bytes:
    os.kill(os.getpid(), int(number))
    time.sleep(60.0)
    raise AssertionError


def leave(code: bytes) -> bytes:
    """End the process without a word."""
    os._exit(int(code))


def leave_in_order(code: bytes) -> bytes:
    sys.exit(int(code))


def sleep(mark: bytes, until: bytes = b"") -> bytes:
    """Leave the number of the process in a file, then wait for another file, or for ever."""
    _leave_mark(mark)
    while not (until and Path(os.fsdecode(until)).exists()):
        time.sleep(0.01)
    return b"slept"


def spin(mark: bytes) -> bytes:
    """Leave the number of the process in a file, then compute for ever."""
    _leave_mark(mark)
    while True:
        pass


def _leave_mark(mark: bytes) -> None:
    path = Path(os.fsdecode(mark))
    path.with_suffix(".part").write_text(str(os.getpid()), "ascii")
    path.with_suffix(".part").rename(path)


def log() -> bytes:
    logger = logging.getLogger("of.a.task")
    logger.debug("not to be heard")
    logger.warning("heard %d", 1, extra=fields(job="j"))
    logger.warning("not to be sent", extra={"what": lambda: None})
    try:
        raise ValueError("a reason")
    except ValueError:
        logger.exception("broken")
    return b""


def fail() -> bytes:
    raise RuntimeError("planted\nin two lines")


def starve() -> bytes:
    raise MemoryError("no room for a table")


def made_slowly(context: bytes, item: bytes) -> bytes:
    """Compute a batch, and say where."""
    time.sleep(0.02)
    return context + item + b" by %d," % os.getpid()


def shared(inputs: Sequence[bytes], seconds: float | None, team: Team) -> bytes:
    """Have batches computed by whoever takes them, as soon as there are two who ask."""
    end = time.monotonic() + 60.0
    while not team.workers and time.monotonic() < end:
        time.sleep(0.01)
    return b"".join(team.map("strange: made slowly", inputs[0], [b"%d" % number for number in range(60)]))


BATCHES["strange: made slowly"] = made_slowly


def loaded() -> bytes:
    """Return what was loaded before."""
    return _loaded


def _load() -> None:
    global _loaded
    _loaded = b"loaded"
    logging.getLogger("of.a.task").warning("it is loaded")


def _function(function: Callable[..., bytes], load: Callable[[], None] = lambda: None) -> TaskHandler:
    def call(inputs: Sequence[bytes], seconds: float | None, team: object) -> bytes:
        return function(*inputs)

    return TaskHandler(load, lambda: None, call)


for _made in (pid, echo, die, leave, leave_in_order, sleep, spin, log, fail, starve):
    FUNCTIONS[_made.__name__] = _function(_made)  # type: ignore[index]
FUNCTIONS["shared"] = TaskHandler(lambda: None, lambda: None, shared)  # type: ignore[index]
FUNCTIONS["loaded"] = _function(loaded)  # type: ignore[index]
FUNCTIONS["to load"] = _function(loaded, _load)  # type: ignore[index]
