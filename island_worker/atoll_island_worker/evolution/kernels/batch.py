"""Losses of many operation lists at once, as they stand: the same bits as one list after the other, in less time.

One list has seven live nodes, and its evaluation mostly waits: for the next node to be known, for branches that no
processor foresees. A batch of lists gives it other work meanwhile.

1. The live nodes of four lists at a time are collected, operators and terminals apart.
2. Every operator is put on the chain of its operator and level, which is one more than its arguments'. Nodes that
   depend on constants alone have chains of their own.
3. Chain after chain is evaluated, level by level. What depends on constants alone is the same at all rows, so that a
   block holds `LANES` such nodes instead of the rows of one. A sine or cosine of an input is looked up when the rows
   keep it.
4. Each list's output is compared with the target.

A node is named by its *slot*: the list's place in the batch, followed by the node's index in the low `shift` bits. All
numbers lie in rows of one table: inputs, their sines, their cosines, and a row for each live terminal and operator.
Indices are unsigned, which saves the question whether they count from the end. What the batch knows of a node is packed
in one word: row (20 bits), whether it is an input (bit 23), whether it varies from row to row (bit 24), level (from bit
25 on). A link of a chain, one for each live operator, is the rows of both arguments (20 bits each) and the next link's
number. Lists have at most 16,000 nodes.
"""

from typing import Final

import numpy as np

from atoll.compilation.jit import inlined, kernel
from atoll.expression.kernels.lanes import (
    fill,
    highest_bit,
    lowest_bit,
    multiply,
    place,
    subtract,
    total,
    total_magnitude,
)
from atoll.expression.kernels.tape import LANES, Int
from atoll.expression.operators import ARITY, VARIABLE
from atoll_island_worker.evolution.kernels.chains import (
    BATCH,
    CHAINS,
    END,
    INPUT,
    NEXT,
    ROW,
    SECOND,
    Batch,
    empty_batch,
    evaluate_chains,
    load_rows,
)
from atoll_island_worker.evolution.kernels.tape import mark_live
from atoll_island_worker.evolution.structures import Floats, Lists, Rows

_INFINITY: Final = np.inf
_START: Final = np.int64(0)
_ZERO: Final = np.uint64(0)
_ONE: Final = np.uint64(1)
_VARIES: Final = np.uint64(1 << 24)
_LEVEL: Final = np.uint64(1 << 25)
_HALF: Final = np.uint64(32)
_LOW: Final = np.uint64((1 << 32) - 1)
_LEVELS: Final = np.uint64((1 << 64) - (1 << 25))
_IS_BINARY = np.array([arity > 1 for arity in ARITY], np.uint64)
_ALL_IF_BINARY = np.array([(1 << 64) - 1 if arity > 1 else 0 for arity in ARITY], np.uint64)
"""All bits where an operator has a second argument."""


@inlined
def _take(lists: Lists, p: np.uint64, i: np.uint64, slot: np.uint64, count: np.uint64, batch: Batch) -> np.uint64:
    """Put operator `i` of list `p` at place `count` of the operators; return it. `slot` is that of node 0."""
    op = np.uint64(lists.code[p, i])
    batch.nodes[count] = slot | i | (op << _HALF)
    batch.arguments[count] = slot | np.uint64(lists.left[p, i]) | ((slot | np.uint64(lists.right[p, i])) << _HALF)
    return op


@inlined
def _step(
    lists: Lists, p: np.uint64, slot: np.uint64, waiting: np.uint64, count: np.uint64, batch: Batch
) -> tuple[np.uint64, np.uint64]:
    """Take the highest of the `waiting` operators of list `p`, if any; return what waits then, and the new count."""
    i = np.uint64(highest_bit(waiting | _ONE))
    is_live = np.uint64(waiting != _ZERO)
    op = _take(lists, p, i, slot, count, batch)
    waiting &= ~(_ONE << i)
    waiting |= is_live << np.uint64(lists.left[p, i])
    waiting |= (is_live & _IS_BINARY[op]) << np.uint64(lists.right[p, i])
    return waiting, count + is_live


@inlined
def _take_terminals(live: np.uint64, slot: np.uint64, count: np.uint64, batch: Batch) -> np.uint64:
    """Append the terminals whose bits are set; return the new count."""
    while live != _ZERO:
        batch.terminals[count] = slot | np.uint64(lowest_bit(live))
        live &= live - _ONE
        count += _ONE
    return count


@inlined
def _collect(lists: Lists, first: Int, number: Int, terminals: Int, batch: Batch) -> tuple[np.uint64, np.uint64]:
    """Collect the live nodes of `number` lists of at most 64 nodes; return how many terminals and operators.

    Four lists take steps in turn: each waits for memory at each of its steps.
    """
    shift = np.uint64(batch.shift)
    above = (_ONE << np.uint64(terminals)) - _ONE
    operators = ~above
    root = _ONE << np.uint64(lists.code.shape[1] - 1)
    leaves, count = _ZERO, _ZERO
    for q in range(0, number, 4):
        q0, q1 = np.uint64(q), np.uint64(min(q + 1, number - 1))
        q2, q3 = np.uint64(min(q + 2, number - 1)), np.uint64(min(q + 3, number - 1))
        p0, p1, p2, p3 = np.uint64(first) + q0, np.uint64(first) + q1, np.uint64(first) + q2, np.uint64(first) + q3
        live0 = root
        live1 = root if q + 1 < number else _ZERO
        live2 = root if q + 2 < number else _ZERO
        live3 = root if q + 3 < number else _ZERO
        slot0, slot1, slot2, slot3 = q0 << shift, q1 << shift, q2 << shift, q3 << shift
        w0, w1, w2, w3 = live0 & operators, live1 & operators, live2 & operators, live3 & operators
        while (w0 | w1 | w2 | w3) != _ZERO:
            w0, count = _step(lists, p0, slot0, w0, count, batch)
            w1, count = _step(lists, p1, slot1, w1, count, batch)
            w2, count = _step(lists, p2, slot2, w2, count, batch)
            w3, count = _step(lists, p3, slot3, w3, count, batch)
            live0 |= w0
            live1 |= w1
            live2 |= w2
            live3 |= w3
            w0 &= operators
            w1 &= operators
            w2 &= operators
            w3 &= operators
        leaves = _take_terminals(live0 & above, slot0, leaves, batch)
        leaves = _take_terminals(live1 & above, slot1, leaves, batch)
        leaves = _take_terminals(live2 & above, slot2, leaves, batch)
        leaves = _take_terminals(live3 & above, slot3, leaves, batch)
    return leaves, count


@inlined
def _collect_long(lists: Lists, first: Int, number: Int, terminals: Int, batch: Batch) -> tuple[np.uint64, np.uint64]:
    """Do what `_collect` does for lists of any length."""
    leaves, count = _ZERO, _ZERO
    for q in range(number):
        mark_live(lists, first + q, batch.bits)
        slot = np.uint64(q) << np.uint64(batch.shift)
        for word in range(batch.bits.shape[0] - 1, -1, -1):
            waiting = batch.bits[word]
            while waiting != _ZERO:
                bit = np.uint64(highest_bit(waiting))
                waiting ^= _ONE << bit
                i = np.uint64(word << 6) | bit
                if i < np.uint64(terminals):
                    batch.terminals[leaves] = slot | i
                    leaves += _ONE
                else:
                    _take(lists, np.uint64(first + q), i, slot, count, batch)
                    count += _ONE
    return leaves, count


@inlined
def _settle_terminals(lists: Lists, first: Int, leaves: np.uint64, batch: Batch) -> None:
    """Note the row of each live terminal; write the constants to theirs."""
    shift, base = np.uint64(batch.shift), np.uint64(batch.base)
    low = (_ONE << shift) - _ONE
    for k in range(np.int64(leaves)):
        slot = batch.terminals[np.uint64(k)]
        p, i = np.uint64(first) + (slot >> shift), slot & low
        row = base + np.uint64(k)
        fact = np.uint64(lists.left[p, i]) | _VARIES | INPUT
        batch.facts[slot] = fact if lists.code[p, i] == VARIABLE else row
        fill(place(batch.values, np.int64(row), _START), lists.constants[p, i])


@inlined
def _chain_operators(leaves: np.uint64, count: np.uint64, batch: Batch) -> tuple[np.uint64, np.uint64]:
    """Put each operator on its chain; return the highest level and, as bits, the chains used at any level."""
    base = np.uint64(batch.base) + leaves
    highest, used = _ZERO, _ZERO
    k = count
    while k != _ZERO:
        k -= _ONE
        node, both = batch.nodes[k], batch.arguments[k]
        slot, op = node & _LOW, node >> _HALF
        a = batch.facts[both & _LOW]
        b = batch.facts[both >> _HALF] & _ALL_IF_BINARY[op]
        row = a & ROW
        fact = ((max(a, b) & _LEVELS) + _LEVEL) | ((a | b) & _VARIES) | (base + k)
        offset = batch.waves[op]
        kept = _VARIES | (row + (offset & ROW))
        fact = kept if (a & offset) >= INPUT else fact  # such a node lands on a chain of level 0, never evaluated
        batch.facts[slot] = fact
        highest = max(highest, fact)
        chain = (fact >> np.uint64(24) << np.uint64(5)) | op
        batch.links[k] = (batch.heads[chain] << NEXT) | ((b & ROW) << SECOND) | row
        batch.heads[chain] = k
        used |= _ONE << (chain & np.uint64(CHAINS - 1))
    return highest >> np.uint64(25), used


@inlined
def _compare(number: Int, last: Int, rows: Rows, start: Int, batch: Batch) -> None:
    """Add the residuals of a block of rows to each list's sums."""
    target, mask = place(rows.target, _START, start), place(rows.mask, _START, start)
    residual = place(batch.packed, _START, _START)
    for q in range(number):
        output = batch.facts[np.uint64((q << batch.shift) | last)] & ROW
        subtract(residual, target, place(batch.values, np.int64(output), _START))
        multiply(residual, residual, mask)
        batch.sums[0, q] += total_magnitude(residual, mask)
        batch.sums[1, q] += total(residual, residual)


@kernel
def measure_lists(losses: Floats, lists: Lists, terminals: Int, rows: Rows, loss: Int, batch: Batch) -> None:
    """Write the loss of each list on `rows`, unscaled: mean absolute (`loss` 0) or squared (1) residual; infinity.

    The first `terminals` nodes of every list are terminals, and no others are.
    """
    last = lists.code.shape[1] - 1
    for first in range(0, losses.shape[0], BATCH):
        number = min(losses.shape[0] - first, BATCH)
        if last < 64:
            leaves, count = _collect(lists, first, number, terminals, batch)
        else:
            leaves, count = _collect_long(lists, first, number, terminals, batch)
        _settle_terminals(lists, first, leaves, batch)
        highest, used = _chain_operators(leaves, count, batch)
        operators = np.uint64(batch.base) + leaves
        for q in range(number):
            batch.sums[0, q] = 0.0
            batch.sums[1, q] = 0.0
        for start in range(_START, rows.length, LANES):
            load_rows(rows, start, batch)
            evaluate_chains(highest, used, operators, start == 0, batch)
            _compare(number, last, rows, start, batch)
        for q in range(number):
            is_finite = np.isfinite(batch.sums[0, q]) and np.isfinite(batch.sums[1, q])
            losses[first + q] = batch.sums[loss, q] / rows.length if is_finite else _INFINITY
        for chain in range((np.int64(highest) + 1) * CHAINS):
            batch.heads[chain] = END


__all__ = ["BATCH", "Batch", "empty_batch", "measure_lists"]
