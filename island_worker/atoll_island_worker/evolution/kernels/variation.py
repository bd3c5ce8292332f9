"""Random lists, crossover, mutation and the distance of deterministic crowding (paper, section 2 and Table II)."""

import numpy as np

from atoll_core.compilation.jit import inlined, kernel
from atoll_core.expression.kernels.elementary import strict_exp
from atoll_core.expression.kernels.lanes import CHUNK, blend, differing, lowest_bit, move
from atoll_core.expression.kernels.tape import Int
from atoll_core.expression.operators import CONSTANT, VARIABLE
from atoll_island_worker.evolution.kernels.random import GAMMA, Stream, below, bits_of, normal, uniform
from atoll_island_worker.evolution.structures import Floats, Hashes, Ints, Lists, Space

_NONE = np.uint64(0)
_ONE = np.uint64(1)
_TWO = np.uint64(2)
_LOW = np.uint64(0xFFFFFFFF)
_S32 = np.uint64(32)
_STEP_EXPONENTS = (-5.0, 1.0)
RELATIVE_STEPS = 0
LOG_UNIFORM_STEPS = 1


@kernel
def random_constant(space: Space, stream: Stream) -> float:
    """Return a random constant: uniform in [-10, 10], or log-uniform around a product of powers of the data's scales.

    With scales, the magnitude is 10^u, u uniform in [-1, 1), times each scale to the power -1, 0, 0 or 1. So constants
    fit ratios and products of columns in any units. If all scales are 1, they have no effect.
    """
    if space.scales.shape[0] == 0:
        return 20.0 * uniform(stream) - 10.0
    magnitude = strict_exp(2.302585092994046 * (2.0 * uniform(stream) - 1.0))
    for scale in space.scales:
        power = below(stream, 4)
        if power == 0:
            magnitude /= scale
        elif power == 1:
            magnitude *= scale
    return magnitude if uniform(stream) < 0.5 else -magnitude


@kernel
def _varied_constant(value: float, space: Space, stream: Stream) -> float:
    """Return `value` plus a normally distributed step, with standard deviation 0.3 of the value, or log-uniform.

    The log-uniform standard deviation is 10^u, u uniform in `_STEP_EXPONENTS`, drawn for each step, so that steps of
    every size in this range are equally likely.
    """
    if space.steps == RELATIVE_STEPS:
        return value * (1.0 + 0.3 * normal(stream))
    exponent = _STEP_EXPONENTS[0] + (_STEP_EXPONENTS[1] - _STEP_EXPONENTS[0]) * uniform(stream)
    return value + strict_exp(2.302585092994046 * exponent) * normal(stream)


@inlined
def _random_terminal(lists: Lists, p: Int, i: Int, space: Space, stream: Stream) -> None:
    if uniform(stream) < 0.5:
        lists.code[p, i] = VARIABLE
        lists.left[p, i] = below(stream, space.variables)
    else:
        lists.code[p, i] = CONSTANT
        lists.left[p, i] = 0
        lists.constants[p, i] = random_constant(space, stream)
    lists.right[p, i] = 0


@inlined
def reset_scale(scale: Floats) -> None:
    """Set b = 0, a_1 = 1 and the other coefficients to 0; a list with one term is then unscaled."""
    for j in range(scale.shape[0]):
        scale[j] = 0.0
    scale[1] = 1.0


@kernel
def random_list(lists: Lists, p: Int, space: Space, stream: Stream) -> None:
    """Fill list `p` at random: first the terminals, then operators whose arguments are any earlier nodes."""
    reset_scale(lists.scale[p])
    for i in range(space.nodes):
        lists.constants[p, i] = 0.0
        if i < space.terminals:
            _random_terminal(lists, p, i, space, stream)
        else:
            lists.code[p, i] = space.operators[below(stream, space.operators.shape[0])]
            lists.left[p, i] = below(stream, i)
            lists.right[p, i] = below(stream, i)


@inlined
def _mutate_node(lists: Lists, p: Int, i: Int, space: Space, stream: Stream) -> None:
    if i < space.terminals:
        if lists.code[p, i] == CONSTANT and uniform(stream) < space.moves:
            lists.constants[p, i] = _varied_constant(lists.constants[p, i], space, stream)
        else:
            _random_terminal(lists, p, i, space, stream)
        return
    part = below(stream, 3)
    if part == 0:
        lists.code[p, i] = space.operators[below(stream, space.operators.shape[0])]
    elif part == 1:
        lists.left[p, i] = below(stream, i)
    else:
        lists.right[p, i] = below(stream, i)


@inlined
def _drawn_bits(count: Int, threshold: np.uint64, stream: Stream) -> np.uint64:
    """Return `count` random bits, at most 64, each set with probability threshold / 2**32.

    Each number of the stream depends only on its index, so that the iterations of the loop are independent and
    vectorise.
    """
    pairs = np.uint64((count + 1) >> 1)
    begin = stream[0]
    bits = _NONE
    for k in range(pairs):
        drawn = bits_of(begin + (k + _ONE) * GAMMA)
        low = _ONE if (drawn & _LOW) < threshold else _NONE
        high = _TWO if (drawn >> _S32) < threshold else _NONE
        bits |= (low | high) << (k + k)
    stream[0] = begin + pairs * GAMMA
    return bits if count & 1 == 0 else bits & ((_ONE << np.uint64(count)) - _ONE)


@inlined
def mutate(lists: Lists, p: Int, space: Space, stream: Stream) -> None:
    """Change each node of list `p` with probability `space.mutation`: its operator, or one of its two arguments.

    A terminal is replaced by a random terminal; a constant is moved instead with probability `space.moves`. The nodes
    to be changed are drawn before all changes, two nodes from one random number, so that there is no branch per draw.
    """
    threshold = np.uint64(space.mutation * 4294967296.0)
    for first in range(0, space.nodes, 64):
        last = min(first + 64, space.nodes)
        changed = _drawn_bits(last - first, threshold, stream)
        while changed != _NONE:
            i = first + lowest_bit(changed)
            changed &= changed - _ONE
            _mutate_node(lists, p, i, space, stream)


@inlined
def copy_nodes(target: Lists, p: Int, source: Lists, q: Int, first: Int, last: Int) -> None:
    """Copy nodes [first, last) of list `q` of `source` to list `p` of `target`."""
    move(target.code, p, source.code, q, first, last)
    move(target.left, p, source.left, q, first, last)
    move(target.right, p, source.right, q, first, last)
    move(target.constants, p, source.constants, q, first, last)


@inlined
def copy_list(target: Lists, p: Int, source: Lists, q: Int) -> None:
    """Copy the whole list `q` of `source`, with its scaling, to list `p` of `target`."""
    copy_nodes(target, p, source, q, 0, source.code.shape[1])
    for j in range(source.scale.shape[1]):
        target.scale[p, j] = source.scale[q, j]


@inlined
def _join(out: Lists, q: Int, one: Lists, i: Int, other: Lists, j: Int, cut: Int) -> None:
    """Write list `q` of `out`: nodes before `cut` from list `i` of `one`, the others from list `j` of `other`."""
    nodes = one.code.shape[1]
    whole = nodes - nodes % CHUNK
    for start in range(0, whole, CHUNK):
        blend(out.code, q, one.code, i, other.code, j, start, cut)
        blend(out.left, q, one.left, i, other.left, j, start, cut)
        blend(out.right, q, one.right, i, other.right, j, start, cut)
        blend(out.constants, q, one.constants, i, other.constants, j, start, cut)
    if whole < nodes:
        middle = max(cut, whole)
        copy_nodes(out, q, one, i, whole, middle)
        copy_nodes(out, q, other, j, middle, nodes)


@inlined
def cross(children: Lists, parents: Lists, first: Int, second: Int, space: Space, stream: Stream) -> Int:
    """Write two complementary children of parents `first` and `second` to lists 0 and 1 of `children`.

    With probability `space.crossover` both lists are cut at the same random node; otherwise the children are copies.

    Returns:
        The parent from which the first child has its output node; the second child has it from the other parent.
    """
    cut: Int = space.nodes
    if uniform(stream) < space.crossover:
        cut = 1 + below(stream, space.nodes - 1)
    _join(children, 0, parents, first, parents, second, cut)
    _join(children, 1, parents, second, parents, first, cut)
    for j in range(parents.scale.shape[1]):
        children.scale[0, j] = parents.scale[first, j]
        children.scale[1, j] = parents.scale[second, j]
    return first if cut == space.nodes else second


@inlined
def _bits_differ(one: Lists, p: Int, other: Lists, q: Int, i: Int) -> bool:
    return bool(
        one.code[p, i] != other.code[q, i]
        or one.left[p, i] != other.left[q, i]
        or one.right[p, i] != other.right[q, i]
        or one.constants[p, i] != other.constants[q, i]
    )


@inlined
def is_unchanged(parents: Lists, p: Int, children: Lists, q: Int, live: Hashes) -> bool:
    """Return whether all nodes that are live in parent `p`, marked in live[p], have equal bits in child `q`."""
    nodes = parents.code.shape[1]
    whole = nodes - nodes % CHUNK
    for start in range(0, whole, CHUNK):
        bits = differing(parents.code, p, children.code, q, start)
        bits |= differing(parents.left, p, children.left, q, start)
        bits |= differing(parents.right, p, children.right, q, start)
        bits |= differing(parents.constants, p, children.constants, q, start)
        if bits & (live[p, start >> 6] >> np.uint64(start & 63)) != _NONE:
            return False
    for i in range(whole, nodes):
        is_live = (live[p, i >> 6] >> np.uint64(i & 63)) & _ONE
        if is_live != _NONE and _bits_differ(parents, p, children, q, i):
            return False
    return True


@inlined
def distance(signature: Ints, i: Int, j: Int) -> int:
    """Return the number of nodes, live in either list, that differ in operator or arguments.

    `i` and `j` are the rows of the two lists in `signature`. The values of constants are ignored.
    """
    differing = 0
    for k in range(signature.shape[1]):
        differing += 1 if signature[i, k] != signature[j, k] else 0
    return differing
