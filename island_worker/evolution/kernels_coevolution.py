"""Coevolution of fitness predictors and trainers (Schmidt & Lipson, section 2.3 and Table II of the 2008 paper).

A predictor is a list of rows. It is as good as the loss it predicts agrees with the exact loss, on average over the
trainers. The losses of trainers at every row are kept, so that judging a predictor needs no further evaluation.
"""

import numpy as np

from common.jit import inlined, kernel
from island_worker.evolution.kernels_generation import (
    COEVOLUTION,
    INFINITY,
    REEVALUATION,
    generation,
    measure_all,
    residual_of_list,
)
from island_worker.evolution.kernels_random import Stream, below, uniform
from island_worker.evolution.kernels_rows import gather
from island_worker.evolution.kernels_variation import copy_list
from island_worker.evolution.structures import Coevolution, Coevolving, Fit, Floats, Ints, Lists, Rows, Scratch, Space

_ROW_MUTATION = 0.05


@kernel
def train(coevolution: Coevolution, t: int, every: Rows, options: Fit, scratch: Scratch, counters: Ints) -> None:
    """Measure trainer `t` on every row: its losses by row and its exact loss (inf when not finite anywhere)."""
    work = scratch.work
    residual_of_list(coevolution.trainers, t, every, options, scratch.tape, work)
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
def judge(coevolution: Coevolution, chosen: Ints) -> float:
    """Return the mean absolute difference of predicted and exact loss over the trainers that have one."""
    total = 0.0
    finite = 0
    for t in range(coevolution.exact.shape[0]):
        if not np.isfinite(coevolution.exact[t]):
            continue
        loss = 0.0
        for r in chosen:
            loss += coevolution.losses[t, r]
        total += abs(loss / chosen.shape[0] - coevolution.exact[t])
        finite += 1
    return total / finite if finite > 0 else INFINITY


@kernel
def judge_all(coevolution: Coevolution) -> bool:
    """Judge every predictor anew and choose the best, the present one in case of a tie; return True if it changed."""
    best = coevolution.best[0]
    for k in range(coevolution.quality.shape[0]):
        coevolution.quality[k] = judge(coevolution, coevolution.predictors[k])
    for k in range(coevolution.quality.shape[0]):
        if coevolution.quality[k] < coevolution.quality[best]:
            best = k
    changed = best != coevolution.best[0]
    coevolution.best[0] = best
    return changed


@inlined
def _shared(one: Ints, two: Ints) -> int:
    same = 0
    for k in range(one.shape[0]):
        if one[k] == two[k]:
            same += 1
    return same


@kernel
def predictor_generation(coevolution: Coevolution, rows: int, children: Ints, stream: Stream) -> bool:
    """Cross and mutate two predictors; each child replaces the more similar parent if no worse.

    Return True when the rows that measure the solutions changed.
    """
    number = coevolution.quality.shape[0]
    size = coevolution.predictors.shape[1]
    first = below(stream, number)
    second = (first + 1 + below(stream, number - 1)) % number
    cut = 1 + below(stream, size - 1)
    for k in range(size):
        a = coevolution.predictors[first, k]
        b = coevolution.predictors[second, k]
        children[0, k] = a if k < cut else b
        children[1, k] = b if k < cut else a
    for q in range(2):
        for k in range(size):
            if uniform(stream) < _ROW_MUTATION:
                children[q, k] = below(stream, rows)
    straight = _shared(children[0], coevolution.predictors[first]) + _shared(
        children[1], coevolution.predictors[second]
    )
    crossed = _shared(children[0], coevolution.predictors[second]) + _shared(children[1], coevolution.predictors[first])
    changed = False
    for q in range(2):
        parent = first if (q == 0) == (straight >= crossed) else second
        quality = judge(coevolution, children[q])
        if quality <= coevolution.quality[parent]:
            same = _shared(children[q], coevolution.predictors[parent]) == size
            for k in range(size):
                coevolution.predictors[parent, k] = children[q, k]
            coevolution.quality[parent] = quality
            if parent == coevolution.best[0] and not same:
                changed = True
            elif quality < coevolution.quality[coevolution.best[0]]:
                coevolution.best[0] = parent
                changed = True
    coevolution.clock[0] += 1
    return changed


@kernel
def most_disputed(
    lists: Lists,
    population: int,
    coevolution: Coevolution,
    every: Rows,
    rows: Rows,
    options: Fit,
    scratch: Scratch,
    counters: Ints,
) -> int:
    """Return the individual whose loss the predictors disagree on most (variance), -1 when none is finite.

    Every individual is evaluated at every row that a predictor names, and counted.
    """
    number = coevolution.quality.shape[0]
    size = coevolution.predictors.shape[1]
    best = -1
    widest = -1.0
    residual = scratch.near.residual
    for p in range(population):
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
        if np.isfinite(spread) and spread > widest:
            widest = spread
            best = p
    return best


@kernel
def renew_trainer(
    lists: Lists, population: int, coevolution: Coevolution, every: Rows, options: Fit, scratch: Scratch, counters: Ints
) -> bool:
    """Replace the oldest trainer by the most disputed individual; return True if the measuring rows changed."""
    chosen = most_disputed(lists, population, coevolution, every, scratch.spare, options, scratch, counters)
    if chosen < 0:
        return False
    oldest = 0
    for t in range(coevolution.born.shape[0]):
        if coevolution.born[t] < coevolution.born[oldest]:
            oldest = t
    copy_list(coevolution.trainers, oldest, lists, chosen)
    coevolution.born[oldest] = coevolution.clock[0]
    train(coevolution, oldest, every, options, scratch, counters)
    return judge_all(coevolution)


@kernel
def begin_coevolution(
    lists: Lists, coevolution: Coevolution, every: Rows, options: Fit, scratch: Scratch, stream: Stream, counters: Ints
) -> None:
    """Draw random predictors and take random individuals as trainers."""
    for k in range(coevolution.predictors.shape[0]):
        for i in range(coevolution.predictors.shape[1]):
            coevolution.predictors[k, i] = below(stream, every.length)
    for t in range(coevolution.exact.shape[0]):
        copy_list(coevolution.trainers, t, lists, below(stream, lists.code.shape[0]))
        coevolution.born[t] = t - coevolution.exact.shape[0]
        train(coevolution, t, every, options, scratch, counters)
    judge_all(coevolution)


@kernel
def use_best_predictor(
    lists: Lists,
    fitness: Floats,
    coevolution: Coevolution,
    every: Rows,
    rows: Rows,
    options: Fit,
    scratch: Scratch,
    counters: Ints,
) -> None:
    """Gather the best predictor's rows (all rows while predictors are off) and measure the population on them."""
    if rows.length < every.length:
        gather(rows, every, coevolution.predictors[coevolution.best[0]], scratch.near.functions)
    measure_all(lists, fitness, rows, options, scratch, counters, REEVALUATION)


@kernel
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
) -> None:
    """Advance the island by `generations`, predictors and trainers included.

    Predictors advance only while their counted share of all point evaluations is under `coevolving.effort`.
    """
    for _ in range(generations):
        generation(lists, fitness, space, options, rows, scratch, stream, counters)
        if coevolving.enabled == 0:
            continue
        total = 0
        for count in counters:
            total += count
        if counters[COEVOLUTION] >= coevolving.effort * total:
            continue
        changed = predictor_generation(coevolution, every.length, scratch.predictor_children, stream)
        if coevolution.clock[0] % coevolving.renewal == 0:
            changed = renew_trainer(lists, fitness.shape[0], coevolution, every, options, scratch, counters) or changed
        if changed:
            use_best_predictor(lists, fitness, coevolution, every, rows, options, scratch, counters)
