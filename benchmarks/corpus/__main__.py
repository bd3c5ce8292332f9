"""Random systems from seeds at any quality of data: what is found, and how far verdicts can be trusted.

``python -m benchmarks.corpus --seeds 0-19 --out FILE.jsonl`` draws systems (seeds below 1000 are for choosing
settings, figures come from others), simulates or measures them at each of --qualities, searches them on one coordinator
and its workers, and prints tables in Markdown. A file that exists is gone on with. ``--named`` searches single systems
of textbooks instead, one trajectory each, ``--families`` such with constants drawn from the seed; ``--methods`` gives
the same data to other programs as well; ``--show`` draws systems without searching them. ``--keep-pools DIR`` keeps
what searches hand on to refining, and ``--pools DIR`` refines that again, by another revision, say.
"""

import argparse
import sys
from argparse import Namespace
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

from atoll.terminal.output import say
from atoll_core.errors import UsageError
from benchmarks.corpus.campaign import judge_again, refine_all_pools, request_of, run_jobs
from benchmarks.corpus.cases import KNOWN_PART, OURS, SAMPLINGS, UNTOLD, Key, make_case
from benchmarks.corpus.families import FAMILIES, NAMED, WITH_FUNCTIONS
from benchmarks.corpus.outcomes import Outcome
from benchmarks.corpus.qualities import NAMED_QUALITIES, QUALITIES, quality
from benchmarks.corpus.tables import by_grade, by_quality, by_unknown_summand, equation_rows
from benchmarks.harness.campaign import journal_of
from benchmarks.harness.command_line import option, positive, program, seeds_of, whole, workers
from benchmarks.peers import operon, pysindy_models
from benchmarks.peers.operon_models import OPERON
from benchmarks.pools.stored import keep_pools

NAMED_STATES: Final = {name: len(family.equations) for name, (family, *_) in NAMED.items()}
CHAOTIC: Final = ("lorenz",)
BY_FAMILY: Final = {
    name: len(family.equations) for name, family in (FAMILIES | WITH_FUNCTIONS).items() if name not in NAMED
}
METHODS: Final = (OURS, UNTOLD, KNOWN_PART, *pysindy_models.METHODS, OPERON)


def keys(options: Namespace) -> list[Key]:
    """Return all jobs, seed by seed; with --qualities each, one quality a seed in turn."""
    qualities = options.qualities or (NAMED_QUALITIES if options.named is not None else QUALITIES)
    if options.named is not None:
        names = options.named or [name for name in NAMED if name not in CHAOTIC]
        return [
            Key(name, NAMED_STATES[name], 1, "even", quality, seed, method)
            for seed in options.seeds
            for name in names
            for quality in qualities
            for method in options.methods
        ]
    if options.families is not None:
        return [
            Key(name, BY_FAMILY[name], trajectories, sampling, quality, seed, method)
            for seed in options.seeds
            for name in options.families or WITH_FUNCTIONS
            for trajectories in options.trajectories
            for sampling in options.samplings
            for quality in qualities
            for method in options.methods
        ]
    return [
        Key("random", states, trajectories, sampling, quality, seed, method)
        for seed in options.seeds
        for states in options.states
        for trajectories in options.trajectories
        for sampling in options.samplings
        for quality in ([qualities[(seed + states) % len(qualities)]] if options.in_turn else qualities)
        for method in options.methods
    ]


def _require(methods: Sequence[str]) -> None:
    if OPERON in methods:
        operon.require()
    if set(methods) & set(pysindy_models.METHODS):
        pysindy_models.require()


def _tables(outcomes: Sequence[Outcome], *, all_equations: bool) -> None:
    say(by_quality(outcomes))
    say("\n" + by_grade(outcomes))
    say("\n" + by_unknown_summand(outcomes))
    say("\n" + equation_rows(outcomes, only_wrong=not all_equations))


def _show(wanted: Sequence[Key]) -> None:
    for key in wanted:
        case = make_case(key)
        least = {state: f"{value:.2g}" for state, value in case.t.items()}
        say(f"{key.title} ({case.system.name}): {case.system.truths}; {case.table.rows} rows, t {least}")


def _sampling(text: str) -> str:
    if text not in SAMPLINGS:
        raise argparse.ArgumentTypeError(f"one of {', '.join(SAMPLINGS)} was expected, but {text!r} was given")
    return text


def _quality(text: str) -> str:
    try:
        quality(text)
    except UsageError as error:
        raise argparse.ArgumentTypeError(str(error)) from error
    return text


@program(
    "benchmarks.corpus",
    __doc__,
    option("--named", nargs="*", choices=tuple(NAMED), help="single systems; default: all but chaotic ones"),
    option("--families", nargs="*", choices=tuple(BY_FAMILY), help="drawn constants; default: laws with functions"),
    seeds_of("0", "such as 0-19 (0)"),
    option("--qualities", type=_quality, nargs="+", help=f"of {', '.join(QUALITIES)}; default: all"),
    option("--in-turn", action="store_true", help="one quality a system, in turn, rather than each"),
    option("--states", type=int, choices=range(1, 6), nargs="+", default=[1, 2], help="default: 1 2"),
    option("--trajectories", type=whole, nargs="+", default=[4], help="default: 4"),
    option("--samplings", type=_sampling, nargs="+", default=["even"], help=f"of {', '.join(SAMPLINGS)}"),
    option("--methods", choices=METHODS, nargs="+", default=[OURS], help="ours and other programs on the same data"),
    workers(),
    option("--max-time", type=positive, metavar="SECONDS", help="end of a search; default: none"),
    option("--epochs", type=whole, help="end of a search in epochs; default: the configuration's"),
    option("--out", "--resume", type=Path, metavar="FILE", help="file of JSON lines, gone on with if it exists"),
    option("--judge-again", action="store_true", help="judge what the file holds by the present rules"),
    option("--only-judge", action="store_true", help="search nothing; tables of what the file holds"),
    option("--keep-pools", type=Path, metavar="DIR", help="only search, and keep there what is handed on"),
    option("--pools", type=Path, metavar="DIR", help="only refine what is kept there, each in one process"),
    option("--show", action="store_true", help="draw the systems and print them, nothing else"),
)
def main(options: Namespace) -> int:
    """Do what the options ask for."""
    wanted = keys(options)
    for key in wanted:
        quality(key.quality)
    _require(options.methods)
    if options.show:
        _show(wanted)
        return 0
    journal = journal_of("corpus", Outcome, options)
    if options.judge_again:
        judge_again(wanted, journal)
    if options.keep_pools:
        requests = {key.title: partial(request_of, key, options.max_time) for key in wanted}
        keep_pools(requests, options.keep_pools, options.workers)
        return 0
    if options.only_judge:
        outcomes = [journal.outcomes[key] for key in wanted if key in journal.outcomes]
    elif options.pools:
        outcomes = refine_all_pools(wanted, journal, options.pools, options.workers, options.max_time)
    else:
        changes: dict[str, Any] = {} if options.epochs is None else {"max_epochs": options.epochs}
        outcomes = run_jobs(wanted, journal, options.workers, options.max_time, changes)
    _tables(outcomes, all_equations=options.named is not None)
    return 0


if __name__ == "__main__":
    sys.exit(main())
