"""Speed of evaluation in the kernels: on a committed corpus, by number of rows, and by operator.

``python -m benchmarks.kernels`` measures, on one thread,

* the corpus (``benchmarks.kernels.corpus``): 1,000 offspring of ``paper`` searches on 16 rows, from operation list to
  fitness, one list after the other;
* the same lists on more rows, and with the gradient with respect to every constant;
* every operator by itself, forward and with gradient.

A point evaluation is one value of one list at one row. A node evaluation is one live node at one row. Every figure
comes from the fastest of several repetitions.
"""

import sys
from argparse import Namespace
from dataclasses import asdict
from typing import Final

from atoll.terminal.output import note, say
from atoll_core.expression.kernels.tape import LANES
from atoll_core.expression.operators import BY_NAME
from benchmarks.harness.command_line import OUT, option, program, whole
from benchmarks.harness.record import Record, load
from benchmarks.harness.tables import Columns
from benchmarks.kernels.corpus import load_corpus
from benchmarks.kernels.speeds import Speed, operator_speed, parts_of, speed

ROWS: Final = (64, 128, 1024)
OPERATOR_ROWS: Final = (16, 128)

GOAL_POINTS: Final = 100e6
GOAL_NODES: Final = 1.4e9
PAPER_POINTS: Final = 12.6e6
"""Point evaluations a second of one processor of Schmidt & Lipson 2008 (Table III: 59.6e9 in 589.7 s on 8)."""

BY_ROWS: Final = Columns(
    "rows | M points/s={points:M.1f} | G nodes/s={nodes:G.2f} | with gradient M={gradient_points:M.1f} | "
    "G={gradient_nodes:G.2f}"
)
BY_OPERATOR: Final = Columns("operator | rows | G nodes/s={nodes:G.2f} | with gradient={gradient_nodes:G.2f}")


def corpus_text(size: int, mean: float, measured: Speed) -> str:
    """Return two lines about the speed on the corpus; `size` lists with `mean` live nodes."""
    goals = f"goals {GOAL_POINTS / 1e6:.0f} M and {GOAL_NODES / 1e9:.1f} G"
    return (
        f"corpus: {size} lists, mean live size {mean:.2f}, {measured.rows} rows, from list to fitness, one thread:\n"
        f"  {measured.points / 1e6:.1f} M point evaluations/s, {measured.nodes / 1e9:.2f} G node evaluations/s "
        f"({goals}); {measured.points / PAPER_POINTS:.1f} times a processor of the paper ({PAPER_POINTS / 1e6:.1f} M)"
    )


@program(
    "benchmarks.kernels",
    __doc__,
    option("--rows", type=whole, nargs="+", default=ROWS, help=f"besides {LANES} ({' '.join(map(str, ROWS))})"),
    option("--operator", choices=BY_NAME, action="append", help="repeat for several; default: all"),
    option("--repetitions", type=whole, default=7, help="the fastest counts (%(default)s)"),
    OUT,
)
def main(options: Namespace) -> None:
    """Measure and print."""
    corpus = load_corpus()
    speeds = []
    for rows in (LANES, *options.rows):
        note(f"{rows} rows")
        parts = parts_of(corpus, rows)
        speeds.append(speed(parts, options.repetitions))
    mean = float(sum(part.live.sum() for part in parts)) / len(corpus.code)
    say(corpus_text(len(corpus.code), mean, speeds[0]) + "\n")
    say(BY_ROWS.table(speeds) + "\n")
    operators = []
    for name in options.operator or BY_NAME:
        note(f"operator {name}")
        operators += [operator_speed(name, rows, options.repetitions) for rows in OPERATOR_ROWS]
    say(BY_OPERATOR.table(operators))
    say(f"\nload {load():.1f}")
    Record("kernels", options.words, options.out).write(
        corpus={"lists": len(corpus.code), "mean_live_size": mean},
        by_rows=[asdict(measured) for measured in speeds],
        by_operator=[asdict(operator) for operator in operators],
    )


if __name__ == "__main__":
    sys.exit(main())
