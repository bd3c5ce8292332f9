"""Programs with one more part, next to nothing at first: what a fit near a given program can grow into."""

import math
from collections.abc import Collection, Iterator, Sequence
from typing import Final

from atoll.expression.operators import (
    ABS,
    ADD,
    ARITY,
    CONSTANT,
    COS,
    DIVIDE,
    INVERSE,
    MULTIPLY,
    NEGATE,
    SIN,
    SQRT,
    SQUARE,
    SUBTRACT,
    VARIABLE,
)
from atoll.expression.program import Program
from atoll_coordinator.model.structure.rewriting import Node, changed, nodes_of

SMALL: Final = 1e-3
"""Size of a new part beside what it is joined to."""

_NEAR_ONE: Final = 1.0001
"""A constant that is going to be fitted; exactly one would not stay."""


def extensions(program: Program, scales: Sequence[float], operators: Collection[int]) -> Iterator[Program]:
    """Yield programs that differ from `program` by a small part at one node, tidied; each structure once.

    A node n becomes n + c, n + c v, n + c v w, n + c/v, n + c sin v, n (1 + c v) or n/(1 + c v) with variables v and w
    and a constant c that makes the new part small beside n, whatever the units; or, which is no small change, n sin v
    or n/sin v; cosines likewise. Only the `operators` (codes) that are allowed are brought in. Constants wait for a
    fit.

    Args:
        program: over as many variables as there are `scales`.
        scales: the size of each variable; 0 for those that may not be used.
        operators: codes of operators that may be brought in.
    """
    nodes = _with_own_leaves(nodes_of(program))
    sizes = _sizes(nodes, scales)
    yield from changed(program, nodes, operators, lambda index: _joined(index, scales, sizes[index]))


def leaps(program: Program, operators: Collection[int]) -> Iterator[Program]:
    """Yield the few programs that take more steps of a fit to show what they are worth, tidied; each structure once.

    A variable becomes its sine or cosine; a sine or cosine the beginning of its Taylor series, with constants of its
    own. Only the `operators` (codes) that are allowed are brought in.
    """
    nodes = _with_own_leaves(nodes_of(program))
    yield from changed(program, nodes, operators, lambda index: _opened(nodes, index))


def _joined(index: int, scales: Sequence[float], size: float) -> Iterator[list[Node]]:
    """Yield the nodes to put behind node `index`, of that size, the first of which is `index` + 1."""
    a, b, c, d, e = range(index + 1, index + 6)
    little = SMALL * size
    yield [(CONSTANT, 0, 0, little), (ADD, index, a, 0.0)]
    for v, scale in enumerate(scales):
        if not scale > 0.0:
            continue
        leaf: Node = (VARIABLE, v, 0, 0.0)
        yield [(CONSTANT, 0, 0, little / scale), leaf, (MULTIPLY, a, b, 0.0), (ADD, index, c, 0.0)]
        part: list[Node] = [(CONSTANT, 0, 0, SMALL / scale), leaf, (MULTIPLY, a, b, 0.0)]
        yield [*part, (CONSTANT, 0, 0, _NEAR_ONE), (ADD, d, c, 0.0), (DIVIDE, index, e, 0.0)]
        yield [*part, (CONSTANT, 0, 0, _NEAR_ONE), (ADD, d, c, 0.0), (MULTIPLY, index, e, 0.0)]
        yield [(CONSTANT, 0, 0, little * scale), leaf, (DIVIDE, a, b, 0.0), (ADD, index, c, 0.0)]
        for code in (SIN, COS):
            yield [(CONSTANT, 0, 0, little), leaf, (code, b, 0, 0.0), (MULTIPLY, a, c, 0.0), (ADD, index, d, 0.0)]
        for code in (SIN, COS):
            for join in (MULTIPLY, DIVIDE):
                yield [leaf, (code, a, 0, 0.0), (join, index, b, 0.0)]
        for w, other in enumerate(scales[: v + 1]):
            if other > 0.0:
                factor: Node = (CONSTANT, 0, 0, little / (scale * other))
                pair: list[Node] = [factor, leaf, (VARIABLE, w, 0, 0.0), (MULTIPLY, b, c, 0.0), (MULTIPLY, a, d, 0.0)]
                yield [*pair, (ADD, index, e, 0.0)]


def _sizes(nodes: Sequence[Node], scales: Sequence[float]) -> list[float]:
    """Return about how large each node is, sums being as large as their larger part; 1 where that cannot be told."""
    sizes: list[float] = []
    for code, left, right, value in nodes:
        if code == VARIABLE:
            its = scales[left]
        elif code == CONSTANT:
            its = abs(value)
        else:
            its = _size_of(code, sizes[left], sizes[right] if ARITY[code] == 2 else 0.0)
        sizes.append(its if 0.0 < its < math.inf else 1.0)
    return sizes


def _size_of(code: int, first: float, second: float) -> float:
    if code in (ADD, SUBTRACT):
        return max(first, second)
    if code == MULTIPLY:
        return first * second
    if code == DIVIDE:
        return first / second
    if code in (NEGATE, ABS):
        return first
    if code == SQUARE:
        return first * first
    if code == INVERSE:
        return 1.0 / first
    if code == SQRT:
        return math.sqrt(first)
    return 1.0


def _with_own_leaves(nodes: list[Node]) -> list[Node]:
    """Return the nodes with a leaf of its own for every use of one, so that a single use can be changed."""
    found: list[Node] = []
    place: list[int] = []
    for code, left, right, value in nodes:
        arguments: list[int] = []
        for argument in (left, right)[: ARITY[code]]:
            if ARITY[nodes[argument][0]]:
                arguments.append(place[argument])
            else:
                found.append(nodes[argument])
                arguments.append(len(found) - 1)
        first, second, *_ = (*arguments, 0, 0) if ARITY[code] else (left, right)
        found.append((code, first, second, value))
        place.append(len(found) - 1)
    return found


def _opened(nodes: list[Node], index: int) -> Iterator[list[Node]]:
    """Yield the sine and the cosine of a variable; the beginnings of the Taylor series of a sine and of a cosine."""
    kind, n, *_ = nodes[index]
    a, b, c, d, e = range(index + 1, index + 6)
    if kind == VARIABLE:
        for code in (SIN, COS):
            yield [(code, index, 0, 0.0)]
    if kind == COS:
        yield [(CONSTANT, 0, 0, -0.5), (MULTIPLY, n, n, 0.0), (MULTIPLY, a, b, 0.0), (CONSTANT, 0, 0, _NEAR_ONE),
               (ADD, d, c, 0.0)]  # fmt: skip
    if kind == SIN:
        yield [(CONSTANT, 0, 0, -1.0 / 6.0), (MULTIPLY, n, n, 0.0), (MULTIPLY, a, b, 0.0), (CONSTANT, 0, 0, _NEAR_ONE),
               (ADD, d, c, 0.0), (MULTIPLY, n, e, 0.0)]  # fmt: skip
