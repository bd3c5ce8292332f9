"""Systems of many states: how many of their equations come out right, and in what time.

``python -m benchmarks.many run --systems yeast lorenz96-40 --seeds 1000-1004 --out FILE.jsonl`` searches each system
with each seed and judges every equation; ``--resume FILE.jsonl`` goes on; ``show FILE.jsonl`` prints the table again.
``laws`` in place of ``run`` judges the laws that regression finds, and searches nothing. ``prepare`` measures how long
preparing takes, also on simulated workers.
``--dysts DIR`` adds flows of the files that ``python -m benchmarks.dysts make`` has written there, by their names.
"""

import sys
from argparse import Namespace
from pathlib import Path
from typing import Final

from benchmarks.harness.command_line import option, program, seeds_of, verb, verbs, whole, workers
from benchmarks.many import laws, preparing
from benchmarks.many.campaign import run, show
from benchmarks.many.systems import SYSTEMS

SEARCHED: Final = (
    option("--systems", nargs="+", default=["yeast"], help=f"of {', '.join(SYSTEMS)}, or of --dysts"),
    option("--noise", type=float, nargs="+", default=[0.0], help="percent of each state's deviation"),
    seeds_of("1000-1004", "of data and search (1000-1004)"),
    option("--runs", type=whole, help="initial conditions, instead of the system's own number"),
    option("--max-time", type=float, metavar="SECONDS", help="end of a job; default: none"),
    option("--dysts", type=Path, metavar="DIR", help="files of chaotic flows"),
)
LINES: Final = (
    option("--out", type=Path, metavar="FILE", help="file of JSON lines to write each search to"),
    option("--resume", type=Path, metavar="FILE", help="such a file, to go on with"),
)


@program(
    "benchmarks.many",
    __doc__,
    verbs(
        verb("run", "search and judge", *SEARCHED, workers(), *LINES),
        verb("laws", "judge the laws by regression alone", *SEARCHED),
        verb("prepare", "measure preparing on simulated workers", *SEARCHED),
        verb("show", "print the table of a file", option("file", type=Path, metavar="FILE")),
    ),
)
def main(options: Namespace) -> None:
    """Do what the options ask for."""
    ways = {"run": run, "laws": laws.run, "prepare": preparing.run, "show": show}
    ways[options.verb](options)


if __name__ == "__main__":
    sys.exit(main())
