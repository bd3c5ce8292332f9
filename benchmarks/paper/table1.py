"""Table I of the paper: how often a search converges within the point evaluations of published algorithms.

``python -m benchmarks.paper.table1 --out table1.json`` runs the rows of `benchmarks.paper.published` with both presets.
A run has converged by the metric of the publication compared with, as far as it is known: the error of an equation on
its front is below 0.01 at each of its own points (rows of grammars), else below 1e-6 at each of 1,000 fresh points in
range; it ends then, or when its point evaluations are used up. Everything is counted: offspring, fits, refits,
coevolution, all islands. An island is looked at every few generations, and what it has used by then counts.

Preset ``paper`` is judged by whether its share can be told from the paper's own (two-sided, 5 %, by the binomial
deviations of both).
"""

import itertools
import math
import os
import sys
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Final

import numpy as np

from atoll.terminal.output import count, note, say, table
from atoll_core.config import PRESETS, Preset
from atoll_core.data.dataset import FloatArray
from atoll_core.expression.evaluation import values_of
from atoll_core.expression.program import Program
from atoll_core.expression.text.infix import to_infix
from atoll_core.machine import usable_cores
from atoll_core.search.pareto import FrontEntry
from benchmarks.harness.command_line import OUT, option, program, seeds, whole, workers
from benchmarks.harness.parallel import in_parallel
from benchmarks.harness.record import Record
from benchmarks.paper.archipelago import Archipelago, configured, problem_of
from benchmarks.paper.published import FRESH, HIT, LARGEST_ERROR, ROWS, Row

TARGET_ERROR: Final = 1e-13
"""Normalized error at which an island stops by itself: below what a wrong equation can have on so few points."""

UNSOLVED: Final = 1e-6
"""Mean error on its own points from which on an equation is not tried on fresh ones."""

HEADS: Final = ("row", "preset", "runs", "converged %", "at", "%", "median", "most", "paper", "others", "")


@dataclass(frozen=True)
class Task:
    """One run: names of row and preset, seed, and a budget of point evaluations."""

    row: str
    preset: Preset
    seed: int
    budget: int


@dataclass(frozen=True)
class Run:
    """How it ended: `evaluations` until it converged, or all it used; `expression` only where it converged."""

    task: Task
    converged: bool
    evaluations: int
    generations: int
    expression: str | None
    complexity: int | None


def run(task: Task) -> Run:
    """Search until convergence or the end of the budget. Pure: the seed decides everything."""
    row = ROWS[task.row]
    x, fresh = row.points(task.seed, "points", row.rows), row.points(task.seed, "fresh points", FRESH)
    config = configured(
        task.preset, task.seed, row.operators, TARGET_ERROR, islands=row.islands, refit_interval=row.interval
    )
    for stride in Archipelago(problem_of(x, row.values(x)), config).strides(row.interval):
        if stride.evaluations > task.budget:
            break
        right = next((right for entry in stride.additions if (right := converged(row, entry, x, fresh))), None)
        if right is not None:
            return Run(task, True, stride.evaluations, stride.generations, to_infix(right, ("x",)), len(right))
    return Run(task, False, stride.evaluations, stride.generations, None, None)


def converged(row: Row, entry: FrontEntry, x: FloatArray, fresh: FloatArray) -> Program | None:
    """Return the program of `entry` when the row's metric counts it, else None; `x` are the points it was found on."""
    if not entry.error < (HIT if row.counts_hits else UNSOLVED):
        return None
    program = Program.from_bytes(entry.program, 1)
    points, limit = (x, HIT) if row.counts_hits else (fresh, LARGEST_ERROR)
    return program if largest_error(program, points, row.values(points)) < limit else None


def largest_error(program: Program, x: FloatArray, values: FloatArray) -> float:
    """Return the largest error of `program` at `x`, inf where it is not finite."""
    with np.errstate(all="ignore"):
        errors = np.abs(values_of(program, x[np.newaxis]) - values)
    return float(errors.max()) if np.isfinite(errors).all() else math.inf


@dataclass(frozen=True)
class Summary:
    """A row and a preset over all their runs. Percentages are of all runs; evaluations those of converged ones."""

    row: str
    preset: str
    runs: int
    converged: float
    marked: float
    median: float | None
    most: float | None
    deviations: float | None
    """By how many standard deviations the share differs from the paper's."""
    is_met: bool
    """Preset ``default``: at or above the better published figure. Preset ``paper``: not to be told from the paper."""


def summary(row: Row, preset: str, runs: Sequence[Run]) -> Summary:
    """Return the figures of `runs`, at least one."""
    costs = sorted(run.evaluations for run in runs if run.converged)
    share = 100.0 * len(costs) / len(runs)
    most = float(costs[-1]) if len(costs) == len(runs) else None
    deviations = None if row.is_cost else difference(share, len(runs), row.paper, row.runs)
    if row.is_cost:
        is_met = most is not None and most < row.bar
    else:
        is_met = share >= row.bar if preset != "paper" else deviations is not None and abs(deviations) < 1.96
    return Summary(
        row.name,
        preset,
        len(runs),
        share,
        100.0 * sum(cost <= row.marked for cost in costs) / len(runs),
        float(np.median(costs)) if costs else None,
        most,
        deviations,
        is_met,
    )


def difference(share: float, runs: int, other: float, others: int) -> float:
    """Return the difference of two percentages in its standard deviations, by the pooled share; 0 for equal ones."""
    pooled = (share * runs + other * others) / (100.0 * (runs + others))
    deviation = 100.0 * math.sqrt(pooled * (1.0 - pooled) * (1.0 / runs + 1.0 / others))
    return (share - other) / deviation if deviation > 0.0 else 0.0


def cells(summed: Summary) -> tuple[str, ...]:
    """Return the row of the table under `HEADS`."""
    row = ROWS[summed.row]
    show = count if row.is_cost else "{:g}".format
    told = "below" if row.is_cost else ("as published" if summed.preset == "paper" else "at or above")
    return (
        row.name,
        summed.preset,
        str(summed.runs),
        f"{summed.converged:.1f}",
        count(row.marked),
        f"{summed.marked:.1f}",
        count(summed.median),
        count(summed.most),
        show(row.paper),
        ", ".join(f"{name} {show(value)}" for name, value in row.others.items()),
        told if summed.is_met else f"NOT {told}",
    )


def tasks(options: Namespace) -> list[Task]:
    """Return all runs that are asked for, row by row."""
    asked = itertools.product(options.row or ROWS, options.preset or PRESETS)
    return [
        Task(name, preset, seed, options.evaluations or ROWS[name].budget)
        for name, preset in asked
        for seed in (options.seeds if options.seeds is not None else range(ROWS[name].runs))
    ]


def _group(task: Task) -> tuple[str, Preset]:
    return task.row, task.preset


def _say_end(group: Sequence[Run]) -> None:
    task = group[0].task
    note(f"{task.row}, preset {task.preset}: {sum(one.converged for one in group)} of {len(group)} runs converged")


@program(
    "benchmarks.paper.table1",
    __doc__,
    option("--row", choices=ROWS, action="append", help="repeat for several; default: all"),
    option("--preset", choices=PRESETS, action="append", help="default: both"),
    option("--evaluations", type=whole, help="point evaluations of a run, instead of the row's"),
    option("--seeds", type=seeds, help="such as 0-9, instead of as many runs as in the paper"),
    workers(usable_cores(os.environ)[0], "processes"),
    OUT,
)
def main(options: Namespace) -> int:
    """Run all rows and print the table; return 0 when preset ``default`` reached every published figure, else 1."""
    figures = Record("table1", options.words, options.out)
    asked = tasks(options)
    sizes = {key: len(list(group)) for key, group in itertools.groupby(asked, _group)}
    groups: dict[tuple[str, Preset], list[Run]] = {key: [] for key in sizes}
    for ended in in_parallel(run, asked, options.workers):
        group = groups[_group(ended.task)]
        group.append(ended)
        if len(group) == sizes[_group(ended.task)]:
            group.sort(key=lambda one: one.task.seed)
            _say_end(group)
            figures.write(runs=[asdict(one) for done in groups.values() for one in done])
    summaries = [summary(ROWS[name], preset, group) for (name, preset), group in groups.items()]
    figures.write(
        summaries=[asdict(summed) for summed in summaries],
        rows=[asdict(ROWS[name]) for name in dict.fromkeys(name for name, _ in groups)],
        runs=[asdict(one) for group in groups.values() for one in group],
    )
    say(table(HEADS, [cells(summed) for summed in summaries]))
    say(f"\n{len(asked)} runs in {figures.seconds():.0f} s on {options.workers} processes")
    return 0 if all(summed.is_met for summed in summaries if summed.preset == "default") else 1


if __name__ == "__main__":
    sys.exit(main())
