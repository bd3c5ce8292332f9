"""From an operation list to a tape, dead nodes left out; to a canonical program, equal and constant parts folded."""

import numpy as np

from common.expression.kernels import forward_block
from common.expression.operators import ADD, ARITY, CONSTANT, MULTIPLY, SQUARE, VARIABLE
from common.jit import inlined, kernel
from island_worker.evolution.structures import Bytes, Floats, Ints, Shorts, Tape

ARITY_OF = np.array(ARITY, np.int64)


@kernel
def mark_live(code: Bytes, left: Shorts, right: Shorts, live: Ints) -> int:
    """Set `live[i]` to 1 for nodes that the output (the last node) depends on, else -1; return how many live."""
    last = code.shape[0] - 1
    for i in range(last):
        live[i] = -1
    live[last] = 1
    count = 0
    for i in range(last, -1, -1):
        if live[i] < 0:
            continue
        count += 1
        arity = ARITY_OF[code[i]]
        if arity > 0:
            live[left[i]] = 1
        if arity > 1:
            live[right[i]] = 1
    return count


@kernel
def compile_tape(code: Bytes, left: Shorts, right: Shorts, constants: Floats, tape: Tape) -> int:
    """Write the live nodes of one list onto `tape`; return their number."""
    mark_live(code, left, right, tape.live)
    count = 0
    for i in range(code.shape[0]):
        if tape.live[i] < 0:
            continue
        tape.live[i] = count
        tape.origin[count] = i
        op = np.int64(code[i])
        arity = ARITY_OF[op]
        tape.code[count] = op
        tape.left[count] = tape.live[left[i]] if arity > 0 else (np.int64(left[i]) if op == VARIABLE else 0)
        tape.right[count] = tape.live[right[i]] if arity > 1 else 0
        tape.constants[count] = constants[i] if op == CONSTANT else 0.0
        count += 1
    return count


@inlined
def _same(tape: Tape, i: int, op: int, left: int, right: int, constant: float) -> bool:
    return (tape.code[i] == op and tape.left[i] == left and tape.right[i] == right) and (
        op != CONSTANT
        or (tape.constants[i] == constant and np.signbit(tape.constants[i]) == np.signbit(np.float64(constant)))
    )


@kernel
def _append(tape: Tape, count: int, op: int, left: int, right: int, constant: float) -> int:
    """Return the index of that node on the tape, appended unless an equal one is there."""
    for i in range(count):
        if _same(tape, i, op, left, right, constant):
            return i
    tape.code[count] = op
    tape.left[count] = left
    tape.right[count] = right
    tape.constants[count] = constant
    return count


@kernel
def canonical_tape(source: Tape, length: int, work_values: Floats, tape: Tape) -> int:
    """Fold constants and duplicates of `source` (`length` nodes) onto `tape`; return the number of nodes.

    Operands of + and * are put in order and a square is a product, so that equal values are one node. Folding may leave
    nodes that nobody needs; a second pass over the live ones removes them. `source` and `tape` must differ.
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
            constant = _folded(op, tape.constants[left], tape.constants[right], work_values)
            op, left, right = np.int64(CONSTANT), np.int64(0), np.int64(0)
        place[i] = _append(tape, count, op, left, right, constant)
        count = max(count, place[i] + 1)
    return _drop_dead(tape, place[length - 1] + 1)


@kernel
def _folded(op: int, a: float, b: float, work_values: Floats) -> float:
    """Return the value of an operator on two constants, by the very kernel that measures programs."""
    code = np.array([CONSTANT, CONSTANT, op])
    left = np.array([0, 0, 0])
    right = np.array([0, 0, 1])
    zero = np.int64(0)
    forward_block(np.int64(3), code, left, right, np.array([a, b, 0.0]), np.zeros((1, 1)), zero, work_values)
    return work_values[2, 0]


@kernel
def _drop_dead(tape: Tape, length: int) -> int:
    """Compact the tape in place to what its node `length - 1` depends on; return the number of nodes."""
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
