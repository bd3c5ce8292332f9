"""The seven systems of Table III, noise-free: how many of the 14 equations are found exactly, and in what time.

``python -m benchmarks.paper.seven --step 0.02 --seeds 0-4`` generates each system with data seed k, searches it with
seed k on a coordinator and two workers, and compares each equation with the truth. ``--extras`` searches a pendulum
known by its angle alone, and a Lotka-Volterra system in micro- and mega-units with times around 1900.

A run in which a trajectory passes a singularity is flagged and judged by its function error alone: the derivative of
an interpolating quintic spline is then off by more than `SINGULAR` of the true derivative's deviation, on average.
"""

import dataclasses
import sys
from argparse import Namespace
from collections.abc import Callable
from functools import partial
from typing import Final

import numpy as np
from scipy.interpolate import make_interp_spline

from atoll_coordinator.data.prepare import prepare
from benchmarks.harness.command_line import option, program, search_options
from benchmarks.harness.jobs import configured
from benchmarks.harness.report import Report
from benchmarks.harness.service import Searches, searching
from benchmarks.harness.systems import SYSTEMS, TABLE_III, TRUTH, FloatArray, Sampled, table_of, trajectories
from benchmarks.judging.verdict import Question, judged

SINGULAR: Final = 1e-3
SCALES: Final = (1e-6, 1e6)
OFFSET: Final = 1900.0
SCALED_TRUTH: Final = {
    "x": f"3*x - {2 / SCALES[1]!r}*x*y - {1 / SCALES[0]!r}*x**2",
    "y": f"2*y - {1 / SCALES[0]!r}*x*y - {1 / SCALES[1]!r}*y**2",
}


@dataclasses.dataclass(frozen=True, eq=False)
class Case:
    """One search: what is measured, and the truth by variable."""

    name: str
    seed: int
    sampled: Sampled
    truths: dict[str, str]
    singular: frozenset[str]
    order: int = 1


def case(system: str, step: float, seed: int) -> Case:
    """Return a system of Table III with data and search seed `seed`."""
    sampled = trajectories(system, step, seed)
    return Case(system, seed, sampled, TRUTH[system], singular(system, sampled))


def pendulum(step: float, seed: int) -> Case:
    """Return the damped pendulum of which only the angle is measured."""
    truths = {"theta": TRUTH["pendulum"]["theta_dot"]}
    return Case("pendulum", seed, trajectories("pendulum", step, seed), truths, frozenset(), order=2)


def scaled(step: float, seed: int) -> Case:
    """Return Lotka-Volterra with x in units of 1e6, y in units of 1e-6 and times that begin at 1900."""
    plain = trajectories("lotka_volterra", step, seed)
    times = tuple(each + OFFSET for each in plain.times)
    values = tuple(value * np.array(SCALES) for value in plain.values)
    return Case("lotka_volterra scaled", seed, Sampled(plain.names, times, values), SCALED_TRUTH, frozenset())


def singular(system: str, sampled: Sampled) -> frozenset[str]:
    """Return the states of `system` that an interpolating quintic spline does not follow."""
    slopes = [_field(system, values) for values in sampled.values]
    deviation = np.concatenate(slopes).std(axis=0)
    errors = [
        np.abs(make_interp_spline(times, values, k=5, axis=0).derivative()(times) - slope)
        for times, values, slope in zip(sampled.times, sampled.values, slopes, strict=True)
    ]
    relative = np.concatenate(errors).mean(axis=0) / deviation
    return frozenset(name for name, error in zip(sampled.names, relative, strict=True) if not error <= SINGULAR)


def _field(system: str, values: FloatArray) -> FloatArray:
    return np.array([SYSTEMS[system].field(*state) for state in values])


def search(searches: Searches, case: Case, max_time: float, report: Report) -> None:
    """Search one case and add the verdicts on its equations to `report`."""
    config = configured(case.seed, {"order": case.order}, {"max_time": max_time})
    table = table_of(case.sampled)
    result = searches.solve(f"{case.name} seed {case.seed}", table, config)
    question = Question(case.name, case.seed, case.truths, prepare(table, config).dataset, case.singular)
    report.add(judged(question, result))


@program(
    "benchmarks.paper.seven",
    __doc__,
    option("--step", type=float, default=0.02, help="sampling step (%(default)s; the paper's is 0.1)"),
    option("--system", choices=TABLE_III, action="append", help="repeat for several; default: all seven"),
    option("--extras", action="store_true", help="the pendulum and the scaled system instead"),
    *search_options("0-4", 120.0),
)
def main(options: Namespace) -> int:
    """Search all cases, print the table; return 0 when every equation was found, else 1."""
    report = Report("seven", options.words, options.out)
    makers: list[Callable[[float, int], Case]] = [partial(case, name) for name in options.system or TABLE_III]
    if options.extras:
        makers = [pendulum, scaled]
    with searching(options.workers) as searches:
        for make in makers:
            for seed in options.seeds:
                search(searches, make(options.step, seed), options.max_time, report)
    report.show()
    return 0 if all(verdict.found for verdict in report.verdicts) else 1


if __name__ == "__main__":
    sys.exit(main())
