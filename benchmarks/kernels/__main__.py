"""How fast the kernels evaluate: on a committed corpus, by number of rows, per operator; beside numpy and the machine.

``python -m benchmarks.kernels`` measures, on one thread,

* the corpus (``benchmarks.kernels.corpus``): 1,000 offspring of ``paper`` searches on 16 rows, from operation list to
  fitness, one list after the other;
* the same lists on more rows, and with the gradient by every constant;
* every operator by itself, forward and with gradient.

A point evaluation is one value of one list at one row; a node evaluation is one live node at one row. The machine's
peak is measured, not looked up: multiply-adds over an array in the first cache, and in registers, with two operations
each. Every figure is that of the fastest of several repetitions. Before anything is timed, the fitness of all lists is
compared with numpy's. Returns 1 when a fitness is wrong, else 0.
"""

import argparse
import sys
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Final

from atoll.terminal.output import note, say, table
from atoll_core.errors import UsageError
from atoll_core.expression.kernels.tape import LANES
from atoll_core.expression.operators import BY_NAME
from benchmarks.harness.command_line import OUT, option, program, whole
from benchmarks.harness.record import Record, load
from benchmarks.harness.tables import Columns
from benchmarks.kernels.corpus import CORPUS, load_corpus, make_corpus, save_corpus
from benchmarks.kernels.speeds import OperatorSpeed, Peak, Speed, operator_speed, parts_of, peak, speed, wrong

ROWS: Final = (64, 128, 1024)
OPERATOR_ROWS: Final = (16, 128)

GOAL_POINTS: Final = 100e6
GOAL_NODES: Final = 1.4e9
PAPER_POINTS: Final = 12.6e6
"""Point evaluations a second of one processor of Schmidt & Lipson 2008 (Table III: 59.6e9 in 589.7 s on 8)."""


def corpus_text(size: int, mean: float, its: Speed) -> str:
    """Return sentences on the speed at the corpus itself."""
    goals = f"goals {GOAL_POINTS / 1e6:.0f} M and {GOAL_NODES / 1e9:.1f} G"
    return (
        f"corpus: {size} lists, mean live size {mean:.2f}, {its.rows} rows, from list to fitness, one thread:\n"
        f"  {its.points / 1e6:.1f} M point evaluations/s, {its.nodes / 1e9:.2f} G node evaluations/s ({goals}); "
        f"{its.points / PAPER_POINTS:.1f} times a processor of the paper ({PAPER_POINTS / 1e6:.1f} M)"
    )


def rows_table(speeds: Sequence[Speed], limit: Peak) -> str:
    """Return the speeds by number of rows; shares are of `limit`, an operation being a node."""
    columns = Columns(
        "rows | M points/s={points:M.1f} | G nodes/s={nodes:G.2f} | with gradient M={gradient_points:M.1f} | "
        "G={gradient_nodes:G.2f} | x numpy={numpy_ratio:.1f}"
    )
    return _with_shares(columns, speeds, limit)


def operators_table(speeds: Sequence[OperatorSpeed], limit: Peak) -> str:
    """Return the speeds by operator."""
    columns = Columns(
        "operator | rows | G nodes/s={nodes:G.2f} | with gradient={gradient_nodes:G.2f} | x numpy={numpy_ratio:.1f}"
    )
    return _with_shares(columns, speeds, limit)


def _with_shares(columns: Columns, speeds: Sequence[Speed] | Sequence[OperatorSpeed], limit: Peak) -> str:
    peaks = limit.in_registers, limit.in_cache
    rows = [(*columns.row(speed), *(f"{speed.nodes / peak:.1%}" for peak in peaks)) for speed in speeds]
    return table((*columns.heads, "of peak", "of L1 loop"), rows)


def _make(options: Namespace) -> int:
    if options.data is None:
        raise UsageError("--make-corpus needs --data, the folder of the Strogatz label files; name it")
    save_corpus(make_corpus(options.data), options.corpus)
    say(str(options.corpus))
    return 0


def _measure(options: Namespace, arguments: Sequence[str]) -> int:
    corpus = load_corpus(options.corpus)
    parts = parts_of(corpus, LANES)
    note("kernels are compiled or loaded")
    bad = wrong(parts)
    limit = peak(options.repetitions)
    say(
        f"multiply-adds: {limit.in_cache / 1e9:.2f} G operations/s over arrays in the first cache, "
        f"{limit.in_registers / 1e9:.2f} G in registers\n"
    )
    note(f"{LANES} rows")
    speeds = [speed(parts, options.repetitions)]
    mean = float(sum(part.live.sum() for part in parts)) / len(corpus.code)
    say(corpus_text(len(corpus.code), mean, speeds[0]) + "\n")
    for rows in options.rows:
        note(f"{rows} rows")
        speeds.append(speed(parts_of(corpus, rows), options.repetitions))
    say(rows_table(speeds, limit) + "\n")
    operators = []
    for name in options.operator or BY_NAME:
        note(f"operator {name}")
        operators += [operator_speed(name, rows, options.repetitions) for rows in OPERATOR_ROWS]
    say(operators_table(operators, limit))
    say(f"\n{bad} of {len(corpus.code)} fitnesses are not numpy's; load {load():.1f}")
    figures = {
        "corpus": {"lists": len(corpus.code), "mean_live_size": mean, "wrong": bad},
        "peak": asdict(limit),
        "by_rows": [asdict(its) for its in speeds],
        "by_operator": [asdict(operator) for operator in operators],
    }
    Record("kernels", arguments, options.out).write(**figures)
    return 1 if bad else 0


def _rows(text: str) -> list[int]:
    parts = text.split(",")
    if not all(part.isdigit() and int(part) > 0 for part in parts):
        raise argparse.ArgumentTypeError(f"numbers of rows such as 64,1024 were expected, but {text!r} was given")
    return [int(part) for part in parts]


@program(
    "benchmarks.kernels",
    __doc__,
    option(
        "--rows", type=_rows, default=list(ROWS), help=f"besides {LANES}, such as 64,1024 ({','.join(map(str, ROWS))})"
    ),
    option("--operator", choices=BY_NAME, action="append", help="repeat for several; default: all"),
    option("--repetitions", type=whole, default=7, help="the fastest counts (%(default)s)"),
    option("--corpus", type=Path, default=CORPUS, help="file of operation lists (the committed one)"),
    option("--make-corpus", action="store_true", help="write that file anew, from searches in --data"),
    option("--data", type=Path, help="folder of the Strogatz label files, for --make-corpus"),
    OUT,
)
def main(options: Namespace) -> int:
    """Measure and print, or make the corpus; return 1 when a fitness is not what numpy computes, else 0."""
    if options.make_corpus:
        return _make(options)
    return _measure(options, options.words)


if __name__ == "__main__":
    sys.exit(main())
