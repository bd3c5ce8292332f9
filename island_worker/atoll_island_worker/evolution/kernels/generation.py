"""Generations of one island: pair, cross, mutate and fit; each child replaces its more similar parent if no worse.

This is deterministic crowding (Mahfoud 1995) as in the paper. Individuals are measured on the rows of the best fitness
predictor. Predictors and trainers coevolve between the generations (paper, section 2.3). Point evaluations are counted
by part.
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

OFFSPRING: Final = np.int64(0)  # the compiler would give a Python integer as an argument a type of its own
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
    """Write the target minus the output of individual `p` on `rows` into `work.residual`, without fitting."""
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
    """Return whether all variables whose bits are set in `required` are among the first `count` nodes of `tape`."""
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
    """Fit the constants of individual `p` to `rows` and write them into its list; return its loss on `rows`.

    The first value at each row is counted under `part`, further evaluations as constant fitting. `work.settled` is set
    if further steps would not improve the fit. `ceiling` is as in `fit`. An individual that lacks a required variable
    is not measured; its loss is infinity.
    """
    mark_live(lists, p, tape.bits)
    return develop_marked(lists, p, tape.bits, rows, options, ceiling, tape, work, result, counters, part)


@inlined
def develop_marked(
    lists: Lists, p: Int, live: Hashes, rows: Rows, options: Fit, ceiling: float, tape: Tape, work: Work,
    result: Floats, counters: Ints, part: Int,
) -> float:  # fmt: skip
    """Do the same as `develop`, with the live nodes of individual `p` already marked in `live`."""
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
    """Measure the whole population on `rows`, counted under `part`; constants are fitted as for a child.

    Without this fit, after a change of the predictor, a child with constants for the new rows would replace a better
    parent with constants for the old rows. Each change would remove most of the population.
    """
    for p in range(fitness.shape[0]):
        fitness[p] = develop(
            lists, p, rows, options, INFINITY, scratch.tape, scratch.near, scratch.result, counters, part
        )
        scratch.settled[p] = scratch.near.settled[0]


@kernel
def draw_coevolution(lists: Lists, coevolution: Coevolution, length: Int, stream: Stream) -> None:
    """Draw random predictors, with row indices below `length`, and random individuals as trainers, not measured yet."""
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
    """Return the row of `signature` that has the signature of child `q`; the child's output node comes from `base`.

    If no live node of parent `base` has changed in the child, both are the same program, and the row is the parent's.
    Otherwise the child's signature is written to a row of its own.
    """
    if is_unchanged(parents, base, children, q, live):
        return base
    own = np.int64(parents.code.shape[0]) + q
    sign(children, q, live[own], signature, own)
    return own


@inlined
def _copy_signature(signature: Ints, live: Hashes, i: Int, j: Int) -> None:
    """Copy row `i` of `signature` and of `live` to row `j`."""
    move(signature, j, signature, i, 0, signature.shape[1])
    move(live, j, live, i, 0, live.shape[1])


@inlined
def _distance(signature: Ints, i: Int, j: Int) -> int:
    return 0 if i == j else distance(signature, i, j)


@inlined
def _is_straight(first: Int, second: Int, signature: Ints, signed: Ints, apart: Ints) -> bool:
    """Return whether child 0 competes with parent `first` and child 1 with parent `second`; otherwise it is crosswise.

    The pairs are chosen so that the sum of their distances is smallest; if both sums are equal, they are not crosswise.
    `signed` (2,) are the rows of the children's signatures. `apart` (4,) receives the distances by signature: of child
    0 from the first and the second parent, then of child 1.
    """
    for q in range(2):
        apart[2 * q] = _distance(signature, first, signed[q])
        apart[2 * q + 1] = _distance(signature, second, signed[q])
    return bool(apart[0] + apart[3] <= apart[1] + apart[2])


@inlined
def _is_same(lists: Lists, p: Int, children: Lists, q: Int, signature: Ints, signed: Int, apart: Int) -> bool:
    """Return whether child `q` is the same program as individual `p`, constants included.

    `signed` is the row of the child's signature, `apart` its distance by signature from `p`.
    """
    if apart > 0:
        return False
    for k in range(signature.shape[1] if signed != p else 0):
        if signature[p, k] == CONSTANT + 1 and lists.constants[p, k] != children.constants[q, k]:
            return False
    return True


@inlined
def _inherits(lists: Lists, p: Int, children: Lists, q: Int, signature: Ints, signed: Int, apart: Int) -> bool:
    """Return whether child `q` is the same program as parent `p`; if so, it gets the parent's scaling."""
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
    """Advance the population on the `rows` of the best predictor, and the predictors, which choose from `length` rows.

    A child that is the same program as one of its parents is not measured again and not counted, unless its constants
    can still be fitted better. In preset `paper`, which fits nothing, every child is counted. Steps for constants are
    taken only for the few children that are much better than their worse parent without any steps (ADR 0014). The
    function returns after `generations`, or earlier when a trainer must be renewed or the best predictor has changed;
    `coevolution.due` says which.

    Returns:
        The number of generations done.
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
