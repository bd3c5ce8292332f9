"""Many independent runs over several processes."""

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from typing import Final, TypeVar

from atoll_core.compilation.progress import WarmUpDisplay
from atoll_core.errors import AtollError
from atoll_island_worker.compute.warmup import warm_up
from atoll_island_worker.processes import end_with_parent

RUN_LIMIT_S: Final = 4 * 3600.0
"""How long to wait for the next run to end: far longer than any takes, short enough to learn of a lost process."""

Task = TypeVar("Task")
Run = TypeVar("Run")


def in_parallel(function: Callable[[Task], Run], tasks: Sequence[Task], workers: int) -> Iterator[Run]:
    """Yield ``function(task)`` for every task as they end, in `workers` processes.

    Kernels are made ready first, so that no two processes compile them. `function` is one of a module. Whatever
    happens here, the processes end. Raises AtollError where one was lost.
    """
    warm_up(WarmUpDisplay())
    context = multiprocessing.get_context("spawn")
    with context.Pool(min(workers, len(tasks)) or 1, _begin, (os.getpid(),)) as pool:
        ended = pool.imap_unordered(function, tasks)
        for _ in tasks:
            try:
                yield ended.next(RUN_LIMIT_S)
            except multiprocessing.TimeoutError as error:
                message = f"no run has ended for {RUN_LIMIT_S:.0f} s; a process may have been killed: run it again"
                raise AtollError(message) from error


def _begin(parent: int) -> None:
    """Leave a Ctrl-C to the parent, and end with it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with_parent(parent)
