"""Readings of the paper: under which of them do its published figures come out?

``python -m benchmarks.paper.readings --reading paper --reading seldom+scaled --resume runs.jsonl`` runs rows of Table I
and equations of Table III under each reading (`benchmarks.paper.readings_runs`), one island after the other in this
process, on several processes. A run of Table III has converged when an equation on its front has the right form with
constants within 1 %, one of Table I when its error at 1,000 fresh points is below 1e-6; nothing is refined. The journal
holds every run, so that a second call goes on where the first one ended, within a run, too.

Of Table I the budget is not published. So the table gives, for rows that were compared with one publication and
therefore have one budget, the range of budgets at which each row agrees with the paper's column within its binomial
error, and the budget at which most of them do.
"""

import itertools
import math
import sys
from argparse import Namespace
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from atoll.terminal.output import clipped, count, note, say, table
from benchmarks.harness.command_line import option, positive, program, run_options, seeds
from benchmarks.harness.journal import Journal
from benchmarks.harness.parallel import in_parallel
from benchmarks.harness.tables import grouped
from benchmarks.paper.published import ROWS
from benchmarks.paper.readings_runs import TABLE_III, Run, Task, run
from benchmarks.paper.table1 import difference
from benchmarks.paper.table3 import EQUATIONS, PAPER

BUDGETS: Final = {
    "PSAW": ("quintic", "sextic"),
    "PSAW, hits": ("quintic hits", "sextic hits"),
    "grammars": ("P2", "P3", "P4", "P5", "cos2x"),
}
"""Rows of Table I that were compared with one publication, and so were given one budget."""

SIGNIFICANT: Final = 1.96
PAPER_COSTS: Final = {f"{system} {variable}": PAPER[system, variable][1] for system, variable in EQUATIONS}


def known(journal: Journal[Run], task: Task) -> Run | None:
    """Return what came of a task, known also from the same run with a larger budget, or None."""
    same = (run for run in journal.outcomes.values() if _same(run.task, task))
    return next((run for run in same if run.task.budget >= task.budget or run.cost is not None), None)


def _same(one: Task, other: Task) -> bool:
    return (one.reading, one.problem, one.seed) == (other.reading, other.problem, other.seed)


def tasks(options: Namespace) -> list[Task]:
    """Return all runs that are asked for: by reading, then by problem."""
    asked = itertools.product(options.reading, options.problem or (*TABLE_III, *_rows()))
    return [
        Task(reading, problem, seed, budget_of(problem, options))
        for reading, problem in asked
        for seed in (options.row_seeds if problem in ROWS else options.seeds)
    ]


def _rows() -> list[str]:
    return [name for names in BUDGETS.values() for name in names]


def budget_of(problem: str, options: Namespace) -> int:
    """Return the point evaluations of a run: of Table III a multiple of the paper's, of Table I a number."""
    if problem in ROWS:
        return int(options.row_budget)
    return int(min(options.share * PAPER_COSTS[problem], options.most))


def _running(journal: Path | None) -> Callable[[Task], Run]:
    """Return what runs a task; beside a `journal`, runs that were interrupted go on where they were."""
    if journal is None:
        return run
    folder = journal.with_name(journal.name + ".states")
    folder.mkdir(exist_ok=True)
    return partial(run, folder=folder)


def _told(its: Run) -> str:
    task = its.task
    end = "not converged" if its.cost is None else f"converged at {count(its.cost)}"
    return f"{task.reading}, {task.problem}, seed {task.seed}: {end}, error {its.error:.1e}, {its.seconds:.1f} s"


def _show(runs: Sequence[Run]) -> None:
    for reading, group in grouped(runs, lambda run: run.task.reading).items():
        say(f"\nreading {reading}")
        rows = list(equation_rows(group))
        if rows:
            say(table(("equation", "converged", "median", "paper", "share", "s", "first found"), rows))
        for name, problems in BUDGETS.items():
            _show_budget(name, [its for its in group if its.task.problem in problems])


def equation_rows(runs: Sequence[Run]) -> Iterable[tuple[str, ...]]:
    """Yield what came of each equation of Table III; a run that did not converge costs infinitely much."""
    for problem in TABLE_III:
        group = [its for its in runs if its.task.problem == problem]
        if not group:
            continue
        costs = [math.inf if its.cost is None else float(its.cost) for its in group]
        median = float(np.median(costs))
        found = next((its.expression for its in group if its.expression), None)
        yield (
            problem,
            f"{sum(map(math.isfinite, costs))} of {len(group)}",
            count(median) if math.isfinite(median) else "-",
            count(PAPER_COSTS[problem]),
            f"{median / PAPER_COSTS[problem]:.3f}" if math.isfinite(median) else "-",
            f"{np.median([its.seconds for its in group]):.1f}",
            clipped(found or f"least error {min(its.error for its in group):.1e}", 70),
        )


def _show_budget(name: str, runs: Sequence[Run]) -> None:
    if not runs:
        return
    budget, agreeing = best_budget(runs)
    problems = grouped(runs, lambda run: run.task.problem)
    say(f"{name}: {agreeing} of {len(problems)} rows agree at {count(budget)}")
    rows = []
    for problem, group in problems.items():
        first, last = agreement(group)
        at, end = share(group, budget), share(group, math.inf)
        paper = f"{ROWS[problem].paper:g}"
        rows.append((problem, str(len(group)), f"{at:.0f}", f"{end:.0f}", paper, _range(first, last)))
    say(table(("row", "runs", "% there", "% at the end", "paper", "agrees at"), rows))


def _range(first: float, last: float) -> str:
    if math.isinf(first):
        return "no budget"
    return f"{count(first)} to {'the end' if math.isinf(last) else count(last)}"


def share(runs: Sequence[Run], budget: float) -> float:
    """Return the percentage of runs that converged within `budget`."""
    return 100.0 * sum(its.cost is not None and its.cost <= budget for its in runs) / len(runs)


def agrees(runs: Sequence[Run], budget: float) -> bool:
    """Whether the share converged within `budget` cannot be told from the paper's (5 %, both binomial errors)."""
    row = ROWS[runs[0].task.problem]
    return abs(difference(share(runs, budget), len(runs), row.paper, row.runs)) < SIGNIFICANT


def _steps(runs: Iterable[Run]) -> list[float]:
    return sorted({0.0, *(float(its.cost) for its in runs if its.cost is not None)})


def agreement(runs: Sequence[Run]) -> tuple[float, float]:
    """Return the least budget at which a row agrees, and the one from which on it no longer does; inf for never."""
    steps = _steps(runs)
    met = [budget for budget in steps if agrees(runs, budget)]
    if not met:
        return math.inf, math.inf
    return met[0], min((budget for budget in steps if budget > met[-1]), default=math.inf)


def best_budget(runs: Sequence[Run]) -> tuple[float, int]:
    """Return the least budget at which most rows agree with the paper, and how many do."""
    groups = [[its for its in runs if its.task.problem == name] for name in {its.task.problem for its in runs}]
    counted = [(sum(agrees(group, budget) for group in groups), -budget) for budget in _steps(runs)]
    most, least = max(counted)
    return -least, most


@program(
    "benchmarks.paper.readings",
    __doc__,
    option("--reading", action="append", required=True, help="names joined by +; repeat for several"),
    option(
        "--problem", action="append", choices=(*TABLE_III, *ROWS), help="repeat for several; default: all but densities"
    ),
    option("--share", type=positive, default=2.0, help="budget, in the paper's evaluations (%(default)g)"),
    option("--most", type=positive, default=1e12, help="point evaluations of a run at most (%(default)g)"),
    option("--row-budget", type=positive, default=3e6, help="the same for rows of Table I (%(default)g)"),
    option("--row-seeds", type=seeds, default=seeds("0-29"), help="of rows of Table I (0-29)"),
    option("--resume", type=Path, metavar="FILE", help="journal of JSON lines, gone on with if it exists"),
    *run_options("0-1"),
)
def main(options: Namespace) -> int:
    """Run what the journal does not hold, print the tables; return 0."""
    resume = options.resume is not None and options.resume.exists()
    journal = Journal("readings", Run, options.resume, options.words, resume=resume)
    asked = tasks(options)
    missing = [task for task in asked if known(journal, task) is None]
    for number, each in enumerate(
        in_parallel(_running(options.resume), missing, options.workers) if missing else (), start=1
    ):
        journal.add(each)
        note(f"{number} of {len(missing)}: {_told(each)}")
    runs = [its for task in asked if (its := known(journal, task)) is not None]
    _show(runs)
    return 0


if __name__ == "__main__":
    sys.exit(main())
