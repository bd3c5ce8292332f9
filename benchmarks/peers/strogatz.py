"""The 14 Strogatz label files: equations from exact derivatives, or from labels with noise, and a race with Operon.

``python -m benchmarks.peers.strogatz --data DIR`` expects in DIR a file ``NAME.csv`` with the columns label, x and y
for each name of `NAMES`, and ``truth.json``, which maps each name to the true expression. ``--noise 0.001,0.01,0.1
--max-time 12`` is SRBench's protocol (`benchmarks.peers.strogatz_noise`; without noise by default), ``--versus operon``
the time to a normalized error of 1e-4 beside Operon's (`benchmarks.peers.strogatz_versus`; it needs the extra
``bench``).
"""

import argparse
import math
import sys
from argparse import Namespace
from pathlib import Path
from typing import Final

from atoll_core.config import PRESETS
from benchmarks.harness import jobs
from benchmarks.harness.command_line import one_of, option, program, search_options
from benchmarks.harness.record import Record
from benchmarks.harness.service import searching
from benchmarks.peers import strogatz_noise, strogatz_versus
from benchmarks.peers.operon import require
from benchmarks.peers.strogatz_files import LABEL, NAMES, truths

RACE_ERROR: Final = 1e-4
"""The normalized error to which both race."""


def levels(text: str) -> list[float]:
    """Return the noise levels of ``0,0.001,0.1``."""
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = [math.nan]
    if not all(0.0 <= number < 1e3 for number in numbers):
        raise argparse.ArgumentTypeError(f"levels such as 0.001,0.1 were expected, but {text!r} was given")
    return list(dict.fromkeys(numbers))


@program(
    "benchmarks.peers.strogatz",
    __doc__,
    option("--data", type=Path, required=True, help="folder with the files and truth.json"),
    option("--file", choices=NAMES, action="append", help="repeat for several; default: all 14"),
    option("--preset", choices=PRESETS, default="default"),
    option("--target-error", type=float, help="normalized error at which a search ends"),
    one_of(
        option(
            "--noise",
            type=levels,
            default=[0.0],
            metavar="LEVEL[,LEVEL...]",
            help="learn from 300 rows whose labels have Gaussian noise of LEVEL times their root mean square (0)",
        ),
        option("--versus", choices=["operon"], help="race to a normalized error of 1e-4"),
    ),
    *search_options("0-2", 60.0),
)
def main(options: Namespace) -> int:
    """Search all files, print the tables; return 0 when all came out as the mode of the benchmark would have it."""
    known = truths(options.data)
    run = strogatz_noise.run
    if options.versus:
        require()
        options.target_error = options.target_error or RACE_ERROR
        run = strogatz_versus.run
    limits = {"max_time": options.max_time, "target_error": options.target_error}
    configs = {seed: jobs.configured(seed, {"target": LABEL}, limits, preset=options.preset) for seed in options.seeds}
    record = Record("strogatz", options.words, options.out)
    with searching(options.workers) as searches:
        return run(searches, options, configs, known, record)


if __name__ == "__main__":
    sys.exit(main())
