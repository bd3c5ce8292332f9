"""Solutions, predictors and trainers in turn (Schmidt & Lipson, section 2.3 and Table II of the 2008 paper).

What kernels do for many generations stops where a trainer is to be renewed or the population measured on other rows:
both are rare, and apart from the generations they are compiled apart.
"""

import numpy as np

from atoll_core.expression.kernels.tape import functions_address
from atoll_island_worker.evolution.kernels.generation import REEVALUATION, advance, draw_coevolution, measure_all
from atoll_island_worker.evolution.kernels.measured_rows import gather
from atoll_island_worker.evolution.kernels.predictors import judge_all
from atoll_island_worker.evolution.kernels.random import Stream
from atoll_island_worker.evolution.kernels.trainers import most_disputed, train
from atoll_island_worker.evolution.setup import IslandSetup
from atoll_island_worker.evolution.structures import Coevolution, Floats, Ints, Lists


def begin_coevolution(
    setup: IslandSetup, lists: Lists, coevolution: Coevolution, stream: Stream, counters: Ints
) -> None:
    """Draw random predictors and take random individuals as trainers."""
    draw_coevolution(lists, coevolution, setup.every.length, stream)
    for t in range(len(coevolution.exact)):
        train(coevolution, t, setup.every, setup.fit, setup.scratch.tape, setup.scratch.work, counters)
    judge_all(coevolution, setup.coevolving.relative)


def measure_population(
    setup: IslandSetup, lists: Lists, fitness: Floats, coevolution: Coevolution, counters: Ints, part: np.int64
) -> None:
    """Gather the best predictor's rows (all rows while predictors are off) and measure the population on them."""
    if setup.coevolving.enabled:
        gather(setup.rows, setup.every, coevolution.predictors[coevolution.best[0]], functions_address())
    setup.call(measure_all, lists, fitness, setup.rows, setup.fit, setup.scratch, counters, part)


def renew_trainer(setup: IslandSetup, lists: Lists, coevolution: Coevolution, counters: Ints) -> bool:
    """Replace the oldest trainer by the most disputed individual; return True if the measuring rows changed."""
    relative, scratch = setup.coevolving.relative, setup.scratch
    disputed = int(
        setup.call(
            most_disputed, lists, coevolution, setup.every, scratch.spare, setup.fit, relative, scratch, counters
        )
    )
    if disputed < 0:
        return False
    oldest = int(np.argmin(coevolution.born))
    individuals = lists._asdict().values()
    for column, values in zip(coevolution.trainers._asdict().values(), individuals, strict=True):
        column[oldest] = values[disputed]
    coevolution.born[oldest] = coevolution.clock[0]
    train(coevolution, oldest, setup.every, setup.fit, scratch.tape, scratch.work, counters)
    return bool(judge_all(coevolution, relative))


def evolve(
    setup: IslandSetup, generations: int, lists: Lists, fitness: Floats, coevolution: Coevolution, stream: Stream,
    counters: Ints,
) -> None:  # fmt: skip
    """Advance the island by `generations`, predictors and trainers included.

    Predictors advance only while their counted share of all point evaluations is under `coevolving.effort`.
    """
    done = 0
    while done < generations:
        done += int(
            setup.call(
                advance, generations - done, lists, fitness, coevolution, setup.space, setup.fit, setup.coevolving,
                setup.every.length, setup.rows, setup.scratch, stream, counters,
            )
        )  # fmt: skip
        renews, changed = coevolution.due.tolist()
        if renews:
            changed = renew_trainer(setup, lists, coevolution, counters) or changed
        if changed:
            measure_population(setup, lists, fitness, coevolution, counters, REEVALUATION)
