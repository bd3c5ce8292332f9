"""What guesses are worth: the work to find hard equations with a good guess, a part of the truth, a wrong one.

``python -m benchmarks.paper.guesses --seeds 0-4`` searches equations of the paper's seven systems, their derivatives
exact, and prints the median number of point evaluations until an equation is found, all islands together. A search that
needs more than ``--limit`` of them counts as that many.
"""

import sys
from argparse import Namespace
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from statistics import geometric_mean, median
from typing import Final

from atoll.terminal.output import count, note, say, table
from atoll_coordinator.service.jobs.defaults import resolve
from atoll_core.config import PRESETS, JobConfig, PriorConfig
from atoll_core.data.dataset import Dataset, Problem
from benchmarks.harness.command_line import option, positive, program, run_options
from benchmarks.harness.parallel import in_parallel
from benchmarks.harness.record import Record
from benchmarks.paper.archipelago import Archipelago
from benchmarks.paper.readings_runs import equation_problem

STRIDE: Final = 10
KINDS: Final = ("none", "form", "part", "wrong")


@dataclass(frozen=True)
class Guessed:
    """One equation and guesses for it: its `form` with other constants, a `part` of it, and a `wrong` one."""

    system: str
    variable: str
    form: str
    part: str
    wrong: str


EQUATIONS: Final = (
    Guessed("glider", "theta", "2*v - 3*cos(theta)/v", "v", "v*sin(theta) + theta"),
    Guessed("bacterial_respiration", "x", "5 - 2*x - x*y/(2 + x**2)", "20 - x", "x*(3 - y) + y**2/x"),
    Guessed("predator_prey", "x", "x*(1 - 2*x - 3*y/(2 + x))", "x*(4 - x)", "20 - x*y + sin(x)"),
    Guessed("predator_prey", "y", "y*(x/(3 + x) - 2*y)", "x*y/(1 + x)", "x - y*sin(x)"),
    Guessed("bar_magnets", "theta1", "2*sin(theta1 - theta2) - 3*sin(theta1)", "sin(theta1)", "theta1*(3 - theta2)"),
    Guessed("shear_flow", "phi", "(2*cos(phi)**2 + sin(phi)**2)*sin(theta)", "sin(theta)", "phi - theta*cos(phi)"),
    Guessed("van_der_pol", "x", "y - x**3 + x", "y - x", "x*sin(y) + cos(x)"),
)


@dataclass(frozen=True)
class Task:
    """One search: the place of the equation in `EQUATIONS`, the kind of guess, the seed, most point evaluations."""

    equation: int
    kind: str
    seed: int
    limit: float


@dataclass(frozen=True)
class Found:
    """How a search ended: `evaluations` of the task's limit when nothing was found."""

    task: Task
    evaluations: float
    has_hit: bool


def config_of(guessed: Guessed, kind: str, seed: int, problem: Problem) -> JobConfig:
    """Return the resolved configuration of a search that begins with that kind of guess."""
    guesses = {} if kind == "none" else {guessed.variable: (str(getattr(guessed, kind)),)}
    config = PRESETS["default"].model_copy(update={"seed": seed, "prior": PriorConfig(guesses=guesses)})
    symbols = {name: name for name in problem.names}
    return resolve(config, Dataset(problem.names, problem.inputs, (problem.target,), symbols))


def search(task: Task) -> Found:
    """Search until an island meets the target or the limit is reached."""
    guessed = EQUATIONS[task.equation]
    problem = equation_problem(guessed.system, guessed.variable, task.seed)
    archipelago = Archipelago(problem, config_of(guessed, task.kind, task.seed, problem))
    for stride in archipelago.strides(STRIDE):
        if any(entry.error <= 1e-9 * problem.target.standard_deviation for entry in stride.additions):
            return Found(task, stride.evaluations, True)
        if stride.evaluations > task.limit:
            break
    return Found(task, task.limit, False)


def rows(results: Sequence[Found]) -> Iterator[tuple[str, ...]]:
    """Yield the table's rows: for each equation the medians by kind of guess, then their geometric means."""
    medians: dict[str, list[float]] = {kind: [] for kind in KINDS}
    for index, guessed in enumerate(EQUATIONS):
        cells = [f"{guessed.system} {guessed.variable}"]
        for kind in KINDS:
            its = [result for result in results if (result.task.equation, result.task.kind) == (index, kind)]
            medians[kind].append(median(each.evaluations for each in its))
            cells.append(f"{count(medians[kind][-1])} ({sum(each.has_hit for each in its)} of {len(its)})")
        yield tuple(cells)
    yield ("geometric mean", *(count(geometric_mean(medians[kind])) for kind in KINDS))


@program(
    "benchmarks.paper.guesses",
    __doc__,
    *run_options("0-4"),
    option("--limit", type=positive, default=3e8, help="point evaluations of one search (%(default)g)"),
)
def main(options: Namespace) -> None:
    """Run the benchmark and print its table."""
    figures = Record("guesses", options.words, options.out)
    tasks = [
        Task(index, kind, seed, options.limit)
        for index in range(len(EQUATIONS))
        for kind in KINDS
        for seed in options.seeds
    ]
    results = []
    for found in in_parallel(search, tasks, options.workers):
        results.append(found)
        its = found.task
        note(f"{EQUATIONS[its.equation].system} {its.kind} seed {its.seed}: {count(found.evaluations)}")
    say(table(("equation", *KINDS), list(rows(results))))
    figures.write(
        results=[vars(result.task) | {"evaluations": result.evaluations, "found": result.has_hit} for result in results]
    )


if __name__ == "__main__":
    sys.exit(main())
