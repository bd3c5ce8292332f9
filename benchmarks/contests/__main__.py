"""Contests with public data, on held-out rows of their train sets.

``python -m benchmarks.contests ctf --data DIR --out FILE.json`` writes the nine predictions of the Lorenz contest of
the Common Task Framework (FILE.npz) and the scores of held-out rows. ``python -m benchmarks.contests llm_sr --data
DIR`` searches the four problems of LLM-SR, with a quarter of the rows held out: at random, and beyond a threshold.
"""

import sys
from argparse import Namespace
from pathlib import Path
from typing import Final

from benchmarks.contests import ctf, llm_sr
from benchmarks.harness.command_line import OUT, option, positive, program, seeds, verb, verbs, workers

_PAIRS: Final = tuple(range(1, 10))
_PROBLEMS: Final = tuple(llm_sr.PROBLEMS)
_SPLITS: Final = tuple(dict.fromkeys(split for problem in llm_sr.PROBLEMS.values() for split in problem.splits))
_COMMON: Final = (
    option("--data", type=Path, metavar="DIR", required=True, help="folder of the train sets"),
    option("--seed", type=int, default=0, help="seed of the searches (%(default)s)"),
    workers(),
    OUT,
)


@program(
    "benchmarks.contests",
    __doc__,
    verbs(
        verb(
            "ctf",
            "the Lorenz contest of the Common Task Framework",
            *_COMMON,
            option("--draws", type=seeds, default=seeds("0-2"), help="draws of held-out rows (0-2)"),
            option("--pairs", type=int, choices=_PAIRS, nargs="+", default=_PAIRS, help="default: all nine"),
            option("--only-held-out", action="store_true", help="no predictions for the contest itself"),
        ),
        verb(
            "llm_sr",
            "the four problems of LLM-SR",
            *_COMMON,
            option("--problems", choices=_PROBLEMS, nargs="+", default=_PROBLEMS, help="default: all"),
            option("--splits", choices=_SPLITS, nargs="+", default=_SPLITS, help="default: all of each problem"),
            option("--config", metavar="job.toml", nargs="+", help="settings; each further file searches a factor"),
            option("--max-time", type=positive, metavar="SECONDS", help="end of a job; default: none"),
        ),
    ),
)
def main(options: Namespace) -> None:
    """Run one contest."""
    {"ctf": ctf.run, "llm_sr": llm_sr.run}[options.verb](options)


if __name__ == "__main__":
    sys.exit(main())
