"""Chains of operators: the nodes of many lists that have one operator and one level, evaluated one after the other.

What a batch is, and how its chains come about: `atoll_island_worker.evolution.kernels.batch`.
"""

from typing import Final, NamedTuple

import numpy as np

from atoll.compilation.jit import inlined
from atoll.expression.kernels.lanes import (
    LANES,
    add,
    copy,
    divide,
    fill,
    get,
    lowest_bit,
    multiply,
    place,
    put,
    subtract,
)
from atoll.expression.kernels.tape import Int, apply_operator, functions_address
from atoll.expression.operators import ADD, ARITY, COS, DIVIDE, MULTIPLY, SIN, SUBTRACT
from atoll_island_worker.evolution.structures import Floats, Hashes, Rows

BATCH: Final = 64
"""Lists in a batch."""

CHAINS: Final = 64
"""Chains of a level: 32 operators on what is constant, 32 on what varies."""

INPUT: Final = np.uint64(1 << 23)
ROW: Final = np.uint64((1 << 20) - 1)
SECOND: Final = np.uint64(20)
NEXT: Final = np.uint64(40)
"""Where in a link the row of the second argument begins, and the next link."""
END: Final = np.uint64((1 << 20) - 1)
"""No link: the end of a chain."""

_START: Final = np.int64(0)
_ZERO: Final = np.uint64(0)
_ONE: Final = np.uint64(1)


class Batch(NamedTuple):
    """Scratch of a batch; its arrays of words are as long as there are slots."""

    shift: int
    base: int
    """Row of the first live terminal."""
    values: Floats
    """(rows of the table, LANES)."""
    terminals: Hashes
    """Slots of live terminals."""
    nodes: Hashes
    """Slots of live operators, those of each list in falling order, the operator in the upper half."""
    arguments: Hashes
    """The slots of their arguments, the second in the upper half."""
    facts: Hashes
    """What is known of each slot's node."""
    links: Hashes
    """Of each live operator: rows of the arguments, next link."""
    heads: Hashes
    """(levels * CHAINS,) the first link of each chain."""
    bits: Hashes
    """Live nodes of a list of more than 64, 64 to a word."""
    waves: Hashes
    """(operators,) how many rows after an input's this function of it is kept, with the bit of inputs; else 0."""
    packed: Floats
    """(3, LANES) arguments and values of nodes that are the same at all rows."""
    sums: Floats
    """(2, BATCH) sums of each list's absolute and squared residuals."""
    functions: int


def empty_batch(nodes: int, rows: Rows) -> Batch:
    """Return scratch to measure lists of `nodes` nodes on rows like `rows`."""
    variables = rows.inputs.shape[0]
    shift = max(1, (nodes - 1).bit_length())
    slots = BATCH << shift
    words = [np.zeros(slots, np.uint64) for _ in range(5)]
    waves = np.zeros(len(ARITY), np.uint64)
    if rows.waves.shape[0] > 0:
        waves[[SIN, COS]] = INPUT + np.array([variables, 2 * variables], np.uint64)
    return Batch(
        shift, 3 * variables, np.zeros((3 * variables + slots, LANES)), words[0], words[1], words[2], words[3],
        words[4], np.full((nodes + 1) * CHAINS, END), np.zeros(-(-nodes // 64), np.uint64), waves,
        np.zeros((3, LANES)), np.zeros((2, BATCH)), functions_address(),
    )  # fmt: skip


@inlined
def load_rows(rows: Rows, start: Int, batch: Batch) -> None:
    """Copy a block of inputs, and what is kept of them, to the table."""
    variables = rows.inputs.shape[0]
    for v in range(variables):
        copy(place(batch.values, v, _START), place(rows.inputs, v, start))
    for wave in range(rows.waves.shape[0]):
        row = variables + (wave >> 1) + (wave & 1) * variables
        copy(place(batch.values, row, _START), place(rows.waves, wave, start))


@inlined
def _evaluate_varying(op: Int, link: np.uint64, first: np.uint64, batch: Batch) -> None:
    """Evaluate the nodes of a chain at a block of rows; the branches go one way all along it."""
    values, links = batch.values, batch.links
    while link != END:
        rows = links[link]
        out = place(values, np.int64(first + link), _START)
        a, b = place(values, np.int64(rows & ROW), _START), place(values, np.int64(rows >> SECOND & ROW), _START)
        link = rows >> NEXT
        if op == ADD:
            add(out, a, b)
        elif op == SUBTRACT:
            subtract(out, a, b)
        elif op == MULTIPLY:
            multiply(out, a, b)
        elif op == DIVIDE:
            divide(out, a, b)
        else:
            apply_operator(op, out, a, b, batch.functions)


@inlined
def _evaluate_constant(op: Int, link: np.uint64, first: np.uint64, batch: Batch) -> None:
    """Evaluate the nodes of a chain that are the same at all rows, `LANES` nodes at a time."""
    values, links = batch.values, batch.links
    a = place(batch.packed, _START, _START)
    b = place(batch.packed, _START + 1, _START)
    out = place(batch.packed, _START + 2, _START)
    while link != END:
        begun = link
        number = _START
        while link != END and number < LANES:
            rows = links[link]
            put(a, number, get(place(values, np.int64(rows & ROW), _START), _START))
            put(b, number, get(place(values, np.int64(rows >> SECOND & ROW), _START), _START))
            number += 1
            link = rows >> NEXT
        apply_operator(op, out, a, b, batch.functions)
        link = begun
        for k in range(number):
            fill(place(values, np.int64(first + link), _START), get(out, k))
            link = links[link] >> NEXT


@inlined
def evaluate_chains(highest: np.uint64, used: np.uint64, first: np.uint64, is_first: bool, batch: Batch) -> None:
    """Evaluate all chains, level by level; those of constants for the first block of rows only.

    `first` is the row of link 0.
    """
    for level in range(1, np.int64(highest) + 1):
        waiting = used
        while waiting != _ZERO:
            chain = np.int64(lowest_bit(waiting))
            waiting &= waiting - _ONE
            link = batch.heads[np.uint64(level * CHAINS + chain)]
            if link == END:
                continue
            if chain >= CHAINS // 2:
                _evaluate_varying(chain - CHAINS // 2, link, first, batch)
            elif is_first:
                _evaluate_constant(chain, link, first, batch)
