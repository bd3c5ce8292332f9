"""Choose individuals to be measured on all rows, and fit their constants there."""

from typing import Final

import numpy as np

from atoll_core.compilation.jit import inlined, kernel
from atoll_core.expression.kernels.tape import Int, forward
from atoll_core.expression.operators import ADD, CONSTANT, MULTIPLY, NEGATE, SUBTRACT
from atoll_island_worker.evolution.kernels.fit import errors, fit, residual_of
from atoll_island_worker.evolution.kernels.generation import INFINITY, REFITTING
from atoll_island_worker.evolution.kernels.tape import canonical_tape, compile_tape
from atoll_island_worker.evolution.structures import Book, Fit, Floats, Hashes, Ints, Lists, Rows, Scratch, Tape, Work

SIMPLE = 1e-4
"""A coefficient that differs from 1 or -1 by less than this is also tried as 1 or -1."""

WITHOUT_SHIFT: Final = 1
"""Bit of a variant: b is left out."""
SIMPLE_COEFFICIENTS: Final = 2
"""Bit of a variant: coefficients close to 1 or -1 are exactly that, see `SIMPLE`."""

_SAME: Final = 1e-6
"""If the predicted losses of two individuals differ by no more than this share, they count as the same function."""

_ZERO: Final = np.int64(0)
_ONE: Final = np.int64(1)
_PRIME = np.uint64(0x100000001B3)
_BASIS = np.uint64(0xCBF29CE484222325)


@inlined
def _mixed(h: np.uint64, value: int) -> np.uint64:
    return (h ^ np.uint64(value + 1)) * _PRIME


@kernel
def structure_hash(tape: Tape, count: int) -> np.uint64:
    """Return a hash of the first `count` nodes of a program without its constants (FNV-1a over nodes)."""
    h = _BASIS
    for i in range(count):
        h = _mixed(_mixed(_mixed(h, tape.code[i]), tape.left[i]), tape.right[i])
    return h


@kernel
def canonical(lists: Lists, p: int, scratch: Scratch) -> int:
    """Write individual `p`, without its scaling, as a canonical program to `scratch.canonical`; return its size."""
    count = compile_tape(lists, p, scratch.tape)
    return canonical_tape(scratch.tape, count, scratch.work, scratch.canonical)


@kernel
def choose_offers(
    lists: Lists, fitness: Floats, scratch: Scratch, offered: Hashes, offered_loss: Floats, offers: Ints
) -> int:
    """List in `offers` the best individual of each size if it is better than all smaller ones; return their number.

    An individual is left out if its structure was the last one offered at this size, unless its predicted loss is less
    than half the loss at that offer. `offered` (sizes,) uint64, hashes, and `offered_loss` (sizes,) are updated.
    """
    best = scratch.best_of_size
    for n in range(best.shape[0]):
        best[n] = -1
    for p in range(fitness.shape[0]):
        if not np.isfinite(fitness[p]):
            continue
        n = canonical(lists, p, scratch)
        scratch.hashes[p] = structure_hash(scratch.canonical, n)
        if best[n] < 0 or fitness[p] < fitness[best[n]]:
            best[n] = p
    count = 0
    least = INFINITY
    for n in range(best.shape[0]):
        p = best[n]
        if p < 0 or not fitness[p] < least:
            continue
        least = fitness[p]
        if offered[n] == scratch.hashes[p] and not fitness[p] < 0.5 * offered_loss[n]:
            continue
        offered[n] = scratch.hashes[p]
        offered_loss[n] = fitness[p]
        offers[count] = p
        count += 1
    return count


@kernel
def choose_near(
    lists: Lists, fitness: Floats, order: Ints, most: int, scratch: Scratch, known: Hashes, offers: Ints, count: int
) -> int:
    """Add the next best individuals of each size to the `count` individuals in `offers`; return the new number.

    At most `most` individuals of each size are taken, in the order of their losses. An individual is not taken if its
    loss equals the loss of the last one taken, see `_SAME`. A taken individual is added to `offers` unless its
    structure is known.

    Args:
        order: (P,) individuals by rising loss.
        known: hashes of known structures, uint64, updated; the length is a power of two. The last bits of a hash are
            its index, and a new hash replaces the one at its index. All individuals in `offers` enter the table.
    """
    taken, last = scratch.taken, scratch.best_of_size
    mask = np.uint64(known.shape[0] - 1)
    for n in range(taken.shape[0]):
        taken[n] = 0
        last[n] = -1
    for c in range(count):
        hashed = scratch.hashes[offers[c]]
        known[np.int64(hashed & mask)] = hashed
    for k in range(order.shape[0]):
        p = order[k]
        if not np.isfinite(fitness[p]):
            break
        n = canonical(lists, p, scratch)
        place = np.int64(scratch.hashes[p] & mask)
        if taken[n] >= most or (last[n] >= 0 and fitness[p] <= fitness[last[n]] * (1.0 + _SAME)):
            continue
        last[n] = p
        taken[n] += 1
        if known[place] != scratch.hashes[p]:
            known[place] = scratch.hashes[p]
            offers[count] = p
            count += 1
    return count


@kernel
def refit(
    count: int,
    rows: Rows,
    options: Fit,
    steps: int,
    tape: Tape,
    work: Work,
    scale: Floats,
    result: Floats,
    counters: Ints,
) -> None:
    """Fit the program on `tape` (`count` nodes) to `rows`, in place, and count it; `work` then has its terms."""
    counters[REFITTING] += fit(tape, count, rows, options, rows.length // 4, steps, INFINITY, work, scale, result)


@inlined
def loss_of(result: Floats, options: Fit) -> float:
    """Return the loss in the target's units, from mean absolute and mean squared error, `result` (2,)."""
    return result[0] if options.loss == 0 else np.sqrt(result[1])


@inlined
def _coefficient(book: Book, k: Int, j: Int, variant: Int) -> float:
    """Return coefficient a_j of program `k` in this variant, see `Book.variants`."""
    a = book.scale[k, j]
    is_simple = variant & SIMPLE_COEFFICIENTS > 0 and abs(abs(a) - 1.0) < SIMPLE
    return (1.0 if a > 0.0 else -1.0) if is_simple else a


@inlined
def _shift(book: Book, k: Int, variant: Int) -> float:
    """Return b of program `k` in this variant."""
    return book.scale[k, 0] if variant & WITHOUT_SHIFT == 0 else 0.0


@inlined
def _measure_variants(count: int, rows: Rows, options: Fit, tape: Tape, work: Work, book: Book, k: int) -> None:
    """Write the loss of each variant of the coefficients in book.scale[k] to book.variants[k], see `Book.variants`."""
    for i in range(count):
        tape.wanted[i] = True
    forward(
        count, tape.code, tape.left, tape.right, tape.constants, tape.wanted, rows.inputs, rows.waves, rows.length,
        work.values, work.functions,
    )  # fmt: skip
    number = book.number[k]
    trial = work.kept_scale
    for variant in range(book.variants.shape[1]):
        for j in range(1, 1 + number):
            trial[j] = _coefficient(book, k, j, variant)
        trial[0] = _shift(book, k, variant)
        residual_of(number, rows, work, trial)
        errors(rows, work, work.trial)
        book.variants[k, variant] = loss_of(work.trial, options)


@kernel
def refit_offers(
    lists: Lists,
    offers: Ints,
    number: int,
    rows: Rows,
    options: Fit,
    steps: int,
    scratch: Scratch,
    least: Floats,
    slack: float,
    book: Book,
    counters: Ints,
) -> int:
    """Fit the first `number` individuals in `offers` to all `rows`; write the good ones to `book`; return their number.

    An individual is good if its loss is below least[size], `least` (sizes,), for example the least loss so far of
    programs that are no larger. Steps are not taken if the loss after fitting the coefficients is more than `slack`
    times least[size], because steps rarely reduce it by so much.
    """
    work, tape = scratch.work, scratch.canonical
    count = 0
    for c in range(number):
        size = canonical(lists, offers[c], scratch)
        scale = book.scale[count]
        ceiling = slack * least[size] if slack < INFINITY else INFINITY
        if options.loss > 0:
            ceiling *= ceiling
        counters[REFITTING] += fit(
            tape, size, rows, options, rows.length // 4, steps, ceiling, work, scale, scratch.result
        )
        loss = loss_of(scratch.result, options)
        if not loss < least[size]:
            continue
        book.size[count] = size
        book.loss[count] = loss
        book.number[count] = work.number[0] if options.terms > 0 else 0
        for j in range(book.number[count]):
            book.terms[count, j] = work.terms[j]
        for i in range(size):
            book.code[count, i] = tape.code[i]
            book.left[count, i] = tape.left[i]
            book.right[count, i] = tape.right[i]
            book.constants[count, i] = tape.constants[i]
        if options.terms > 0:
            _measure_variants(size, rows, options, tape, work, book, count)
            counters[REFITTING] += rows.length
        count += 1
    return count


@inlined
def _append_node(tape: Tape, count: Int, op: Int, left: Int, right: Int, constant: float) -> Int:
    """Append a node to the `count` nodes on `tape`; return the new number of nodes."""
    tape.code[count] = op
    tape.left[count] = left
    tape.right[count] = right
    tape.constants[count] = constant
    return count + 1


@inlined
def _append_term(tape: Tape, count: Int, top: Int, node: Int, a: float) -> Int:
    """Append the nodes of ``top + a * node`` (of ``a * node`` if `top` is negative); return the new number of nodes.

    The output is the last node, except for a term with coefficient 1 and no `top`: then it is `node`.
    """
    size = abs(a) if top >= 0 else a
    if size == -1.0:
        count = _append_node(tape, count, NEGATE, node, _ZERO, 0.0)
        node = count - 1
    elif size != 1.0:
        count = _append_node(tape, count, CONSTANT, _ZERO, _ZERO, size)
        count = _append_node(tape, count, MULTIPLY, node, count - 1, 0.0)
        node = count - 1
    if top >= 0:
        count = _append_node(tape, count, np.int64(ADD if a > 0.0 else SUBTRACT), top, node, 0.0)
    return count


@inlined
def combine(tape: Tape, count: Int, book: Book, k: Int, variant: Int) -> Int:
    """Append b + a_1 t_1 + ... to program `k`, whose `count` nodes are on `tape`; return the index of the output.

    Zero coefficients and a zero b are left out. A positive term comes first if there is one, so that negative terms
    become differences.
    """
    top: Int = -_ONE
    for negative in range(2):
        for j in range(book.number[k]):
            a = _coefficient(book, k, j + 1, variant)
            if a == 0.0 or (a < 0.0) != (negative == 1):
                continue
            appended = _append_term(tape, count, top, book.terms[k, j], a)
            top = book.terms[k, j] if appended == count else appended - 1
            count = appended
    shift = _shift(book, k, variant)
    if top < 0:
        return _append_node(tape, count, CONSTANT, _ZERO, _ZERO, shift) - 1
    if shift != 0.0:
        count = _append_node(tape, count, CONSTANT, _ZERO, _ZERO, shift)
        return _append_node(tape, count, ADD, top, count - 1, 0.0) - 1
    return top


@kernel
def write_variant(book: Book, k: int, variant: int, scratch: Scratch) -> int:
    """Write program `k` of `book` with its coefficients to `scratch.canonical`; return its number of nodes.

    A negative `variant` leaves all coefficients out; others are as in `Book.variants`.
    """
    tape, count = scratch.tape, book.size[k]
    for i in range(count):
        _append_node(tape, i, book.code[k, i], book.left[k, i], book.right[k, i], book.constants[k, i])
    output = count - 1 if variant < 0 else combine(tape, count, book, k, variant)
    return canonical_tape(tape, output + 1, scratch.work, scratch.canonical)
