"""Tasks for tests of child processes, which find them by name: they die, hang, print and log."""

import logging
import os
import signal
import time
from pathlib import Path
from typing import Any

from atoll_core.logs import fields


def pid() -> int:
    return os.getpid()


def echo(what: Any) -> Any:
    os.write(1, b"what is printed does not mix with what is answered\n")
    return what


def die(folder: Path, times: int) -> int:
    """Be killed the first `times` times; then return how often it was tried."""
    tries = len(list(folder.iterdir())) + 1
    (folder / str(tries)).touch()
    if tries <= times:
        os.kill(os.getpid(), signal.SIGKILL)
    return tries


def sleep(mark: Path, until: Path | None = None) -> None:
    """Leave the number of the process in a file, then wait for another file, or for ever."""
    mark.with_suffix(".part").write_text(str(os.getpid()), "ascii")
    mark.with_suffix(".part").rename(mark)
    while until is None or not until.exists():
        time.sleep(0.01)


def spin(mark: Path) -> None:
    """Leave the number of the process in a file, then compute for ever."""
    mark.with_suffix(".part").write_text(str(os.getpid()), "ascii")
    mark.with_suffix(".part").rename(mark)
    while True:
        pass


def log() -> None:
    logger = logging.getLogger("of.a.child")
    logger.debug("not to be heard")
    logger.warning("heard %d", 1, extra=fields(job="j"))
    try:
        raise ValueError("a reason")
    except ValueError:
        logger.exception("broken")


def fail() -> None:
    raise RuntimeError("an error that no task should let through")


def refine_or_die(folder: Path, times: int, *_: Any) -> Any:
    from atoll_coordinator.model.refinement import Refinement

    return Refinement(warnings=(f"try {die(folder, times)}",))


def prepare_and_die(table: bytes, config: Any) -> Any:
    os.kill(os.getpid(), signal.SIGSEGV)
