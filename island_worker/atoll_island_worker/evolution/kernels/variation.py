"""Random lists, crossover, mutation and the distance of deterministic crowding (paper, section 2 and Table II)."""

import numpy as np

from atoll.compilation.jit import inlined, kernel
from atoll.expression.kernels.elementary import strict_exp
from atoll.expression.kernels.lanes import lowest_bit, move
from atoll.expression.kernels.tape import Int
from atoll.expression.operators import CONSTANT, VARIABLE
from atoll_island_worker.evolution.kernels.random import Stream, below, next_bits, normal, uniform
from atoll_island_worker.evolution.structures import Floats, Ints, Lists, Space

_NONE = np.uint64(0)
_ONE = np.uint64(1)
_LOW = np.uint64(0xFFFFFFFF)
_S32 = np.uint64(32)
_STEP_EXPONENTS = (-5.0, 1.0)
RELATIVE_STEPS = 0
NORMAL_STEPS = 1
LOG_UNIFORM_STEPS = 2


@kernel
def random_constant(space: Space, stream: Stream) -> float:
    """Return a constant: uniform in [-10, 10], or log-uniform about a product of powers of the data's scales.

    With scales, the magnitude is 10^u with u uniform in [-1, 1), times each scale to the power -1, 0, 0 or 1: so that
    ratios and products of columns of any unit are met, and nothing changes where all scales are 1.
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
    """Return a constant near `value`: a normal step, of one size or of a log-uniform one.

    By `space.steps` the step's size is 0: 0.3 of the value, 1: 1, 2: 10^u, 3: 10^u of the value, with u uniform in
    `_STEP_EXPONENTS`, anew for each step: so that any accuracy in that range is as near as any other.
    """
    if space.steps == RELATIVE_STEPS:
        return value * (1.0 + 0.3 * normal(stream))
    if space.steps == NORMAL_STEPS:
        return value + normal(stream)
    exponent = _STEP_EXPONENTS[0] + (_STEP_EXPONENTS[1] - _STEP_EXPONENTS[0]) * uniform(stream)
    step = strict_exp(2.302585092994046 * exponent) * normal(stream)
    return value + step if space.steps == LOG_UNIFORM_STEPS else value * (1.0 + step)


@inlined
def _random_terminal(lists: Lists, p: Int, i: Int, space: Space, stream: Stream) -> None:
    if i < space.variables and space.fixed == 1:
        lists.code[p, i] = VARIABLE
        lists.left[p, i] = i
    elif space.fixed == 0 and uniform(stream) < 0.5:
        lists.code[p, i] = VARIABLE
        lists.left[p, i] = below(stream, space.variables)
    else:
        lists.code[p, i] = CONSTANT
        lists.left[p, i] = 0
        lists.constants[p, i] = random_constant(space, stream)
    lists.right[p, i] = 0


@inlined
def _random_argument(i: Int, space: Space, stream: Stream) -> Int:
    """Return a node before operator node `i`."""
    if space.arguments == 0 or i == space.terminals:
        return below(stream, i)
    if uniform(stream) < 0.5:
        return below(stream, space.terminals)
    return space.terminals + below(stream, i - space.terminals)


@inlined
def reset_scale(scale: Floats) -> None:
    """Set b = 0, a_1 = 1 and the rest 0: of a list with one term, the list as it stands."""
    for j in range(scale.shape[0]):
        scale[j] = 0.0
    scale[1] = 1.0


@kernel
def random_list(lists: Lists, p: Int, space: Space, stream: Stream) -> None:
    """Fill list `p` at random: terminals, then operators that refer to any earlier nodes."""
    reset_scale(lists.scale[p])
    for i in range(space.nodes):
        lists.constants[p, i] = 0.0
        if i < space.terminals:
            _random_terminal(lists, p, i, space, stream)
        else:
            lists.code[p, i] = space.operators[below(stream, space.operators.shape[0])]
            lists.left[p, i] = _random_argument(i, space, stream)
            lists.right[p, i] = _random_argument(i, space, stream)


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
        lists.left[p, i] = _random_argument(i, space, stream)
    else:
        lists.right[p, i] = _random_argument(i, space, stream)


@inlined
def mutate(lists: Lists, p: Int, space: Space, stream: Stream) -> None:
    """Change each node of list `p` with probability `space.mutation`: one of its operator and its two arguments.

    A terminal becomes another terminal; a constant is moved rather than replaced in a share of the cases. Which nodes
    change is drawn first, two from one number, so that no branch hangs on each draw. With `space.unit` 1 the
    probability is that of one change to the list, at a random node.
    """
    if space.unit == 1:
        if uniform(stream) < space.mutation:
            _mutate_node(lists, p, below(stream, space.nodes), space, stream)
        return
    threshold = np.uint64(space.mutation * 4294967296.0)
    for first in range(0, space.nodes, 64):
        last = min(first + 64, space.nodes)
        changed = _NONE
        for i in range(first, last, 2):
            bits = next_bits(stream)
            low = _ONE if (bits & _LOW) < threshold else _NONE
            high = _ONE if (bits >> _S32) < threshold and i + 1 < last else _NONE
            changed |= (low | (high << _ONE)) << np.uint64(i - first)
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
def cross(children: Lists, parents: Lists, first: Int, second: Int, space: Space, stream: Stream) -> None:
    """Write two complementary children of parents `first` and `second` to lists 0 and 1 of `children`.

    With probability `space.crossover` both lists are cut at one common random place; else the children are copies.
    """
    cut: Int = space.nodes
    if uniform(stream) < space.crossover:
        cut = 1 + below(stream, space.nodes - 1)
    copy_list(children, 0, parents, first)
    copy_list(children, 1, parents, second)
    copy_nodes(children, 0, parents, second, cut, space.nodes)
    copy_nodes(children, 1, parents, first, cut, space.nodes)


@inlined
def distance(signature: Ints, i: Int, j: Int) -> int:
    """Return the number of nodes, live in either list, that differ in operator or arguments; constants are equal."""
    differing = 0
    for k in range(signature.shape[1]):
        differing += 1 if signature[i, k] != signature[j, k] else 0
    return differing


@inlined
def differing_constants(parents: Lists, p: Int, children: Lists, q: Int, signature: Ints, i: Int, j: Int) -> int:
    """Return the number of nodes, live constants in both lists, that differ in value; the signatures are `i`, `j`."""
    differing = 0
    for k in range(signature.shape[1]):
        if signature[i, k] == CONSTANT + 1 and signature[j, k] == CONSTANT + 1:
            differing += 1 if parents.constants[p, k] != children.constants[q, k] else 0
    return differing


@inlined
def differing_nodes(parents: Lists, p: Int, children: Lists, q: Int) -> int:
    """Return the number of nodes, live or dead, that differ in operator or arguments; constants are equal."""
    differing = 0
    for k in range(parents.code.shape[1]):
        is_equal = (
            parents.code[p, k] == children.code[q, k]
            and parents.left[p, k] == children.left[q, k]
            and parents.right[p, k] == children.right[q, k]
        )
        differing += 0 if is_equal else 1
    return differing
