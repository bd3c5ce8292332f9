"""How preparing grows with rows and with columns: processor seconds, most memory, and exponents.

``python -m benchmarks.operations.preparing_sizes --rows 10000 100000 1000000`` prepares tables of two states (a damped
oscillation with `--noise` percent) with so many rows; ``--columns 10 50 200`` prepares tables of 2,000 rows with so
many states, each a sum of six sines. Each table is prepared by a process of its own. The exponent of a size relates it
to the size before.
"""

import math
import resource
import sys
import time
from argparse import Namespace
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Final

import numpy as np

from atoll.terminal.output import note, say, table
from atoll_coordinator.tasks.preparing import prepare_job
from atoll_coordinator.warmup import warm_up
from atoll_core.data.dataset import FloatArray
from benchmarks.harness.command_line import option, program, whole
from benchmarks.harness.jobs import configured
from benchmarks.harness.systems import Sampled, table_of

Size = tuple[int, int]
"""Rows and columns."""

ROWS: Final = 2_000


def curves(size: Size) -> tuple[FloatArray, FloatArray]:
    """Return times (R,) and states (S, R)."""
    rows, columns = size
    times = 0.01 * np.arange(rows, dtype=np.float64)
    if columns == 2:
        decay: FloatArray = np.exp(-times / times[-1])
        return times, np.array([decay * np.cos(times), -decay * np.sin(times)], dtype=np.float64)
    draw = np.random.default_rng(columns)
    rates, phases = draw.uniform(0.3, 2.0, (2, columns, 6))
    sines = [np.sin(np.outer(times, rate) + phase).sum(axis=1) for rate, phase in zip(rates, phases, strict=True)]
    return times, np.array(sines, dtype=np.float64)


def measured(size: Size, noise: float) -> tuple[float, float]:
    """Return processor seconds of preparing a table, and the most megabytes of this process."""
    times, states = curves(size)
    errors = np.random.default_rng(0).standard_normal(states.shape)
    noisy = states + 0.01 * noise * states.std(axis=1)[:, None] * errors
    names = tuple(f"x{place}" for place in range(len(states)))
    data = table_of(Sampled(names, (times,), (noisy.T,))).to_bytes()
    warm_up(lambda _: None)
    began = time.process_time()
    prepare_job(data, configured(0, {}, {}))
    return time.process_time() - began, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1000.0


@program(
    "benchmarks.operations.preparing_sizes",
    __doc__,
    option("--rows", type=whole, nargs="*", default=[], help="rows of tables of two states"),
    option("--columns", type=whole, nargs="*", default=[], help=f"states of tables of {ROWS} rows"),
    option("--noise", type=float, default=1.0, help="percent of each state's standard deviation (%(default)g)"),
)
def main(options: Namespace) -> None:
    """Measure and print."""
    for sizes in ([(rows, 2) for rows in options.rows], [(ROWS, columns) for columns in options.columns]):
        lines: list[tuple[str, ...]] = []
        before: tuple[Size, float] | None = None
        for size in sizes:
            with ProcessPoolExecutor(1, get_context("spawn")) as process:
                seconds, most = process.submit(measured, size, options.noise).result()
            exponent = "" if before is None else f"{_exponent(before, (size, seconds)):.2f}"
            lines.append((f"{size[0]}", f"{size[1]}", f"{seconds:.2f}", f"{most:.0f}", exponent))
            note(", ".join(lines[-1]))
            before = size, seconds
        if lines:
            say(table(("rows", "columns", "cpu s", "most MB", "exponent"), lines))


def _exponent(first: tuple[Size, float], second: tuple[Size, float]) -> float:
    (size, seconds), (larger, longer) = first, second
    return math.log(longer / seconds) / math.log(math.prod(larger) / math.prod(size))


if __name__ == "__main__":
    sys.exit(main())
