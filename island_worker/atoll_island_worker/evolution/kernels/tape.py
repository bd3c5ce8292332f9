"""Convert an operation list to a tape without dead nodes, and to a canonical program.

In a canonical program constant parts are replaced by their values, and equal parts are one node.
"""

import numpy as np

from atoll_core.compilation.jit import inlined, kernel
from atoll_core.expression.kernels.lanes import LANES, fill, get, highest_bit, lowest_bit, place
from atoll_core.expression.kernels.tape import Int, apply_operator
from atoll_core.expression.operators import ADD, ARITY, CONSTANT, DIVIDE, MULTIPLY, POW, SQUARE
from atoll_island_worker.evolution.structures import Hashes, Ints, Lists, Tape, Work

ARITY_OF = np.array(ARITY, np.int64)

_NONE = np.uint64(0)
_ONE = np.uint64(1)
_ALL = np.uint64(2**64 - 1)
_S8, _S32 = np.uint64(8), np.uint64(32)


@inlined
def _is_binary(op: Int) -> bool:
    return bool((op >= ADD and op <= DIVIDE) or op == POW)


@inlined
def _where(condition: bool) -> np.uint64:
    """Return all bits set where `condition` holds, none elsewhere."""
    return _ALL if condition else _NONE


@inlined
def _mark_in_word(lists: Lists, p: Int) -> np.uint64:
    """Return the bits of the live nodes of a list of at most 64 nodes, see `mark_live`.

    The arity of a node is used in bit masks and not in branches, because the processor would often mispredict them.
    """
    last = np.uint64(lists.code.shape[1] - 1)
    live = waiting = _ONE << last
    while waiting != _NONE:
        i = highest_bit(waiting)
        op = np.int64(lists.code[p, i])
        arguments = (_ONE << np.uint64(lists.left[p, i] & 63)) & _where(bool(op > CONSTANT))
        arguments |= (_ONE << np.uint64(lists.right[p, i] & 63)) & _where(_is_binary(op))
        waiting = (waiting ^ (_ONE << np.uint64(i))) | arguments
        live |= arguments
    return live


@inlined
def mark_live(lists: Lists, p: Int, bits: Hashes) -> None:
    """Set the bit of every node of list `p` on which its output (the last node) depends; 64 nodes per word."""
    if bits.shape[0] == 1:
        bits[0] = _mark_in_word(lists, p)
        return
    for word in range(bits.shape[0]):
        bits[word] = _NONE
    last = lists.code.shape[1] - 1
    bits[last >> 6] = _ONE << np.uint64(last & 63)
    for word in range(last >> 6, -1, -1):
        waiting = bits[word]
        while waiting != _NONE:
            b = highest_bit(waiting)
            waiting ^= _ONE << np.uint64(b)
            i = (word << 6) + b
            arity = ARITY_OF[lists.code[p, i]]
            if arity == 0:
                continue
            left, right = np.int64(lists.left[p, i]), np.int64(lists.right[p, i])
            right = right if arity > 1 else left
            if left >> 6 == word:
                waiting |= _ONE << np.uint64(left & 63)
            if right >> 6 == word:
                waiting |= _ONE << np.uint64(right & 63)
            bits[left >> 6] |= _ONE << np.uint64(left & 63)
            bits[right >> 6] |= _ONE << np.uint64(right & 63)


@inlined
def compile_tape(lists: Lists, p: Int, tape: Tape) -> int:
    """Write the live nodes of list `p` onto `tape`; return their number."""
    mark_live(lists, p, tape.bits)
    return compile_live(lists, p, tape.bits, tape)


@inlined
def compile_live(lists: Lists, p: Int, bits: Hashes, tape: Tape) -> int:
    """Write the nodes of list `p` that are marked in `bits` onto `tape`; return their number."""
    count = 0
    for word in range(bits.shape[0]):
        waiting = bits[word]
        while waiting != _NONE:
            b = lowest_bit(waiting)
            waiting &= waiting - _ONE
            i = (word << 6) + b
            tape.live[i] = count
            tape.origin[count] = i
            op = np.int64(lists.code[p, i])
            arity = ARITY_OF[op]
            left = np.int64(lists.left[p, i])
            tape.code[count] = op
            tape.left[count] = tape.live[left] if arity > 0 else left
            tape.right[count] = tape.live[lists.right[p, i]] if arity > 1 else 0
            tape.constants[count] = lists.constants[p, i] if op == CONSTANT else 0.0
            count += 1
    return count


@inlined
def sign(lists: Lists, p: Int, bits: Hashes, signature: Ints, q: Int) -> None:
    """Write the signature of list `p` to row `q` of `signature`: 0 for each dead node, else operator and arguments.

    Arguments that the operator does not have, and the values of constants, are left out. `bits` receives the marks of
    the live nodes, 64 nodes per word.
    """
    mark_live(lists, p, bits)
    whole = signature.shape[1] - signature.shape[1] % LANES
    for start in range(0, whole, LANES):
        fill(place(signature, q, start), 0.0)
    for i in range(whole, signature.shape[1]):
        signature[q, i] = 0
    for word in range(bits.shape[0]):
        waiting = bits[word]
        while waiting != _NONE:
            i = (word << 6) + lowest_bit(waiting)
            waiting &= waiting - _ONE
            op = np.int64(lists.code[p, i])
            left = (np.uint64(lists.left[p, i]) << _S8) & _where(bool(op != CONSTANT))
            right = (np.uint64(lists.right[p, i]) << _S32) & _where(_is_binary(op))
            signature[q, i] = (op + 1) | np.int64(left | right)


@inlined
def _same(tape: Tape, i: int, op: int, left: int, right: int, constant: float) -> bool:
    return (tape.code[i] == op and tape.left[i] == left and tape.right[i] == right) and (
        op != CONSTANT
        or (tape.constants[i] == constant and np.signbit(tape.constants[i]) == np.signbit(np.float64(constant)))
    )


@kernel
def _append(tape: Tape, count: int, op: int, left: int, right: int, constant: float) -> int:
    """Return the index of an equal node among the first `count` nodes of the tape, or append the node at `count`."""
    for i in range(count):
        if _same(tape, i, op, left, right, constant):
            return i
    tape.code[count] = op
    tape.left[count] = left
    tape.right[count] = right
    tape.constants[count] = constant
    return count


@kernel
def canonical_tape(source: Tape, length: Int, work: Work, tape: Tape) -> int:
    """Write the canonical form of `source` (`length` nodes) onto `tape`; return the number of nodes.

    Operators on constants become constants, and equal nodes become one. For this the operands of + and * are sorted,
    and a square becomes a product. Unused nodes that remain are removed in a second pass. `source` and `tape` must be
    different tapes.
    """
    count = 0
    place = source.origin
    for i in range(length):
        op = source.code[i]
        arity = ARITY_OF[op]
        left = place[source.left[i]] if arity > 0 else source.left[i]
        right = place[source.right[i]] if arity > 1 else 0
        if op == SQUARE:
            op, arity, right = np.int64(MULTIPLY), np.int64(2), left
        if op in (ADD, MULTIPLY) and left > right:
            left, right = right, left
        constant = source.constants[i]
        if arity > 0 and tape.code[left] == CONSTANT and (arity == 1 or tape.code[right] == CONSTANT):
            constant = _folded(op, tape.constants[left], tape.constants[right], work)
            op, left, right = np.int64(CONSTANT), np.int64(0), np.int64(0)
        place[i] = _append(tape, count, op, left, right, constant)
        count = max(count, place[i] + 1)
    return _drop_dead(tape, place[length - 1] + 1)


@kernel
def _folded(op: int, a: float, b: float, work: Work) -> float:
    """Return the value of an operator on two constants, from the same kernel that measures programs."""
    left, right, out = place(work.values, 0, 0), place(work.values, 1, 0), place(work.values, 2, 0)
    fill(left, a)
    fill(right, b)
    apply_operator(op, out, left, right, work.functions)
    return get(out, 0)


@kernel
def _drop_dead(tape: Tape, length: int) -> int:
    """Keep only the nodes on which node `length - 1` depends, in place on the tape; return their number."""
    live = tape.live
    for i in range(length):
        live[i] = -1
    live[length - 1] = 1
    for i in range(length - 1, -1, -1):
        if live[i] > 0:
            arity = ARITY_OF[tape.code[i]]
            if arity > 0:
                live[tape.left[i]] = 1
            if arity > 1:
                live[tape.right[i]] = 1
    count = 0
    for i in range(length):
        if live[i] < 0:
            continue
        arity = ARITY_OF[tape.code[i]]
        live[i] = count
        tape.code[count] = tape.code[i]
        tape.left[count] = live[tape.left[i]] if arity > 0 else tape.left[i]
        tape.right[count] = live[tape.right[i]] if arity > 1 else 0
        tape.constants[count] = tape.constants[i]
        count += 1
    return count
