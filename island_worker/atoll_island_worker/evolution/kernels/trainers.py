"""Measure trainers, and find the individual that becomes a trainer next (Schmidt & Lipson 2008, section 2.3)."""

import numpy as np

from atoll_core.compilation.jit import kernel
from atoll_core.expression.kernels.tape import Int
from atoll_island_worker.evolution.kernels.generation import COEVOLUTION, residual_of_list
from atoll_island_worker.evolution.kernels.measured_rows import gather
from atoll_island_worker.evolution.kernels.predictors import INFINITY
from atoll_island_worker.evolution.structures import Coevolution, Fit, Ints, Lists, Rows, Scratch, Tape, Work


@kernel
def train(coevolution: Coevolution, t: Int, every: Rows, options: Fit, tape: Tape, work: Work, counters: Ints) -> None:
    """Measure trainer `t` on all rows: its loss at each row, and its exact loss (inf if a loss is not finite)."""
    residual_of_list(coevolution.trainers, t, every, options, tape, work)
    total = 0.0
    for r in range(every.length):
        e = work.residual[0, r]
        loss = abs(e) if options.loss == 0 else e * e
        coevolution.losses[t, r] = loss
        total += loss
    total /= every.length
    coevolution.exact[t] = total if np.isfinite(total) else INFINITY
    counters[COEVOLUTION] += every.length


@kernel
def most_disputed(
    lists: Lists,
    coevolution: Coevolution,
    every: Rows,
    rows: Rows,
    options: Fit,
    relative: Int,
    scratch: Scratch,
    counters: Ints,
) -> int:
    """Return the individual whose predicted losses have the largest variance over the predictors; -1 if none is finite.

    With `relative` 1 each loss is divided by the individual's mean loss. Every individual is evaluated on the rows of
    every predictor, and these evaluations are counted.
    """
    number = coevolution.quality.shape[0]
    size = coevolution.predictors.shape[1]
    best = -1
    widest = -1.0
    residual = scratch.near.residual
    for p in range(lists.code.shape[0]):
        total = 0.0
        square = 0.0
        for k in range(number):
            gather(rows, every, coevolution.predictors[k], scratch.near.functions)
            residual_of_list(lists, p, rows, options, scratch.tape, scratch.near)
            loss = 0.0
            for r in range(size):
                e = residual[0, r]
                loss += abs(e) if options.loss == 0 else e * e
            loss /= size
            total += loss
            square += loss * loss
        counters[COEVOLUTION] += number * size
        spread = square / number - (total / number) * (total / number)
        if relative == 1:
            spread = spread / ((total / number) * (total / number)) if total > 0.0 else 0.0
        if np.isfinite(spread) and spread > widest:
            widest = spread
            best = p
    return best
