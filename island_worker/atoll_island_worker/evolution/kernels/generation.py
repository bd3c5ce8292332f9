"""Generations of one island: pair, cross, mutate, fit, and let each child replace its more similar parent if no worse.

Deterministic crowding (Mahfoud 1995) as the paper has it, measured on the best fitness predictor's rows, with the
coevolution of predictors and trainers (paper, section 2.3) in between. Point evaluations are counted by part.
"""

from typing import Final

import numpy as np

from atoll_core.compilation.jit import inlined, kernel
from atoll_core.expression.kernels.lanes import move
from atoll_core.expression.kernels.tape import Int, forward
from atoll_core.expression.operators import CONSTANT, VARIABLE
from atoll_island_worker.evolution.kernels.fit import collect_terms, fit, measure_plainly, residual_of
from atoll_island_worker.evolution.kernels.predictors import predictor_generation
from atoll_island_worker.evolution.kernels.random import Stream, below
from atoll_island_worker.evolution.kernels.tape import compile_live, compile_tape, mark_live, sign
from atoll_island_worker.evolution.kernels.variation import (
    copy_list,
    cross,
    distance,
    is_unchanged,
    mutate,
    random_list,
)
from atoll_island_worker.evolution.structures import (
    MOST_REQUIRED,
    Coevolution,
    Coevolving,
    Fit,
    Floats,
    Hashes,
    Ints,
    Lists,
    Rows,
    Scratch,
    Space,
    Tape,
    Work,
)

OFFSPRING: Final = np.int64(0)  # a plain integer would be a type of its own to the compiler, as an argument
REEVALUATION: Final = np.int64(1)
FITTING: Final = 2
REFITTING: Final = 3
COEVOLUTION: Final = 4
PARTS: Final = ("offspring", "reevaluation", "constant_fitting", "refitting", "coevolution")
"""Names of the counters, in the order of their array."""

INFINITY = np.inf
_ZERO: Final = np.int64(0)
_ONE: Final = np.int64(1)


@inlined
def residual_of_list(lists: Lists, p: Int, rows: Rows, options: Fit, tape: Tape, work: Work) -> None:
    """Write the target less the output of individual `p`, as it stands, on `rows` into `work.residual`."""
    count = compile_tape(lists, p, tape)
    number = collect_terms(tape, count, options.terms, work.terms)
    for i in range(count):
        tape.wanted[i] = True
    forward(
        count, tape.code, tape.left, tape.right, tape.constants, tape.wanted, rows.inputs, rows.waves, rows.length,
        work.values, work.functions,
    )  # fmt: skip
    residual_of(number, rows, work, lists.scale[p])


@inlined
def has_required(tape: Tape, count: Int, required: Int) -> bool:
    """Tell whether all variables whose bits are set in `required` are among the first `count` nodes of `tape`."""
    present = _ZERO
    for i in range(count):
        if tape.code[i] == VARIABLE and tape.left[i] < MOST_REQUIRED:
            present |= _ONE << tape.left[i]
    return (present & required) == required


@inlined
def develop(
    lists: Lists, p: Int, rows: Rows, options: Fit, ceiling: float, tape: Tape, work: Work, result: Floats,
    counters: Ints, part: Int,
) -> float:  # fmt: skip
    """Fit the constants of individual `p` to `rows`, write them back, count; return its loss there.

    The first value at each row is counted under `part`, the rest as constant fitting. `work.settled` tells whether
    further steps would be of no use; see `fit` for `ceiling`. An individual that lacks a required variable is not
    measured.
    """
    mark_live(lists, p, tape.bits)
    return develop_marked(lists, p, tape.bits, rows, options, ceiling, tape, work, result, counters, part)


@inlined
def develop_marked(
    lists: Lists, p: Int, live: Hashes, rows: Rows, options: Fit, ceiling: float, tape: Tape, work: Work,
    result: Floats, counters: Ints, part: Int,
) -> float:  # fmt: skip
    """Do what `develop` does with individual `p`, whose live nodes are marked in `live`."""
    if options.required != 0 and not has_required(tape, compile_live(lists, p, live, tape), options.required):
        work.settled[0] = True
        return INFINITY
    counters[part] += rows.length
    if options.steps == 0 and options.terms == 0:
        measure_plainly(lists, p, live, rows, work, result)
        return result[options.loss]
    count = compile_live(lists, p, live, tape)
    used = fit(tape, count, rows, options, rows.length // 4, options.steps, ceiling, work, lists.scale[p], result)
    counters[FITTING] += used - rows.length
    for i in range(count if used > rows.length else 0):
        if tape.code[i] == CONSTANT:
            lists.constants[p, tape.origin[i]] = tape.constants[i]
    return result[options.loss]


@kernel
def measure_all(
    lists: Lists, fitness: Floats, rows: Rows, options: Fit, scratch: Scratch, counters: Ints, part: Int
) -> None:
    """Measure the whole population on `rows`, constants fitted there as a child's are, and count it.

    After a change of predictor a child whose constants suit the new rows would otherwise displace a better parent
    whose constants suit the old ones: a change would be a purge.
    """
    for p in range(fitness.shape[0]):
        fitness[p] = develop(
            lists, p, rows, options, INFINITY, scratch.tape, scratch.near, scratch.result, counters, part
        )
        scratch.settled[p] = scratch.near.settled[0]


@kernel
def draw_coevolution(lists: Lists, coevolution: Coevolution, length: Int, stream: Stream) -> None:
    """Draw random predictors of `length` rows and take random individuals as trainers, not yet measured."""
    for k in range(coevolution.predictors.shape[0]):
        for i in range(coevolution.predictors.shape[1]):
            coevolution.predictors[k, i] = below(stream, length)
    for t in range(coevolution.exact.shape[0]):
        copy_list(coevolution.trainers, t, lists, below(stream, lists.code.shape[0]))
        coevolution.born[t] = t - coevolution.exact.shape[0]


@kernel
def random_population(lists: Lists, space: Space, stream: Stream) -> None:
    """Draw every list at random."""
    for p in range(lists.code.shape[0]):
        random_list(lists, p, space, stream)


@inlined
def _shuffle(order: Ints, stream: Stream) -> None:
    for last in range(order.shape[0] - 1, 0, -1):
        other = below(stream, last + 1)
        kept = order[last]
        order[last] = order[other]
        order[other] = kept


@inlined
def _sign_child(parents: Lists, base: Int, children: Lists, q: Int, signature: Ints, live: Hashes) -> Int:
    """Return the row of the signature of child `q`, whose output is that of parent `base`: the parent's or its own.

    It is the parent's where no node that is live there has changed; the child is the same program then.
    """
    if is_unchanged(parents, base, children, q, live):
        return base
    own = np.int64(parents.code.shape[0]) + q
    sign(children, q, live[own], signature, own)
    return own


@inlined
def _copy_signature(signature: Ints, live: Hashes, i: Int, j: Int) -> None:
    """Copy row `i` of both to row `j`."""
    move(signature, j, signature, i, 0, signature.shape[1])
    move(live, j, live, i, 0, live.shape[1])


@inlined
def _distance(signature: Ints, i: Int, j: Int) -> int:
    return 0 if i == j else distance(signature, i, j)


@inlined
def _is_straight(first: Int, second: Int, signature: Ints, signed: Ints, apart: Ints) -> bool:
    """Return whether the two children face the parents they began as; the children are signed at rows `signed`.

    Parents and children are matched by their distances; a tie goes uncrossed. `apart` comes to be the distances by
    signature of child 0 and then of child 1 from first and second parent.
    """
    for q in range(2):
        apart[2 * q] = _distance(signature, first, signed[q])
        apart[2 * q + 1] = _distance(signature, second, signed[q])
    return bool(apart[0] + apart[3] <= apart[1] + apart[2])


@inlined
def _is_same(lists: Lists, p: Int, children: Lists, q: Int, signature: Ints, signed: Int, apart: Int) -> bool:
    """Return whether child `q`, signed at row `signed` and so far `apart`, computes just what individual `p` does."""
    if apart > 0:
        return False
    for k in range(signature.shape[1] if signed != p else 0):
        if signature[p, k] == CONSTANT + 1 and lists.constants[p, k] != children.constants[q, k]:
            return False
    return True


@inlined
def _inherits(lists: Lists, p: Int, children: Lists, q: Int, signature: Ints, signed: Int, apart: Int) -> bool:
    """Return whether child `q` computes just what parent `p` does; its scaling is then the parent's."""
    if not _is_same(lists, p, children, q, signature, signed, apart):
        return False
    for j in range(lists.scale.shape[1]):
        children.scale[q, j] = lists.scale[p, j]
    return True


@kernel
def advance(
    generations: Int,
    lists: Lists,
    fitness: Floats,
    coevolution: Coevolution,
    space: Space,
    options: Fit,
    coevolving: Coevolving,
    length: Int,
    rows: Rows,
    scratch: Scratch,
    stream: Stream,
    counters: Ints,
) -> int:
    """Advance the population on the current predictor's `rows`, and the predictors of the `length` rows in all.

    A child that computes what one of its parents does is not measured again (and not counted), unless its constants
    can still be fitted better; in preset `paper`, which fits nothing, every child is counted all the same. Steps for
    constants are spent on the few children that are much better than their worse parent already without them (ADR
    0014). Return after so many generations, or sooner when a trainer is to be renewed or the best predictor has
    changed: `coevolution.due` tells which.

    Returns:
        The generations done.
    """
    order, due = scratch.order, coevolution.due
    children, tape, near, result = scratch.children, scratch.tape, scratch.near, scratch.result
    signature, live, loss = scratch.signature, scratch.live, scratch.child_loss
    signed, apart = scratch.signed, scratch.apart
    child_settled, settled = scratch.child_settled, scratch.settled
    due[0] = due[1] = False
    inherits = options.terms > 0 or options.steps > 0
    population = order.shape[0]
    for p in range(population):
        sign(lists, p, live[p], signature, p)
    for done in range(generations):
        for p in range(population):
            order[p] = p
        _shuffle(order, stream)
        for pair in range(0, order.shape[0], 2):
            first, second = order[pair], order[pair + 1]
            base = cross(children, lists, first, second, space, stream)
            for q in range(2):
                mutate(children, q, space, stream)
            for q in range(2):
                signed[q] = _sign_child(lists, base if q == 0 else first + second - base, children, q, signature, live)
            is_straight = _is_straight(first, second, signature, signed, apart)
            ceiling = options.gate * max(fitness[first], fitness[second])
            for q in range(2):
                child_settled[q] = True
                one, two = apart[2 * q], apart[2 * q + 1]
                if settled[first] and _inherits(lists, first, children, q, signature, signed[q], one):
                    loss[q] = fitness[first]
                    counters[OFFSPRING] += 0 if inherits else rows.length
                elif settled[second] and _inherits(lists, second, children, q, signature, signed[q], two):
                    loss[q] = fitness[second]
                    counters[OFFSPRING] += 0 if inherits else rows.length
                else:
                    loss[q] = develop_marked(
                        children, q, live[signed[q]], rows, options, ceiling, tape, near, result, counters, OFFSPRING
                    )
                    child_settled[q] = near.settled[0]
            for q in range(2):
                p = first if (q == 0) == is_straight else second
                if loss[q] <= fitness[p]:
                    if q == 0 and signed[1] == p:  # the second child's signature is about to be overwritten
                        signed[1] = population + 1
                        _copy_signature(signature, live, p, population + 1)
                    copy_list(lists, p, children, q)
                    if signed[q] != p:
                        _copy_signature(signature, live, signed[q], p)
                    fitness[p] = loss[q]
                    settled[p] = child_settled[q]
        total = 0
        for count in counters:
            total += count
        if coevolving.enabled == 0 or counters[COEVOLUTION] >= coevolving.effort * total:
            continue
        due[1] = predictor_generation(coevolution, coevolving.relative, length, scratch.predictor_children, stream)
        due[0] = coevolution.clock[0] % coevolving.renewal == 0
        if due[0] or due[1]:
            return done + 1
    return int(generations)
