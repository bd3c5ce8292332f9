"""How well the counted work of an integration agrees with its time, for each method.

``python -m benchmarks.operations.counted_work TITLE ...`` refines stored pools (of ``benchmarks.pools``) by one thread
of this process, and notes the processor time and the counted work of each integration. It prints nanoseconds per unit
of work for each method: total, median, and the range that has nine in ten integrations. `SETTINGS.effort.work` limits
the work, so a limit is a fair limit of time if all methods and tables have about the same nanoseconds.
"""

import sys
import time
from argparse import Namespace
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np

from atoll.terminal.output import say, table
from atoll_coordinator.model import pipeline
from atoll_coordinator.model.shooting.integration import Integration, Integrator, Method
from atoll_coordinator.model.shooting.system import OdeSystem
from atoll_coordinator.tasks.preparing import prepare_job
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.kernels.tape import Ints
from benchmarks.harness.command_line import option, program
from benchmarks.pools.campaign import POOLS
from benchmarks.pools.cases import Folders, job_of
from benchmarks.pools.stored import file_of, read_pools

METHODS: Final = {3: "quick", 6: "precise"}
"""Names of the explicit methods by evaluations of the rates in a step."""

Noted = dict[str, list[tuple[float, int]]]
"""Nanoseconds and counted work of integrations, by method."""


@contextmanager
def noting(noted: Noted) -> Iterator[None]:
    """Note each integration of this process that reaches its end."""
    original = Integrator.integrate

    def integrate(
        self: Integrator, method: Method, system: OdeSystem, segments: Ints, starts: FloatArray, **options: Any
    ) -> Integration:
        began = time.thread_time_ns()
        course = original(self, method, system, segments, starts, **options)
        took = time.thread_time_ns() - began
        states, columns = len(system.outputs), course.sensitivities.shape[2]
        numbers = states * (1 + columns) if len(course.sensitivities) else states
        if course.done == len(segments):
            work = method.work(course.steps, self.measurements.rows, numbers)
            noted.setdefault(METHODS.get(method.evaluations, "implicit"), []).append((took, work))
        return course

    Integrator.integrate = integrate  # type: ignore[method-assign]
    try:
        yield
    finally:
        Integrator.integrate = original  # type: ignore[method-assign]


@program(
    "benchmarks.operations.counted_work",
    __doc__,
    option("titles", nargs="+", help="titles of stored pools"),
    option("--cases", type=Path, metavar="DIR", help="tables with cases.json"),
)
def main(options: Namespace) -> None:
    """Refine, and print a line for each method of each pool."""
    lines = []
    for title in options.titles:
        pools, job = read_pools(file_of(POOLS, title)), job_of(title, Folders(options.cases))
        prepared, _ = prepare_job(job.table.to_bytes(), job.config)
        pipeline.refine_all(prepared.preparation, prepared.config, pools, laws=prepared.laws)  # loads kernels
        noted: Noted = {}
        with noting(noted):
            pipeline.refine_all(prepared.preparation, prepared.config, pools, laws=prepared.laws)
        for method, pairs in sorted(noted.items()):
            took, work = np.array(pairs, dtype=np.float64).T
            low, median, high = np.quantile(took / work, [0.05, 0.5, 0.95])
            spread = (f"{took.sum() / work.sum():.1f}", f"{median:.1f}", f"{low:.1f} to {high:.1f}")
            lines.append((title, method, f"{len(took)}", f"{took.sum() / 1e9:.2f}", *spread))
    say(table(("pool", "method", "integrations", "cpu s", "ns per unit", "median", "nine in ten"), lines))


if __name__ == "__main__":
    sys.exit(main())
