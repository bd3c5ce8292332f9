"""From noisy measurements to equations: what is found of the seven systems of Table III, and how far it can be trusted.

``python -m benchmarks.noise --seeds 0-4 --out FILE.jsonl`` samples each system with data seed k (four trajectories of
100 points at a step of 0.1) at five levels of noise, searches it with seed k on a coordinator and two workers, and
judges every equation: its form, its constants and their intervals, and whether all equations together foretell a
trajectory from fresh initial conditions. ``--resume FILE.jsonl`` goes on where an interrupted run stopped.

``--variants`` adds other manners of sampling. ``--versus pysindy`` sets PySINDy beside it on the same data (extra
``bench``). Instead of the searches: ``--hard`` (input that no model fits), ``--timing``, ``--driven`` (a measured
input), ``--record`` (the lynx-hare record).
"""

import argparse
import math
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import Final

from atoll.errors import UsageError
from atoll_coordinator.cli.terminal.output import note, say
from benchmarks.harness.command_line import plain_errors, positive, seeds, whole
from benchmarks.harness.journal import Journal
from benchmarks.harness.record import Record, load
from benchmarks.harness.service import Searches, searching
from benchmarks.harness.systems import TABLE_III
from benchmarks.noise import cases as noise_cases
from benchmarks.noise.data import VARIANTS, Key, Variant, case
from benchmarks.noise.goals import goals, shown
from benchmarks.noise.judging import Outcome, outcome
from benchmarks.noise.search import search
from benchmarks.noise.tables import by_equation, by_grade, by_level, line, misses, summarized
from benchmarks.peers.pysindy_models import METHODS, require, solve

OURS: Final = "atoll"
LEVELS: Final = (0.0, 0.01, 0.05, 0.1, 0.2)


def keys(options: argparse.Namespace) -> Iterator[Key]:
    """Yield all searches, seed by seed, so that an interrupted run has whole seeds."""
    for seed in options.seeds:
        for level in options.levels:
            for variant in options.variants:
                for system in options.systems:
                    for method in _methods(options):
                        yield Key(method, variant, system, level, seed)


def _methods(options: argparse.Namespace) -> tuple[str, ...]:
    if options.versus is None:
        return (OURS,)
    return METHODS if options.only_versus else (OURS, *METHODS)


def campaign(options: argparse.Namespace, journal: Journal[Outcome]) -> list[Outcome]:
    """Do all searches that the journal does not have; return the outcomes of all that were asked for."""
    wanted = [*keys(options)]
    if options.judge_again:
        _judge_again(journal, wanted)
    missing = [key for key in wanted if key not in journal.outcomes]
    note(f"{len(wanted)} searches, {len(wanted) - len(missing)} of them done before")
    with ExitStack() as stack:
        searches = None
        if any(key.method == OURS for key in missing):
            searches = stack.enter_context(searching(options.workers))
        for number, key in enumerate(missing, start=1):
            _one(searches, key, options, journal)
            note(f"{number} of {len(missing)}: {line(journal.outcomes[key])}; load {load():.1f}")
    return [journal.outcomes[key] for key in wanted]


def _one(searches: Searches | None, key: Key, options: argparse.Namespace, journal: Journal[Outcome]) -> None:
    its = case(key)
    if key.method == OURS:
        assert searches is not None
        journal.add(*search(searches, key, its, options.max_time))
    else:
        answer = solve(key, its)
        journal.add(outcome(key, its, answer, {}), answer)


def _judge_again(journal: Journal, wanted: Sequence[Key]) -> None:
    """Judge what the journal has of `wanted` by the present rules."""
    for key in wanted:
        answer = journal.answers.get(key)
        if answer is not None:
            journal.add(outcome(key, case(key), answer, journal.outcomes[key].phases), answer)


def show(outcomes: Sequence[Outcome], options: argparse.Namespace, arguments: Sequence[str]) -> bool:
    """Print the tables, write the figures where --json says; return whether ours met all that is expected of it."""
    summaries = summarized(outcomes)
    say(by_level(summaries))
    say("\n" + by_equation(outcomes))
    ours = [each for each in outcomes if each.key.method == OURS]
    if ours:
        say("\n" + by_grade(ours))
    expected = goals([each for each in ours if each.key.variant == "plain"])
    if expected:
        say("\n" + shown(expected))
    missed = misses(ours)
    if missed:
        say("\nmissed:\n" + "\n".join(missed))
    figures = {
        "summaries": [{**asdict(each), "coverage": each.coverage} for each in summaries],
        "goals": [asdict(each) for each in expected],
        "searches": [asdict(each) for each in outcomes],
    }
    Record("noise", arguments, options.json).write(**figures)
    return all(each.is_met for each in expected)


def main(arguments: Sequence[str] | None = None) -> int:
    """Do what the options ask for; return 1 when something that is expected of all seven systems is not met, else 0."""
    words = sys.argv[1:] if arguments is None else arguments
    options = _parser().parse_args(words)
    with plain_errors("benchmarks.noise"):
        if options.section is not None:
            rows = noise_cases.show(options.section, options.workers, options.max_time, options.seeds)
            Record(f"noise --{options.section}", words, options.json).write(rows=rows)
            return 0
        _check(options)
        journal = Journal("noise", Outcome, options.resume or options.out, words, resume=options.resume is not None)
        outcomes = campaign(options, journal)
        return 0 if show(outcomes, options, words) else 1


def _check(options: argparse.Namespace) -> None:
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


def variant(text: str) -> Variant:
    """Return a manner of sampling."""
    for known in VARIANTS:
        if text == known:
            return known
    raise argparse.ArgumentTypeError(f"one of {', '.join(VARIANTS)} was expected, but {text!r} was given")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.noise", description=__doc__.split("\n")[0])
    parser.add_argument("--systems", choices=TABLE_III, nargs="+", default=TABLE_III, help="default: all seven")
    parser.add_argument("--levels", type=level, nargs="+", default=LEVELS, help="default: 0 0.01 0.05 0.1 0.2")
    parser.add_argument("--variants", type=variant, nargs="+", default=("plain",), help=f"of {', '.join(VARIANTS)}")
    parser.add_argument("--seeds", type=seeds, default=seeds("0-4"), help="such as 0-4 (default)")
    parser.add_argument("--workers", type=whole, default=2, help="worker processes (%(default)s)")
    parser.add_argument("--max-time", type=positive, metavar="SECONDS", help="end of a search; default: none")
    parser.add_argument("--out", type=Path, metavar="FILE", help="file of JSON lines to write each search to")
    parser.add_argument("--resume", type=Path, metavar="FILE", help="such a file, to go on with")
    parser.add_argument("--judge-again", action="store_true", help="judge what --resume holds by the present rules")
    parser.add_argument("--json", type=Path, metavar="FILE", help="file for the tables' figures as JSON")
    parser.add_argument("--versus", choices=("pysindy",), help="set another program beside ours, on the same data")
    parser.add_argument("--only-versus", action="store_true", help="that program alone")
    sections = parser.add_mutually_exclusive_group()
    for name, (purpose, _) in noise_cases.SECTIONS.items():
        sections.add_argument(f"--{name}", action="store_const", const=name, dest="section", help=purpose)
    return parser


if __name__ == "__main__":
    sys.exit(main())
