"""Which of several scores finds the law among systems near it.

``python -m benchmarks.scores --seeds 0-9 --states 1 2 --out FILE.jsonl`` draws systems of the corpus, measures them
at each quality, makes a pool of systems near the law, and has each score choose; a file that exists is gone on with.
"""

import sys
from argparse import Namespace
from functools import partial
from pathlib import Path
from typing import Final

from atoll.terminal.output import note, say
from benchmarks.corpus.cases import Key
from benchmarks.harness.campaign import journal_of
from benchmarks.harness.command_line import option, program, seeds, whole, workers
from benchmarks.harness.parallel import in_parallel
from benchmarks.scores.outcomes import SCORES, Outcome, choose, line, table

QUALITIES: Final = (
    "rk45-1e-3", "rk45-1e-6", "noise-0.001", "noise-0.01", "noise-0.05", "ar1-0.01", "proportional-0.01",
)  # fmt: skip


@program(
    "benchmarks.scores",
    __doc__,
    option("--seeds", type=seeds, default=list(range(5)), help="of systems, such as 0-4 (default)"),
    option("--states", type=whole, nargs="+", default=[1, 2, 3], help="numbers of states (default 1 2 3)"),
    option("--trajectories", type=whole, nargs="+", default=[1, 4], help="numbers of trajectories (default 1 4)"),
    option("--qualities", nargs="+", default=list(QUALITIES), help="kinds of errors (default: seven)"),
    option("--scores", nargs="+", choices=tuple(SCORES), default=list(SCORES), help="default: all"),
    workers(),
    option("--out", "--resume", type=Path, metavar="FILE", help="file of JSON lines, gone on with"),
)
def main(options: Namespace) -> None:
    """Do what the options ask for."""
    keys = [
        Key("random", states, trajectories, "even", quality, seed)
        for seed in options.seeds
        for states in options.states
        for trajectories in options.trajectories
        for quality in options.qualities
    ]
    journal = journal_of("scores", Outcome, options)
    missing = [key for key in keys if key not in journal.outcomes]
    for number, outcome in enumerate(
        in_parallel(partial(choose, names=options.scores), missing, options.workers), start=1
    ):
        journal.add(outcome)
        note(f"{number} of {len(missing)}: {line(outcome)}")
    say(table([journal.outcomes[key] for key in keys if key in journal.outcomes]))


if __name__ == "__main__":
    sys.exit(main())
