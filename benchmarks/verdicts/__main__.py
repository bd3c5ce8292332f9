"""Tables on which verdicts can be false, drawn from seeds: how often are they, and which right laws are doubted?

``python -m benchmarks.verdicts few-rows --seeds 1000-1199 --out FILE.jsonl`` draws the tables of campaigns from seeds,
hands each over as the command line does, judges what comes back and prints the counts of false verdicts; a file that
exists is gone on with. ``--show`` prints tables without searching them, ``--only-judge`` judges again what the file
holds. Returns 1 when anything broke, an "exact" is false, more than 2 % of the "good" of a campaign or 1 % of all are,
or a verdict is better for a limit of time; else 0. Other models and verdicts at other sampling rates are listed.
"""

import sys
from argparse import Namespace
from pathlib import Path

from atoll.terminal.output import say
from benchmarks.harness.campaign import journal_of
from benchmarks.harness.command_line import option, positive, program, seeds_of, workers
from benchmarks.verdicts.campaign import CAMPAIGNS, judge_again, keys, run, table_of
from benchmarks.verdicts.judging import Key, Outcome
from benchmarks.verdicts.tables import by_kind, cases, is_as_promised, limits, line, rates, summary


def _show(key: Key) -> None:
    drawn = table_of(key)
    least = {variable: f"{value:.2g}" for variable, value in drawn.t.items()}
    say(f"{key.title} ({drawn.kind}): {drawn.rows} rows, {' '.join(drawn.words)}; {dict(drawn.laws)}; t {least}")
    say("".join(f"  {row}\n" for row in drawn.csv().splitlines()[:13]))


@program(
    "benchmarks.verdicts",
    __doc__,
    option("campaigns", nargs="*", metavar="CAMPAIGN", help=f"of {', '.join(CAMPAIGNS)}; default: all"),
    seeds_of("0-9", "such as 1000-1199; those below 1000 are for choosing settings (0-9)"),
    workers(1),
    option("--max-time", type=positive, metavar="SECONDS", help="end of a job, in place of the campaign's own"),
    option("--limit", type=positive, default=900.0, help="seconds after which a job is late (%(default)g)"),
    option("--out", "--resume", type=Path, metavar="FILE", help="file of JSON lines, gone on with"),
    option("--only-judge", action="store_true", help="search nothing; judge what the file holds"),
    option("--kinds", action="store_true", help="a table by kinds as well"),
    option("--show", action="store_true", help="print the tables, nothing else"),
)
def main(options: Namespace) -> int:
    """Do what the options ask for."""
    wanted = keys(options.campaigns or [*CAMPAIGNS], options.seeds)
    if options.show:
        for key in wanted:
            _show(key)
        return 0
    journal = journal_of("verdicts", Outcome, options)
    if options.only_judge:
        judge_again(wanted, journal)
        outcomes = [journal.outcomes[key] for key in wanted if key in journal.outcomes]
        for outcome in outcomes:
            say(line(outcome))
    else:
        outcomes = run(wanted, journal, options.workers, options.max_time, options.limit)
    better, others = limits(outcomes, table_of), rates(outcomes, table_of)
    say("\n".join([summary(outcomes), "", *([by_kind(outcomes), ""] if options.kinds else []), *cases(outcomes),
                   *better, *others]))  # fmt: skip
    return 0 if is_as_promised(outcomes) and not better else 1


if __name__ == "__main__":
    sys.exit(main())
