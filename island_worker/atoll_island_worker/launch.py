"""What the program does once its command line is understood: one worker in this process, or several that it watches."""

import argparse
import contextlib
import os
import sys
import time
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

from atoll_core.main_program import exit_code_of
from atoll_core.signals import draining, exiting
from atoll_island_worker.processes.exit_reasons import ExitReasons

if TYPE_CHECKING:
    from atoll_core.wire.addresses import Destination
    from atoll_island_worker.processes.supervisor import Child
    from atoll_island_worker.tasks.task_server import TaskServer


def work_together(connect: "Destination", names: Sequence[str], options: argparse.Namespace) -> int:
    """Have one process for each name work, as often as it dies; forked, where that can be, after all is loaded once."""
    from atoll_island_worker.processes.fork_server import can_fork, load_ahead
    from atoll_island_worker.processes.parent import request_parent_death_signal
    from atoll_island_worker.processes.supervisor import supervise
    from atoll_island_worker.tasks.task_server import TaskServer

    end = time.monotonic() + options.lifetime if options.lifetime is not None else None
    with contextlib.ExitStack() as held:
        # First of all, since it is forked: of what is loaded and opened below it is to have nothing.
        start = partial(_fork, held.enter_context(contextlib.closing(TaskServer()))) if can_fork() else _start
        exit_reasons = held.enter_context(ExitReasons())
        if can_fork():
            with exiting():
                if options.parent is not None:
                    request_parent_death_signal()
                load_ahead()
                if options.parent not in (None, os.getppid()):
                    return 0
        starts = {name: partial(start, connect, name, options, end, exit_reasons) for name in names}
        return supervise(starts, exit_reasons, options.parent, options.grace)


def _start(
    connect: "Destination", name: str, options: argparse.Namespace, end: float | None, exit_reasons: ExitReasons
) -> "Child":
    """Start a process that works until `end` of the monotonic clock (None: without end)."""
    from atoll_island_worker.processes.command import worker_command
    from atoll_island_worker.processes.supervisor import start_process

    further = ["--log-format", options.log_format, "--log-level", options.log_level]
    further += ["--exit-reasons", str(exit_reasons.writing_end)]
    command = worker_command(connect, name, options.wait, options.grace, _seconds_until(end), further)
    return start_process(command, exit_reasons)


def _fork(
    tasks: "TaskServer", connect: "Destination", name: str, options: argparse.Namespace, end: float | None,
    exit_reasons: ExitReasons,
) -> "Child":  # fmt: skip
    """Start a fork of this process that works until `end`; `tasks` forks its processes for tasks."""
    from atoll_island_worker.processes.fork_server import Forked

    parent = os.getpid()

    def act() -> int:
        options.lifetime = _seconds_until(end)
        return exit_code_of(partial(work, connect, name, options, parent, tasks), exit_reasons.report)

    return Forked(act)


def _seconds_until(end: float | None) -> float | None:
    return None if end is None else max(0.0, end - time.monotonic())


def work(
    connect: "Destination", name: str, options: argparse.Namespace, parent: int | None,
    tasks: "TaskServer | None" = None,
) -> int:  # fmt: skip
    """Be one worker until there is nothing more to do; `parent`: the process with which this one ends.

    `tasks` starts processes for tasks; interpreters of their own unless given.
    """
    from atoll_core.logs import configure
    from atoll_island_worker.processes.parent import end_with_parent

    with exiting():
        if parent is not None:
            end_with_parent(parent)
        configure(options.log_format, options.log_level, worker=name)
        from atoll_core.compilation.cache import WarmUpDisplay
        from atoll_island_worker.worker import run_worker

        on_signal = partial(draining, parent) if options.grace > 0.0 else lambda leave: contextlib.nullcontext()
        show = WarmUpDisplay() if sys.stderr.isatty() and options.parent is None else None  # else it is in the log
        return run_worker(connect, name, options.wait, options.lifetime, options.grace, on_signal, show, tasks)
