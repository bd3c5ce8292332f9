"""The walk of a table through the code: ``python -m benchmarks.walk``.

A reader who follows one table through preparing, refining and the result opens a function where it is called for the
first time. The program records these first calls for some stored pools (`benchmarks/pools`) with a profiler, in their
order, and counts: modules visited, stays (first calls in one module without another module between them) and
returns (stays in a module that was left before), and functions opened. Compiled kernels are not seen by the profiler.
"""

import sys
import threading
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path
from types import CodeType, FrameType
from typing import Any, Final

import atoll_coordinator
import atoll_core
from atoll.terminal.output import note, say, table
from benchmarks.harness.command_line import option, program
from benchmarks.pools.campaign import POOLS, titles
from benchmarks.pools.cases import Folders, job_of
from benchmarks.pools.stored import file_of, read_pools, refine_stored

ROOTS: Final = tuple(str(Path(package.__file__ or "").parent) for package in (atoll_coordinator, atoll_core))
"""Folders whose functions count."""
TITLES: Final = ("noise-0.001", "rk45-1e-6", "targets", "groups", "stochastic", "many")
"""Kinds of pools that are walked if none are named: the first title of each."""


@dataclass
class Walk:
    """Functions in the order of their first calls."""

    seen: set[CodeType] = field(default_factory=set)
    modules: list[str] = field(default_factory=list)

    def record(self, frame: FrameType, event: str, _: Any) -> None:
        """Note the first call of a function of the product; a profile function of `sys.setprofile`."""
        code = frame.f_code
        if event == "call" and code not in self.seen and code.co_filename.startswith(ROOTS) and code.co_name[0] != "<":
            self.seen.add(code)
            self.modules.append(code.co_filename)

    @property
    def row(self) -> tuple[str, ...]:
        """Modules, stays, returns and functions as text."""
        stays = [module for module, _ in groupby(self.modules)]
        counts = (len(set(stays)), len(stays), len(stays) - len(set(stays)), len(self.modules))
        return tuple(str(count) for count in counts)


def walk_of(title: str) -> Walk:
    """Prepare and refine a stored pool, and return the walk."""
    job = job_of(title, Folders())
    pools = read_pools(file_of(POOLS, title))
    refine_stored(title, job.table, job.config, pools)  # kernels are compiled, and caches filled, before the walk
    walk = Walk()
    threading.setprofile(walk.record)
    sys.setprofile(walk.record)
    try:
        refine_stored(title, job.table, job.config, pools)
    finally:
        sys.setprofile(None)
        threading.setprofile(None)
    return walk


def _first_of_each(words: Sequence[str]) -> list[str]:
    first = (next((title for title in titles() if word in title), None) for word in words)
    return [title for title in first if title is not None]


@program(
    "benchmarks.walk",
    __doc__,
    option("pools", nargs="*", default=TITLES, help="parts of titles, the first of each is walked (%(default)s)"),
)
def main(options: Namespace) -> int:
    """Walk some pools and print the counts."""
    rows = []
    for title in _first_of_each(options.pools):
        note(title)
        rows.append((title, *walk_of(title).row))
    say(table(("pool", "modules", "stays", "returns", "functions"), rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
