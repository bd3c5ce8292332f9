"""Many independent runs over several processes, and the figures that come of them: a file of JSON, a picture."""

import argparse
import json
import multiprocessing
import os
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar

from atoll.errors import AtollError, UsageError
from atoll.machine.cores import usable_cores
from atoll_coordinator.cli.terminal.output import note
from atoll_island_worker.compute.warmup import warm_up
from atoll_island_worker.processes.signals import end_with_parent
from benchmarks.harness.reporting import load, machine, seeds

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RUN_LIMIT_S: Final = 1800.0
"""How long to wait for the next run to end: far longer than any takes, short enough to learn of a lost process."""

Task = TypeVar("Task")
Run = TypeVar("Run")


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that benchmarks of many runs have in common."""
    cores, _ = usable_cores(os.environ)
    parser.add_argument("--seeds", type=seeds, help="such as 0-9, instead of as many runs as in the paper")
    parser.add_argument("--workers", type=positive, default=cores, help="processes (%(default)s: all cores)")
    parser.add_argument("--out", type=Path, help="file for all figures as JSON")
    parser.add_argument("--picture", type=Path, help="file for the picture, such as figure.png")


def positive(text: str) -> int:
    """Return a whole number that is at least 1."""
    number = int(text) if text.isdecimal() else 0
    if number < 1:
        raise argparse.ArgumentTypeError(f"a whole number from 1 on was expected, but {text!r} was given")
    return number


def in_parallel(function: Callable[[Task], Run], tasks: Sequence[Task], workers: int) -> Iterator[Run]:
    """Yield ``function(task)`` for every task as they end, in `workers` processes.

    Kernels are made ready first, so that no two processes compile them. `function` is one of a module. Whatever
    happens here, the processes end.

    Raises:
        AtollError: a process was lost.
    """
    warm_up(note)
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


class Figures:
    """What a benchmark writes to its file: the machine, its load, the options, and what was measured."""

    def __init__(self, benchmark: str, arguments: Sequence[str], out: Path | None) -> None:
        self._out = out
        self._began = time.monotonic()
        self._head = {
            "benchmark": benchmark,
            "arguments": list(arguments),
            "date": time.strftime("%Y-%m-%d %H:%M"),
            "machine": machine(),
            "load_before": load(),
        }

    def seconds(self) -> float:
        """Return the time since the benchmark began."""
        return time.monotonic() - self._began

    def write(self, **figures: Any) -> None:
        """Write everything anew; nothing without a file."""
        if self._out is None:
            return
        contents = {**self._head, "load_after": load(), "seconds": self.seconds(), **figures}
        self._out.parent.mkdir(parents=True, exist_ok=True)
        self._out.write_text(json.dumps(contents, indent=1, ensure_ascii=False) + "\n", "utf-8")


def canvas(width: float, height: float) -> "Figure":
    """Return an empty picture of that size in inches.

    Raises:
        UsageError: matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise UsageError(
            "matplotlib, which draws the picture, is not installed; leave --picture out or pip install 'atoll[bench]'"
        ) from error
    return Figure(figsize=(width, height), layout="constrained")


def save(picture: "Figure", path: Path) -> None:
    """Write the picture; the name's ending says in which format."""
    path.parent.mkdir(parents=True, exist_ok=True)
    picture.savefig(path, dpi=150)
