"""Solutions, predictors and trainers in turn (Schmidt & Lipson, section 2.3 and Table II of the 2008 paper).

What kernels do for many generations stops where a trainer is to be renewed or the population measured on other rows:
both are rare, and apart from the generations they are compiled apart.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from atoll_core.expression.kernels.tape import functions_address
from atoll_island_worker.evolution.kernels.generation import REEVALUATION, advance, draw_coevolution, measure_all
from atoll_island_worker.evolution.kernels.measured_rows import gather
from atoll_island_worker.evolution.kernels.predictors import judge_all
from atoll_island_worker.evolution.kernels.random import Stream
from atoll_island_worker.evolution.kernels.trainers import most_disputed, train
from atoll_island_worker.evolution.structures import (
    Coevolution,
    Coevolving,
    Fit,
    Floats,
    Ints,
    Lists,
    Rows,
    Scratch,
    Space,
)

Caller = Callable[..., Any]
"""Calls a kernel with its arguments, whose types numba knows."""


def call_plainly(function: Callable[..., Any], *arguments: Any) -> Any:
    """Call a kernel; see `IslandSetup.call` for what saves time."""
    return function(*arguments)


def begin_coevolution(
    lists: Lists,
    coevolution: Coevolution,
    every: Rows,
    options: Fit,
    relative: int,
    scratch: Scratch,
    stream: Stream,
    counters: Ints,
) -> None:
    """Draw random predictors and take random individuals as trainers."""
    draw_coevolution(lists, coevolution, every.length, stream)
    for t in range(len(coevolution.exact)):
        train(coevolution, t, every, options, scratch.tape, scratch.work, counters)
    judge_all(coevolution, relative)


def use_best_predictor(
    lists: Lists,
    fitness: Floats,
    coevolution: Coevolution,
    every: Rows,
    rows: Rows,
    options: Fit,
    scratch: Scratch,
    counters: Ints,
    call: Caller = call_plainly,
) -> None:
    """Gather the best predictor's rows (all rows while predictors are off) and measure the population on them."""
    if rows.length < every.length:
        gather(rows, every, coevolution.predictors[coevolution.best[0]], functions_address())
    call(measure_all, lists, fitness, rows, options, scratch, counters, REEVALUATION)


def renew_trainer(
    lists: Lists,
    coevolution: Coevolution,
    every: Rows,
    options: Fit,
    relative: int,
    scratch: Scratch,
    counters: Ints,
    call: Caller = call_plainly,
) -> bool:
    """Replace the oldest trainer by the most disputed individual; return True if the measuring rows changed."""
    disputed = int(call(most_disputed, lists, coevolution, every, scratch.spare, options, relative, scratch, counters))
    if disputed < 0:
        return False
    oldest = int(np.argmin(coevolution.born))
    solutions = lists._asdict().values()
    for column, values in zip(coevolution.trainers._asdict().values(), solutions, strict=True):
        column[oldest] = values[disputed]
    coevolution.born[oldest] = coevolution.clock[0]
    train(coevolution, oldest, every, options, scratch.tape, scratch.work, counters)
    return bool(judge_all(coevolution, relative))


def evolve(
    generations: int,
    lists: Lists,
    fitness: Floats,
    coevolution: Coevolution,
    space: Space,
    options: Fit,
    coevolving: Coevolving,
    every: Rows,
    rows: Rows,
    scratch: Scratch,
    stream: Stream,
    counters: Ints,
    call: Caller = call_plainly,
) -> None:
    """Advance the island by `generations`, predictors and trainers included.

    Predictors advance only while their counted share of all point evaluations is under `coevolving.effort`. `call`
    calls a kernel with its arguments.
    """
    done = 0
    while done < generations:
        done += int(
            call(
                advance, generations - done, lists, fitness, coevolution, space, options, coevolving, every.length,
                rows, scratch, stream, counters,
            )
        )  # fmt: skip
        renews, changed = coevolution.due.tolist()
        if renews:
            changed = (
                renew_trainer(lists, coevolution, every, options, coevolving.relative, scratch, counters, call)
                or changed
            )
        if changed:
            use_best_predictor(lists, fitness, coevolution, every, rows, options, scratch, counters, call)
