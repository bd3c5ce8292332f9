"""Chaotic flows: equations from noisy trajectories, form not given, beside the published errors of methods given it.

``python -m benchmarks.dysts make --out DIR`` (in an environment with the package ``dysts``) writes the data, once.
``python -m benchmarks.dysts run --data DIR --noise 0 0.1 1 --out FILE.jsonl`` searches each flow at each noise (percent
of the root mean square), default settings, and judges it; ``--resume FILE.jsonl`` goes on. ``show FILE.jsonl
--published CSV`` prints the tables again.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.dysts.making import OTHERS, POLYNOMIAL, make


def main(arguments: Sequence[str] | None = None) -> int:
    """Do what the options ask for."""
    options = _parser().parse_args(arguments)
    if options.verb == "make":
        make(options.out, options.systems or (*POLYNOMIAL, *OTHERS), options.seed, print)
        return 0
    from benchmarks.dysts.campaign import run

    options.words = sys.argv[1:] if arguments is None else list(arguments)
    return run(options)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.dysts", description=__doc__.split("\n")[0])
    verbs = parser.add_subparsers(dest="verb", required=True)
    making = verbs.add_parser("make", help="write the data, from the package dysts")
    making.add_argument("--out", type=Path, required=True, metavar="DIR")
    making.add_argument("--seed", type=int, default=1000, help="of the initial conditions (%(default)s)")
    running = verbs.add_parser("run", help="search and judge")
    running.add_argument("--data", type=Path, required=True, metavar="DIR")
    running.add_argument("--noise", type=float, nargs="+", default=[0.0], help="percent of the root mean square")
    running.add_argument("--seed", type=int, default=1000, help="of noise and search (%(default)s)")
    running.add_argument("--workers", type=int, default=2, help="worker processes (%(default)s)")
    running.add_argument("--max-time", type=float, metavar="SECONDS", help="end of a search; default: none")
    running.add_argument("--out", type=Path, metavar="FILE", help="file of JSON lines to write each search to")
    running.add_argument("--resume", type=Path, metavar="FILE", help="such a file, to go on with")
    showing = verbs.add_parser("show", help="print the tables of a file")
    showing.add_argument("resume", type=Path, metavar="FILE")
    for verb in (making, running, showing):
        verb.add_argument("--systems", nargs="+", help="default: all")
        verb.add_argument(
            "--polynomial", dest="systems", action="store_const", const=POLYNOMIAL, help="the 70 of the published table"
        )
    for verb in (running, showing):
        verb.add_argument("--published", type=Path, metavar="CSV", help="published errors by flow")
    return parser


if __name__ == "__main__":
    sys.exit(main())
