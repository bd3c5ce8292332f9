"""Figures of the analysis of models and of the Python API.

``python -m benchmarks.analysis --out FILE.json`` measures all of it; ``--parts dynamics branches`` some. Exit code 1: a
figure is not what it should be.
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

from atoll_coordinator.cli.terminal.output import say
from benchmarks.analysis import branches, dynamics, programs
from benchmarks.analysis.check import Check
from benchmarks.harness.command_line import whole
from benchmarks.harness.record import Record, load

PARTS: Final = ("dynamics", "branches", "programs")


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure what the options ask for; return the exit code."""
    options = _parser().parse_args(arguments)
    words = sys.argv[1:] if arguments is None else list(arguments)
    record = Record("analysis", words, options.out)
    has_failed = False
    for each in _checks(options):
        record.add(each)
        has_failed = has_failed or each.passes is False
        verdict = {True: "ok    ", False: "FAILED", None: "      "}[each.passes]
        say(f"{verdict} {each.quantity}: {each.found}" + (f" (expected {each.expected})" if each.expected else ""))
    say(f"load {load():.1f}")
    return int(has_failed)


def _checks(options: argparse.Namespace) -> Iterator[Check]:
    if "dynamics" in options.parts:
        yield from dynamics.checks()
    if "branches" in options.parts:
        yield from branches.checks()
    if "programs" in options.parts:
        yield from programs.checks(options.calls, options.repeats)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.analysis", description=__doc__.split("\n")[0])
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS, help="what is measured (all)")
    parser.add_argument("--calls", type=whole, default=100, help="calls in one interpreter (%(default)s)")
    parser.add_argument("--repeats", type=whole, default=5, help="of each time (%(default)s)")
    parser.add_argument("--out", type=Path, metavar="FILE", help="file of JSON to write the figures to")
    return parser


if __name__ == "__main__":
    sys.exit(main())
