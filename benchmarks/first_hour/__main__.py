"""Tables of the first hour: does anything break, is each law found, and is nothing relied on where there is none?

``python -m benchmarks.first_hour --out FILE.jsonl`` writes each table as a CSV file, hands it over as the command line
does, and judges what comes back; a file that exists is gone on with. ``--cases WORD`` takes those whose names hold a
word, ``--long`` also those of a million rows. ``--only-judge`` judges again what the file holds. Returns 1 when
anything broke or an equation is called good where there is no law, else 0.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from atoll_coordinator.cli.terminal.output import say
from benchmarks.first_hour.campaign import figures, is_as_it_should_be, judge_again, line, run
from benchmarks.first_hour.cases import CASES, GROUPS
from benchmarks.first_hour.outcomes import Outcome
from benchmarks.harness.command_line import plain_errors, positive, whole
from benchmarks.harness.journal import Journal


def main(arguments: Sequence[str] | None = None) -> int:
    """Do what the options ask for."""
    words = sys.argv[1:] if arguments is None else arguments
    options = _parser().parse_args(words)
    with plain_errors("benchmarks.first_hour"):
        names = [
            name
            for title, cases in GROUPS.items()
            for name in (case.name for case in cases)
            if (options.long or not CASES[name].is_long)
            and (not options.cases or any(word in name or word == title for word in options.cases))
        ]
        out = options.out
        journal = Journal("first_hour", Outcome, out, words, resume=out is not None and out.exists())
        if options.only_judge:
            judge_again(names, journal)
            outcomes = [journal.outcomes[name] for name in names if name in journal.outcomes]
            for each in outcomes:
                say(line(each))
        else:
            outcomes = run(names, journal, options.workers, options.limit)
        say(figures(outcomes))
        return 0 if is_as_it_should_be(outcomes) else 1


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.first_hour", description=__doc__.split("\n")[0])
    parser.add_argument("--cases", nargs="+", metavar="WORD", help="parts of names, or names of groups; default: all")
    parser.add_argument("--long", action="store_true", help="also the tables of a million rows")
    parser.add_argument("--workers", type=whole, default=2, help="worker processes (%(default)s)")
    parser.add_argument(
        "--limit", type=positive, default=600.0, help="seconds after which a table is late (%(default)g)"
    )
    parser.add_argument("--out", "--resume", type=Path, metavar="FILE", help="file of JSON lines, gone on with")
    parser.add_argument("--only-judge", action="store_true", help="search nothing; judge what the file holds")
    return parser


if __name__ == "__main__":
    sys.exit(main())
