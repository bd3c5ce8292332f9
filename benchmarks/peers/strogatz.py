"""The 14 Strogatz label files: equations from exact derivatives, also with the paper's own preset beside its Table III.

``python -m benchmarks.peers.strogatz --data DIR`` expects in DIR a file ``NAME.csv`` with the columns label, x and y
for each name of `PUBLISHED`, and ``truth.json``, which maps each name to the true expression. A file counts as solved
when the normalized error is below `SOLVED`, whether or not the form is exact; both are printed.

``--noise 0.001,0.01,0.1 --max-time 12`` is SRBench's protocol (`benchmarks.peers.strogatz_noise`), ``--versus operon``
the time to a normalized error of 1e-4 beside Operon's (`benchmarks.peers.strogatz_versus`; it needs the extra
``bench``).

``--preset paper --to-the-end --max-time 300 --target-error 1e-3`` is the algorithm of Table II with nothing added: its
constants are only drawn and mutated, so that how far it gets depends on what counts as found.
"""

import argparse
import itertools
import math
import sys
from argparse import Namespace
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from atoll.terminal.output import error_text, say, table
from atoll_coordinator.data.prepare import prepare
from atoll_core.config import PRESETS, JobConfig
from atoll_core.wire.messages.views import JobView
from benchmarks.harness import jobs
from benchmarks.harness.command_line import one_of, option, program, search_options
from benchmarks.harness.record import Record
from benchmarks.harness.report import Report
from benchmarks.harness.service import Searches, searching
from benchmarks.judging.verdict import Question, Verdict, judged
from benchmarks.peers import strogatz_noise, strogatz_versus
from benchmarks.peers.operon import require
from benchmarks.peers.strogatz_files import LABEL, rows_of, truths

SOLVED: Final = 1e-4
LEVELS: Final = (1e-2, 1e-3, 1e-4)
"""Normalized errors at whose first passing seconds and point evaluations are taken."""

PUBLISHED: Final = {
    "glider1": (10.2, 1.03e9),
    "glider2": (5.1, 0.50e9),
    "bacres1": (75.0, 7.59e9),
    "bacres2": (30.5, 3.09e9),
    "predprey1": (81.7, 8.26e9),
    "predprey2": (290.6, 29.38e9),
    "barmag1": (11.8, 1.19e9),
    "barmag2": (15.6, 1.58e9),
    "shearflow1": (3.6, 0.36e9),
    "shearflow2": (33.9, 3.42e9),
    "vdp1": (25.5, 2.58e9),
    "vdp2": (0.9, 0.09e9),
    "lv1": (4.3, 0.43e9),
    "lv2": (1.1, 0.11e9),
}
"""Table III of Schmidt & Lipson 2008: seconds on 8 processors and point evaluations, one run each."""


def configured(options: Namespace, seed: int) -> JobConfig:
    """Return the configuration of one search."""
    limits = {"max_time": options.max_time, "target_error": options.target_error}
    if options.to_the_end:
        limits |= {"stagnation": jobs.NEVER, "max_epochs": jobs.NEVER}
    return jobs.configured(seed, {"target": LABEL}, limits, preset=options.preset)


@dataclass
class Passings:
    """When the error of a search with one equation first was at each of `LEVELS`: seconds and point evaluations.

    Progress is known by epoch and looked at ten times a second; both figures are rounded up to that.
    """

    passed: dict[float, tuple[float, int]] = field(default_factory=dict)

    def look(self, view: JobView) -> None:
        """Take in the state of the job."""
        for variable in view.variables:
            for level in LEVELS:
                if variable.normalized_error is not None and variable.normalized_error <= level:
                    self.passed.setdefault(level, (view.elapsed, variable.point_evaluations))


def search(searches: Searches, name: str, truth: str, config: JobConfig, folder: Path) -> tuple[Verdict, Passings]:
    """Search the equation of one file and return the verdict on it."""
    measured = rows_of(folder, name)
    passings = Passings()
    result = searches.solve(f"{name} seed {config.seed}", measured, config, passings.look)
    question = Question(name, config.seed, {LABEL: truth}, prepare(measured, config).dataset)
    (verdict,) = judged(question, result)
    return verdict, passings


def is_solved(verdict: Verdict) -> bool:
    """Whether the error, which is never one of the derivative here, is small enough."""
    return verdict.error is not None and verdict.error < SOLVED


def beside_the_paper(searched: Sequence[tuple[Verdict, Passings]]) -> str:
    """Return a table with Table III's figures beside ours: seconds and point evaluations until each of `LEVELS`."""
    levels = [f"{level:g} {what}" for level in LEVELS for what in ("s", "evaluations")]
    heads = ("file", "seed", "exact", "error", "evaluations", *levels, "paper s", "paper evaluations")
    return table(heads, [_row(verdict, passings) for verdict, passings in searched])


def _row(verdict: Verdict, passings: Passings) -> tuple[str, ...]:
    seconds, evaluations = PUBLISHED[verdict.case]
    at_levels = [passings.passed.get(level) for level in LEVELS]
    return (
        verdict.case,
        str(verdict.seed),
        "yes" if verdict.exact else "no",
        error_text(verdict.error),
        f"{verdict.point_evaluations:.2e}",
        *(
            cell
            for passed in at_levels
            for cell in ((f"{passed[0]:.2f}", f"{passed[1]:.2e}") if passed else ("-", "-"))
        ),
        f"{seconds:.1f}",
        f"{evaluations:.2e}",
    )


def _compared(run: Callable[..., int], options: Namespace, known: Mapping[str, str], words: list[str]) -> int:
    """Let `run` search with the configuration of each seed."""
    if options.versus and options.target_error is None:
        options.target_error = SOLVED
    configs = {seed: configured(options, seed) for seed in options.seeds}
    with searching(options.workers) as searches:
        return run(searches, options, configs, known, Record("strogatz", words, options.out))


def _solved(options: Namespace, known: Mapping[str, str], words: list[str]) -> int:
    """Search without noise; return 0 when all are solved (or, with a target error, converged)."""
    report = Report("strogatz", words, options.out)
    searched: list[tuple[Verdict, Passings]] = []
    with searching(options.workers) as searches:
        for name, seed in itertools.product(options.file or PUBLISHED, options.seeds):
            searched.append(search(searches, name, known[name], configured(options, seed), options.data))
            report.add([searched[-1][0]], passings={f"{name} seed {seed}": searched[-1][1].passed})
    report.show()
    say("\n" + beside_the_paper(searched))
    good = sum(
        (is_solved(verdict) if options.target_error is None else verdict.converged) for verdict in report.verdicts
    )
    limit = f"error below {SOLVED:g}" if options.target_error is None else f"error at most {options.target_error:g}"
    say(f"\n{limit}: {good} of {len(report.verdicts)}")
    return 0 if good == len(report.verdicts) else 1


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
    option("--file", choices=PUBLISHED, action="append", help="repeat for several; default: all 14"),
    option("--preset", choices=PRESETS, default="default"),
    option("--target-error", type=float, help="normalized error at which a search ends"),
    option("--to-the-end", action="store_true", help="use all of --max-time, also without progress"),
    one_of(
        option(
            "--noise",
            type=levels,
            metavar="LEVEL[,LEVEL...]",
            help="learn from 300 rows whose labels have Gaussian noise of LEVEL times their root mean square",
        ),
        option("--versus", choices=["operon"], help="race to a normalized error of 1e-4"),
    ),
    *search_options("0-2", 60.0),
)
def main(options: Namespace) -> int:
    """Search all files, print the tables; return 0 when all came out as the mode of the benchmark would have it."""
    known = truths(options.data)
    if options.versus:
        require()
        return _compared(strogatz_versus.run, options, known, options.words)
    if options.noise:
        return _compared(strogatz_noise.run, options, known, options.words)
    return _solved(options, known, options.words)


if __name__ == "__main__":
    sys.exit(main())
