"""Tables of the first hour: does anything break, is each law found, and is nothing relied on where there is none?

``python -m benchmarks.first_hour --out FILE.jsonl`` writes each table as a CSV file, hands it over as the command line
does, and judges what comes back; a file that exists is gone on with. ``--cases WORD`` takes those whose names hold a
word, ``--long`` also those of a million rows. ``--only-judge`` judges again what the file holds. Returns 1 when
anything broke or an equation is called good where there is no law, else 0.
"""

import sys
from argparse import Namespace
from pathlib import Path

from atoll.terminal.output import say
from benchmarks.first_hour.campaign import figures, is_as_it_should_be, judge_again, line, run
from benchmarks.first_hour.cases import CASES, GROUPS
from benchmarks.first_hour.outcomes import Outcome
from benchmarks.harness.campaign import journal_of
from benchmarks.harness.command_line import option, positive, program, workers


@program(
    "benchmarks.first_hour",
    __doc__,
    option("--cases", nargs="+", metavar="WORD", help="parts of names, or names of groups; default: all"),
    option("--long", action="store_true", help="also the tables of a million rows"),
    workers(),
    option("--limit", type=positive, default=600.0, help="seconds after which a table is late (%(default)g)"),
    option("--out", "--resume", type=Path, metavar="FILE", help="file of JSON lines, gone on with"),
    option("--only-judge", action="store_true", help="search nothing; judge what the file holds"),
)
def main(options: Namespace) -> int:
    """Do what the options ask for."""
    names = [
        name
        for title, cases in GROUPS.items()
        for name in (case.name for case in cases)
        if (options.long or not CASES[name].is_long)
        and (not options.cases or any(word in name or word == title for word in options.cases))
    ]
    journal = journal_of("first_hour", Outcome, options)
    if options.only_judge:
        judge_again(names, journal)
        outcomes = [journal.outcomes[name] for name in names if name in journal.outcomes]
        for outcome in outcomes:
            say(line(outcome))
    else:
        outcomes = run(names, journal, options.workers, options.limit)
    say(figures(outcomes))
    return 0 if is_as_it_should_be(outcomes) else 1


if __name__ == "__main__":
    sys.exit(main())
