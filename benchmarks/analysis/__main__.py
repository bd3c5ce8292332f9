"""Figures of the analysis of models and of the Python API.

``python -m benchmarks.analysis --out FILE.json`` measures all of it; ``--parts dynamics branches`` some. Exit code 1: a
figure is not what it should be.
"""

import sys
from argparse import Namespace
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from atoll.terminal.output import say
from benchmarks.analysis import branches, dynamics, programs
from benchmarks.analysis.check import Check
from benchmarks.harness.command_line import option, program, whole
from benchmarks.harness.record import Record, load

PARTS: Final = ("dynamics", "branches", "programs")


def _checks(options: Namespace) -> Iterator[Check]:
    if "dynamics" in options.parts:
        yield from dynamics.checks()
    if "branches" in options.parts:
        yield from branches.checks()
    if "programs" in options.parts:
        yield from programs.checks(options.calls, options.repeats)


@program(
    "benchmarks.analysis",
    __doc__,
    option("--parts", nargs="+", choices=PARTS, default=PARTS, help="what is measured (all)"),
    option("--calls", type=whole, default=100, help="calls in one interpreter (%(default)s)"),
    option("--repeats", type=whole, default=5, help="of each time (%(default)s)"),
    option("--out", type=Path, metavar="FILE", help="file of JSON to write the figures to"),
)
def main(options: Namespace) -> int:
    """Measure what the options ask for; return the exit code."""
    record = Record("analysis", options.words, options.out)
    has_failed = False
    for check in _checks(options):
        record.add(check)
        has_failed = has_failed or check.passes is False
        verdict = {True: "ok    ", False: "FAILED", None: "      "}[check.passes]
        say(f"{verdict} {check.quantity}: {check.found}" + (f" (expected {check.expected})" if check.expected else ""))
    say(f"load {load():.1f}")
    return int(has_failed)


if __name__ == "__main__":
    sys.exit(main())
