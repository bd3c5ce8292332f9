"""Systems of many states: how many of their equations come out right, and in what time.

``python -m benchmarks.many run --systems yeast lorenz96-40 --seeds 1000-1004 --out FILE.jsonl`` searches each system
with each seed and judges every equation; ``--resume FILE.jsonl`` goes on; ``show FILE.jsonl`` prints the table again.
``laws`` in place of ``run`` judges the laws that regression finds, and searches nothing. ``irrelevant`` measures what
an equation costs beside states that do not matter to it, ``effort`` how much each of nine equations is searched for.
``--dysts DIR`` adds flows of the files that ``python -m benchmarks.dysts make`` has written there, by their names.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.harness.command_line import seeds, whole
from benchmarks.many import effort, irrelevant, laws
from benchmarks.many.campaign import run, show
from benchmarks.many.systems import SYSTEMS


def main(arguments: Sequence[str] | None = None) -> int:
    """Do what the options ask for."""
    options = _parser().parse_args(arguments)
    words = sys.argv[1:] if arguments is None else list(arguments)
    if options.verb == "laws":
        return laws.run(options)
    if options.verb == "irrelevant":
        return irrelevant.run(options)
    if options.verb == "effort":
        return effort.run(options)
    return run(options, words) if options.verb == "run" else show(options.file)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.many", description=__doc__.split("\n")[0])
    verbs = parser.add_subparsers(dest="verb", required=True)
    running = verbs.add_parser("run", help="search and judge")
    regressing = verbs.add_parser("laws", help="judge the laws by regression alone")
    for each in (running, regressing):
        each.add_argument("--systems", nargs="+", default=["yeast"], help=f"of {', '.join(SYSTEMS)}, or of --dysts")
        each.add_argument("--noise", type=float, nargs="+", default=[0.0], help="percent of each state's deviation")
        each.add_argument("--seeds", type=seeds, default=seeds("1000-1004"), help="of data and search (1000-1004)")
        each.add_argument("--runs", type=whole, help="initial conditions, instead of the system's own number")
        each.add_argument("--max-time", type=float, metavar="SECONDS", help="end of a job; default: none")
        each.add_argument("--dysts", type=Path, metavar="DIR", help="files of chaotic flows")
    running.add_argument("--workers", type=whole, default=2, help="worker processes (%(default)s)")
    running.add_argument("--out", type=Path, metavar="FILE", help="file of JSON lines to write each search to")
    running.add_argument("--resume", type=Path, metavar="FILE", help="such a file, to go on with")
    beside = verbs.add_parser("irrelevant", help="what an equation costs beside states that do not matter to it")
    beside.add_argument("--others", type=int, nargs="+", default=[0, 4, 10, 20, 40], help="how many (even)")
    beside.add_argument("--seeds", type=seeds, default=seeds("1000"), help="of the data (1000)")
    spread = verbs.add_parser("effort", help="how search effort is spread over equations")
    spread.add_argument("--seeds", type=seeds, default=seeds("1000-1002"), help="of data and search (1000-1002)")
    showing = verbs.add_parser("show", help="print the table of a file")
    showing.add_argument("file", type=Path, metavar="FILE")
    return parser


if __name__ == "__main__":
    sys.exit(main())
