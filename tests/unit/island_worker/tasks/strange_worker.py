"""A worker in a few lines, for tests that kill it: has one task run, and prints what comes of it.

``python -m tests.unit.island_worker.tasks.strange_worker interpreter|server|loading FUNCTION INPUT...``. With a server,
or one that never ends loading, the worker is forked from this process after the server, as `atoll_island_worker.cli`
does it, and prints its number first.
"""

import importlib
import logging
import os
import queue
import signal
import sys
import time
from collections.abc import Iterator

from atoll_core.task_frames import Ended, Failed, ProcessMessage, Run, TaskFinished
from atoll_island_worker.processes import Forked
from atoll_island_worker.tasks import task_process
from atoll_island_worker.tasks.task_process import TaskServer

FUNCTIONS = "tests.unit.island_worker.tasks.strange_tasks"
KNOWING = task_process._PROGRAM.replace("from atoll", f"import {FUNCTIONS}\nfrom atoll", 1)
"""The program of a task process that knows the strange functions, which take long to import."""


def _load_without_end() -> Iterator[None]:
    while True:
        time.sleep(0.01)
        yield


def work(server: TaskServer | None, function: str, inputs: tuple[bytes, ...]) -> int:
    """Run a task; print what comes of it."""
    said: queue.SimpleQueue[object] = queue.SimpleQueue()
    logging.basicConfig(level=logging.INFO)
    process = task_process.TaskProcess(server)
    process.attach(said.put)
    process.send(Run("t", function, inputs))
    while True:
        item = said.get(timeout=100.0)
        assert isinstance(item, ProcessMessage)
        if isinstance(item.message, TaskFinished | Failed | Ended):
            sys.stdout.write(f"{item.message}\n")
            process.stop()
            return 0


def main(kind: str, function: str, *inputs: str) -> int:
    """Run from the command line."""
    signal.signal(signal.SIGINT, lambda number, frame: None)
    task_process._PROGRAM = KNOWING
    given = tuple(map(os.fsencode, inputs))
    if kind == "interpreter":
        return work(None, function, given)
    importlib.import_module(FUNCTIONS)  # what is forked from here knows them, too
    if kind == "loading":
        importlib.import_module("atoll.tasks.functions").load_ahead = _load_without_end
    server = TaskServer()
    worker = Forked(lambda: work(server, function, given))
    sys.stdout.write(f"{worker.pid}\n")
    sys.stdout.flush()
    _, status = os.waitpid(worker.pid, 0)
    return abs(os.waitstatus_to_exitcode(status))


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
