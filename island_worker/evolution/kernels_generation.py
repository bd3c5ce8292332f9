"""Generations of one island: pair, cross, mutate, fit, and let each child replace its more similar parent if no worse.

Deterministic crowding (Mahfoud 1995) as the paper has it, measured on the best fitness predictor's rows, with the
coevolution of predictors and trainers (paper, section 2.3) in between. Point evaluations are counted by part.
"""

from typing import Final

import numpy as np

from common.expression.kernels import Int, forward
from common.jit import inlined, kernel
from island_worker.evolution.kernels_fit import collect_terms, combine_into, fit
from island_worker.evolution.kernels_random import Stream, below
from island_worker.evolution.kernels_tape import compile_tape, mark_live
from island_worker.evolution.kernels_variation import copy_list, cross, distance, mutate
from island_worker.evolution.structures import Fit, Floats, Ints, Lists, Rows, Scratch, Space, Tape, Work

OFFSPRING: Final = np.int64(0)  # a plain integer would be a type of its own to the compiler, as an argument
REEVALUATION: Final = np.int64(1)
FITTING: Final = 2
REFITTING: Final = 3
COEVOLUTION: Final = 4
PARTS: Final = ("offspring", "reevaluation", "constant_fitting", "refitting", "coevolution")
"""Names of the counters, in the order of their array."""

INFINITY = np.inf


@kernel
def output_of(lists: Lists, p: int, rows: Rows, options: Fit, tape: Tape, work: Work) -> None:
    """Write the output of individual `p`, as it stands, on `rows` into `work.output`."""
    count = compile_tape(lists.code[p], lists.left[p], lists.right[p], lists.constants[p], tape)
    number = collect_terms(tape, count, options.terms, work.terms)
    forward(count, tape.code, tape.left, tape.right, tape.constants, rows.inputs, rows.length, work.values)
    combine_into(work.output, work.values, work.terms, number, lists.scale[p], rows.length)


@kernel
def develop(
    lists: Lists, p: int, rows: Rows, options: Fit, tape: Tape, work: Work, result: Floats, counters: Ints, part: Int
) -> float:
    """Fit the constants of individual `p` to `rows`, write them back, count; return its loss there.

    The first value at each row is counted under `part`, the rest as constant fitting.
    """
    count = compile_tape(lists.code[p], lists.left[p], lists.right[p], lists.constants[p], tape)
    most = rows.length // 4
    used = fit(tape, count, rows, options, most, options.steps, work, lists.scale[p], result)
    counters[part] += rows.length
    counters[FITTING] += used - rows.length
    if options.steps > 0:
        for i in range(count):
            lists.constants[p, tape.origin[i]] = (
                tape.constants[i] if tape.code[i] == 1 else lists.constants[p, tape.origin[i]]
            )
    return result[options.loss]


@kernel
def remeasure(
    lists: Lists, fitness: Floats, rows: Rows, options: Fit, tape: Tape, work: Work, result: Floats, counters: Ints
) -> None:
    """Measure the whole population on new predictor rows, constants fitted there as a child's are, and count it.

    Without the fit, a child whose constants suit the new rows would displace a better parent whose constants suit the
    old ones: a change of predictor would be a purge.
    """
    for p in range(fitness.shape[0]):
        fitness[p] = develop(lists, p, rows, options, tape, work, result, counters, REEVALUATION)


@inlined
def _shuffle(order: Ints, stream: Stream) -> None:
    for last in range(order.shape[0] - 1, 0, -1):
        other = below(stream, last + 1)
        kept = order[last]
        order[last] = order[other]
        order[other] = kept


@kernel
def _crowd(parents: Lists, fitness: Floats, pair: Ints, children: Lists, child_fitness: Floats, live: Ints) -> None:
    """Let the two children meet the more similar parents; a tie goes uncrossed; replace when no worse."""
    for q in range(2):
        p = pair[q]
        mark_live(parents.code[p], parents.left[p], parents.right[p], live[q])
        mark_live(children.code[q], children.left[q], children.right[q], live[2 + q])
    straight = distance(parents, pair[0], live[0], children, 0, live[2])
    straight += distance(parents, pair[1], live[1], children, 1, live[3])
    crossed = distance(parents, pair[0], live[0], children, 1, live[3])
    crossed += distance(parents, pair[1], live[1], children, 0, live[2])
    for q in range(2):
        p = pair[q] if straight <= crossed else pair[1 - q]
        if child_fitness[q] <= fitness[p]:
            copy_list(parents, p, children, q)
            fitness[p] = child_fitness[q]


@kernel
def generation(
    lists: Lists,
    fitness: Floats,
    space: Space,
    options: Fit,
    rows: Rows,
    scratch: Scratch,
    stream: Stream,
    counters: Ints,
) -> None:
    """Advance the population by one generation on the current predictor's `rows`."""
    order = scratch.order
    for p in range(order.shape[0]):
        order[p] = p
    _shuffle(order, stream)
    for first in range(0, order.shape[0], 2):
        scratch.pair[0] = order[first]
        scratch.pair[1] = order[first + 1]
        cross(scratch.children, lists, order[first], order[first + 1], space, stream)
        for q in range(2):
            mutate(scratch.children, q, space, stream)
            scratch.child_fitness[q] = develop(
                scratch.children, q, rows, options, scratch.tape, scratch.work, scratch.result, counters, OFFSPRING
            )
        _crowd(lists, fitness, scratch.pair, scratch.children, scratch.child_fitness, scratch.live)
