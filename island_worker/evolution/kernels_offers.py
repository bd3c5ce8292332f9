"""Which individuals deserve to be measured on all rows, and what their constants are there."""

import numpy as np

from common.jit import inlined, kernel
from island_worker.evolution.kernels_fit import fit
from island_worker.evolution.kernels_generation import INFINITY, REFITTING
from island_worker.evolution.kernels_tape import canonical_tape, compile_tape
from island_worker.evolution.structures import Fit, Floats, Hashes, Ints, Lists, Rows, Scratch, Tape

_PRIME = np.uint64(0x100000001B3)
_BASIS = np.uint64(0xCBF29CE484222325)


@inlined
def _mixed(h: np.uint64, value: int) -> np.uint64:
    return (h ^ np.uint64(value + 1)) * _PRIME


@kernel
def structure_hash(tape: Tape, count: int) -> np.uint64:
    """Return a hash of the program without its constants (FNV-1a over nodes)."""
    h = _BASIS
    for i in range(count):
        h = _mixed(_mixed(_mixed(h, tape.code[i]), tape.left[i]), tape.right[i])
    return h


@kernel
def canonical(lists: Lists, p: int, scratch: Scratch) -> int:
    """Write individual `p` as a canonical program to `scratch.canonical`; return its size, scaling left out."""
    count = compile_tape(lists, p, scratch.tape)
    return canonical_tape(scratch.tape, count, scratch.work, scratch.canonical)


@kernel
def choose_offers(
    lists: Lists, fitness: Floats, scratch: Scratch, offered: Hashes, offered_loss: Floats, chosen: Ints
) -> int:
    """List in `chosen` the best individual of each size that no smaller one equals; return their number.

    Those are left out whose structure was the last one offered at that size, unless the predicted loss has halved.
    `offered` (sizes,) uint64 and `offered_loss` (sizes,) are brought up to date.
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
        chosen[count] = p
        count += 1
    return count


@kernel
def refit(
    count: int, rows: Rows, options: Fit, steps: int, scratch: Scratch, scale: Floats, result: Floats, counters: Ints
) -> None:
    """Fit the program on `scratch.canonical` to `rows`, in place; its terms are left in `scratch.work`; counted."""
    most = rows.length // 4
    used = fit(scratch.canonical, count, rows, options, most, steps, scratch.work, scale, result)
    counters[REFITTING] += used
