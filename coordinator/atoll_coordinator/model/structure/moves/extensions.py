"""Extensions: programs with one more part. This part is small at first and may grow in a fit."""

import math
from collections.abc import Collection, Iterator, Sequence

from atoll_coordinator.model.structure.moves.replacement import replace_each
from atoll_coordinator.settings import SETTINGS
from atoll_core.expression.operators import (
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
from atoll_core.expression.program import Expression, Node, Program, ProgramBuilder


def extensions(program: Program, scales: Sequence[float], operators: Collection[int]) -> Iterator[Program]:
    """Yield, as sums of products, the programs that differ from `program` by a small part at one node. Each structure
    is yielded once.

    A node n becomes n + c, n + c v, n + c v w, n + c/v, n + c sin v, n (1 + c v) or n/(1 + c v). Here v and w are
    variables, and the constant c makes the new part small compared with n, in any units. Larger changes are n sin v and
    n/sin v. Cosines are treated like sines. Only allowed `operators` (codes) are added. Constants are not fitted yet.

    Args:
        program: a program with as many variables as `scales`.
        scales: the mean absolute value of each variable; 0 for variables that may not be used.
        operators: codes of the operators that may be added.
    """
    nodes = _with_own_leaves(program.nodes())
    sizes = _sizes(nodes, scales)
    yield from replace_each(program, nodes, operators, lambda index: _additions(index, scales, sizes[index]))


def further_terms(program: Program, scales: Sequence[float], operators: Collection[int]) -> Iterator[Program]:
    """Yield, as sums of products, the sums of `program` and one more term, linear terms first. Each structure is
    yielded once.

    With variables v and w and a constant c, a term is c v, then c, then c v w. The constant makes the term small
    compared with the program, in any units.

    Args:
        program: a program with as many variables as `scales`.
        scales: the mean absolute value of each variable; 0 for variables that may not be used.
        operators: codes of the operators that may be added.
    """
    nodes = _with_own_leaves(program.nodes())
    root, size = len(nodes) - 1, _sizes(nodes, scales)[-1]
    terms = list(_terms(root, scales, size))
    yield from replace_each(program, nodes, operators, lambda index: terms if index == root else ())


def _terms(node: int, scales: Sequence[float], size: float) -> Iterator[Expression]:
    """Yield the sums of a node of this size and a small term."""
    little = SETTINGS.common.negligible * size
    leaves: list[tuple[Expression, float]] = [((VARIABLE, v), scale) for v, scale in enumerate(scales) if scale > 0.0]
    yield from ((ADD, node, (MULTIPLY, little / scale, leaf)) for leaf, scale in leaves)
    yield (ADD, node, little)
    for place, (leaf, scale) in enumerate(leaves):
        for partner, partner_scale in leaves[: place + 1]:
            yield (ADD, node, (MULTIPLY, little / (scale * partner_scale), (MULTIPLY, leaf, partner)))


def leaps(program: Program, operators: Collection[int]) -> Iterator[Program]:
    """Yield, as sums of products, a few programs with larger changes; their fits need many steps. Each structure is
    yielded once.

    A variable is replaced by its sine or cosine. A sine or cosine is replaced by the first terms of its Taylor series,
    with new constants. Only allowed `operators` (codes) are added.
    """
    nodes = _with_own_leaves(program.nodes())
    yield from replace_each(program, nodes, operators, lambda index: _leaps_at(nodes, index))


def _additions(node: int, scales: Sequence[float], size: float) -> Iterator[Expression]:
    """Yield the expressions that may replace a node of this size."""
    little = SETTINGS.common.negligible * size
    yield (ADD, node, little)
    for v, scale in enumerate(scales):
        if not scale > 0.0:
            continue
        leaf: Expression = (VARIABLE, v)
        yield (ADD, node, (MULTIPLY, little / scale, leaf))
        factor: Expression = (
            ADD,
            1.0 + SETTINGS.common.negligible,
            (MULTIPLY, SETTINGS.common.negligible / scale, leaf),
        )
        yield (DIVIDE, node, factor)
        yield (MULTIPLY, node, factor)
        yield (ADD, node, (DIVIDE, little * scale, leaf))
        for code in (SIN, COS):
            yield (ADD, node, (MULTIPLY, little, (code, leaf)))
        for code in (SIN, COS):
            for join in (MULTIPLY, DIVIDE):
                yield (join, node, (code, leaf))
        for w, partner_scale in enumerate(scales[: v + 1]):
            if partner_scale > 0.0:
                yield (ADD, node, (MULTIPLY, little / (scale * partner_scale), (MULTIPLY, leaf, (VARIABLE, w))))


def _sizes(nodes: Sequence[Node], scales: Sequence[float]) -> list[float]:
    """Return the approximate size of each node; a sum is as large as its larger part, and an unknown size is 1."""
    sizes: list[float] = []
    for code, left, right, value in nodes:
        if code == VARIABLE:
            size = scales[left]
        elif code == CONSTANT:
            size = abs(value)
        else:
            size = _size_of(code, sizes[left], sizes[right] if ARITY[code] == 2 else 0.0)
        sizes.append(size if 0.0 < size < math.inf else 1.0)
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
    """Return the nodes with a separate leaf for every use, so that a single use can be changed."""
    builder = ProgramBuilder()
    places: list[int] = []
    for code, left, right, value in nodes:
        arguments = [
            places[argument] if ARITY[nodes[argument][0]] else builder.append(*nodes[argument])
            for argument in (left, right)[: ARITY[code]]
        ]
        places.append(builder.append(code, *arguments) if arguments else builder.append(code, left, right, value))
    return builder.nodes


def _leaps_at(nodes: list[Node], index: int) -> Iterator[Expression]:
    """For a variable, yield its sine and its cosine. For a sine or a cosine, yield the first terms of its Taylor
    series."""
    code, u, *_ = nodes[index]
    if code == VARIABLE:
        yield from ((function, index) for function in (SIN, COS))
    if code == COS:
        yield (ADD, 1.0 + SETTINGS.common.negligible, (MULTIPLY, -0.5, (MULTIPLY, u, u)))
    if code == SIN:
        yield (MULTIPLY, u, (ADD, 1.0 + SETTINGS.common.negligible, (MULTIPLY, -1.0 / 6.0, (MULTIPLY, u, u))))
