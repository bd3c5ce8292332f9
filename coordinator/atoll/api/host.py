"""The program of a local service: the same processes as in ``coordinator run``, for many jobs of one interpreter.

It prints its address on stdout as one line of JSON, and ends when its stdin is closed or its parent has ended. Its log
is an unnamed temporary file.
"""

import contextlib
import json
import logging
import os
import sys
import tempfile
import threading
from pathlib import Path
from typing import Final

from atoll.client.local_processes import LocalCoordinator, local_processes
from atoll_core.errors import AtollError
from atoll_core.logs import configure
from atoll_core.signals import INTERRUPTED, reap_children

CHECK_S: Final = 0.3
"""Interval of checks of the parent and the workers, in seconds."""


def main(workers: int, parent: int) -> int:
    """Serve with `workers` workers until the process `parent` ends or closes our stdin; return the exit code."""
    reap_children()
    stop = threading.Event()
    threading.Thread(target=_wait_for_end, args=(stop,), name="reading stdin", daemon=True).start()
    try:
        with tempfile.TemporaryFile() as log:
            configure(handler=logging.StreamHandler(os.fdopen(os.dup(log.fileno()), "w", encoding="utf-8")))
            _serve(workers, parent, Path(f"/dev/fd/{log.fileno()}"), stop)
    except KeyboardInterrupt:
        return INTERRUPTED
    except AtollError as error:
        _send({"error": str(error)})
        return error.exit_code
    return 0


def _serve(number: int, parent: int, log: Path, stop: threading.Event) -> None:
    with local_processes(number, log) as (endpoint, workers), LocalCoordinator(endpoint, number) as coordinator:
        coordinator.wait()
        _send({"endpoint": endpoint})
        while not stop.wait(CHECK_S) and os.getppid() == parent:
            coordinator.check()
            workers.check()
        workers.dismiss()


def _wait_for_end(stop: threading.Event) -> None:
    with contextlib.suppress(OSError, ValueError):
        while os.read(0, 1024):  # unbuffered: a buffered reader would hold a lock at exit
            pass
    stop.set()


def _send(what: dict[str, str]) -> None:
    with contextlib.suppress(OSError):
        sys.stdout.write(json.dumps(what) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]), int(sys.argv[2])))
