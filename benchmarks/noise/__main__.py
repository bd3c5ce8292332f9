"""From noisy measurements to equations: what is found of the seven systems of Table III, and how far it can be trusted.

``python -m benchmarks.noise --seeds 0-4 --out FILE.jsonl`` samples each system with data seed k (four trajectories of
100 points at a step of 0.1) at five levels of noise, searches it with seed k on a coordinator and two workers, and
judges every equation: its form, its constants and their intervals, and whether all equations together foretell a
trajectory from fresh initial conditions. ``--resume FILE.jsonl`` goes on where an interrupted run stopped.
``--versus pysindy`` sets PySINDy beside it on the same data (extra ``bench``).
"""

import argparse
import math
import sys
from argparse import Namespace
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Final

from atoll.terminal.output import say
from atoll_core.errors import UsageError
from benchmarks.harness.campaign import Answer, Service, journal_of, judge_again, work_off
from benchmarks.harness.command_line import option, positive, program, seeds_of, workers
from benchmarks.harness.journal import Journal
from benchmarks.harness.record import Record
from benchmarks.harness.systems import TABLE_III
from benchmarks.noise.data import Key, case
from benchmarks.noise.judging import Outcome, outcome, search
from benchmarks.noise.tables import by_equation, by_grade, by_level, line, misses, summarized
from benchmarks.peers.pysindy_models import METHODS, require, solve

OURS: Final = "atoll"
LEVELS: Final = (0.0, 0.01, 0.05, 0.1, 0.2)


def keys(options: Namespace) -> Iterator[Key]:
    """Yield all searches, seed by seed, so that an interrupted run has whole seeds."""
    for seed in options.seeds:
        for level in options.levels:
            for system in options.systems:
                for method in _methods(options):
                    yield Key(method, system, level, seed)


def _methods(options: Namespace) -> tuple[str, ...]:
    if options.versus is None:
        return (OURS,)
    return METHODS if options.only_versus else (OURS, *METHODS)


def campaign(options: Namespace, journal: Journal[Outcome]) -> list[Outcome]:
    """Do all searches that the journal does not have; return the outcomes of all that were asked for."""
    wanted = [*keys(options)]
    if options.judge_again:
        judge_again(wanted, journal, lambda key, old, answer: outcome(key, case(key), answer, old.phases))

    def do(service: Service, key: Key) -> tuple[Outcome, Answer]:
        measured = case(key)
        if key.method == OURS:
            return search(service(), key, measured, options.max_time)
        answer = solve(key.method, key.seed, measured)
        return outcome(key, measured, answer, {}), answer

    return work_off(wanted, journal, do, line, options.workers)


def show(outcomes: Sequence[Outcome], options: Namespace, arguments: Sequence[str]) -> None:
    """Print the tables, write the figures where --json says."""
    summaries = summarized(outcomes)
    say(by_level(summaries))
    say("\n" + by_equation(outcomes))
    ours = [outcome for outcome in outcomes if outcome.key.method == OURS]
    if ours:
        say("\n" + by_grade(ours))
    missed = misses(ours)
    if missed:
        say("\nmissed:\n" + "\n".join(missed))
    figures = {
        "summaries": [{**asdict(summary), "coverage": summary.coverage} for summary in summaries],
        "searches": [asdict(outcome) for outcome in outcomes],
    }
    Record("noise", arguments, options.json).write(**figures)


def _check(options: Namespace) -> None:
    if options.versus is not None:
        require()
    elif options.only_versus:
        raise UsageError("--only-versus leaves our searches out; name the other program with --versus pysindy")
    if options.out is not None and options.resume is not None:
        raise UsageError("--out begins a file and --resume continues one; give one of the two")
    if options.judge_again and options.resume is None:
        raise UsageError("--judge-again judges what a file holds; name it with --resume")


def level(text: str) -> float:
    """Return a level of noise: a share of the standard deviation, at least 0."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 <= value < math.inf:
        raise argparse.ArgumentTypeError(f"a share such as 0.05 was expected, but {text!r} was given")
    return value


@program(
    "benchmarks.noise",
    __doc__,
    option("--systems", choices=TABLE_III, nargs="+", default=TABLE_III, help="default: all seven"),
    option("--levels", type=level, nargs="+", default=LEVELS, help="default: 0 0.01 0.05 0.1 0.2"),
    seeds_of("0-4", "such as 0-4 (default)"),
    workers(),
    option("--max-time", type=positive, metavar="SECONDS", help="end of a search; default: none"),
    option("--out", type=Path, metavar="FILE", help="file of JSON lines to write each search to"),
    option("--resume", type=Path, metavar="FILE", help="such a file, to go on with"),
    option("--judge-again", action="store_true", help="judge what --resume holds by the present rules"),
    option("--json", type=Path, metavar="FILE", help="file for the tables' figures as JSON"),
    option("--versus", choices=("pysindy",), help="set another program beside ours, on the same data"),
    option("--only-versus", action="store_true", help="that program alone"),
)
def main(options: Namespace) -> None:
    """Do what the options ask for."""
    _check(options)
    show(campaign(options, journal_of("noise", Outcome, options)), options, options.words)


if __name__ == "__main__":
    sys.exit(main())
