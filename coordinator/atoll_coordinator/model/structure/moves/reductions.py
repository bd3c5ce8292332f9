"""Reductions: smaller programs with one part removed."""

from collections.abc import Iterator
from itertools import chain
from typing import Final

from atoll_coordinator.model.structure.moves.replacement import FRESH_CONSTANT, cofunctions, replace_nodes
from atoll_core.expression.operators import ADD, ARITY, CONSTANT, COS, DIVIDE, MULTIPLY, NEGATE, SIN, SUBTRACT
from atoll_core.expression.program import Expression, Node, Program, structure

_NEUTRAL: Final = (0.0, 1.0, -1.0)


def reductions(program: Program) -> Iterator[Program]:
    """Yield smaller programs as sums of products, beginning with changes at the output node. Each structure is yielded
    once, and constants are not fitted yet.

    An operator is replaced by an argument or a constant; a constant is replaced by 0, 1 or -1; a common factor of two
    terms is factored out; the cosine of a multiple becomes a square; the sum of a constant and a quotient becomes one
    quotient; a factor c + u with a constant c is multiplied out as 1 + u.
    """
    nodes = program.nodes()
    known = {structure(program)}
    one_by_one = (
        {index: replacement} for index in range(len(nodes) - 1, -1, -1) for replacement in _reductions_at(nodes, index)
    )
    for replacements in chain(one_by_one, _saturations(nodes)):
        reduced = replace_nodes(nodes, replacements)
        if _weight(reduced) < _weight(program) and structure(reduced) not in known:
            known.add(structure(reduced))
            yield reduced


def _weight(program: Program) -> tuple[int, int]:
    """Return the number of nodes and the number of their uses."""
    return len(program), sum(ARITY[code] for code in program.operators.tolist())


def _reductions_at(nodes: list[Node], index: int) -> Iterator[Expression]:
    """Yield the expressions that may replace node `index`."""
    code, left, right, _ = nodes[index]
    if code == CONSTANT:
        yield from _NEUTRAL
    if not ARITY[code]:
        return
    yield from dict.fromkeys((left, right)[: ARITY[code]])
    yield FRESH_CONSTANT
    if code == SUBTRACT:
        yield (NEGATE, right)
    if code in (ADD, SUBTRACT):
        yield from _factorizations(nodes, index)
    if code == MULTIPLY:
        yield from _expansions(nodes, index)
    if code in (SIN, COS) and ARITY[nodes[left][0]] == 2:
        yield from cofunctions(code, nodes[left])


def _expansions(nodes: list[Node], index: int, constant: int | None = None) -> Iterator[Expression]:
    """Yield a + a u for a product a (c + u), and likewise for differences: c is set to 1. Only the node `constant` is
    used as c; None: any constant is used."""
    _, left, right, _ = nodes[index]
    for factor, other in dict.fromkeys(((left, right), (right, left))):
        code, first, second, _ = nodes[other]
        if code not in (ADD, SUBTRACT):
            continue
        for number, u in ((first, second), (second, first)):
            if nodes[number][0] == CONSTANT and nodes[u][0] != CONSTANT and constant in (None, number):
                product: Expression = (MULTIPLY, factor, u)
                yield (code, factor, product) if number == first else (code, product, factor)


def multiply_out(program: Program, constant: int) -> Iterator[Program]:
    """Yield programs in which one product is multiplied out. A factor of this product is a sum with the node
    `constant`, which is set to 1.

    The programs have one constant less: b (y - x**2 y) instead of b y (c - x**2).
    """
    nodes = program.nodes()
    for index, (code, *_) in enumerate(nodes):
        if code == MULTIPLY:
            yield from (replace_nodes(nodes, {index: sum_}) for sum_ in _expansions(nodes, index, constant))


def _saturations(nodes: list[Node]) -> Iterator[dict[int, Expression]]:
    """Yield replacements of the sum of a constant k and a quotient a/(b + u) by k u/(b + u), and likewise for a/(b -
    u). Both expressions are equal if k b = -a.
    """
    added = [
        place
        for code, *parts, _ in nodes
        if code in (ADD, SUBTRACT)
        for place in parts
        if nodes[place][0] == CONSTANT and nodes[place][3]
    ]
    for index, (code, above, below, _) in enumerate(nodes):
        if code != DIVIDE or nodes[above][0] != CONSTANT or nodes[below][0] not in (ADD, SUBTRACT):
            continue
        join, *parts, _ = nodes[below]
        for constant, argument in (parts, parts[::-1]):
            if nodes[constant][0] != CONSTANT or not nodes[constant][3]:
                continue
            sign = -1.0 if join == ADD else 1.0
            factor = sign * nodes[above][3] / nodes[constant][3]
            saturated: Expression = (DIVIDE, (MULTIPLY, factor, argument), below)
            yield from ({place: 0.0, index: saturated} for place in added if place != constant)


def _factorizations(nodes: list[Node], index: int) -> Iterator[Expression]:
    """Yield f (a + b) for a sum f a + f b, and likewise for differences and quotients; a and b may be 1."""
    code, left, right, _ = nodes[index]
    for factor, join, a in _factors(nodes, left):
        for right_factor, right_join, b in _factors(nodes, right):
            if (factor, join) == (right_factor, right_join):
                yield (join, (code, a, b), factor)


def _factors(nodes: list[Node], node: int) -> list[tuple[int, int, Expression]]:
    """Return (f, MULTIPLY or DIVIDE, a) for each way to write the node as a*f or a/f; a may be 1."""
    code, left, right, _ = nodes[node]
    if code == MULTIPLY:
        return [(left, MULTIPLY, right), (right, MULTIPLY, left), (node, MULTIPLY, 1.0)]
    if code == DIVIDE:
        return [(right, DIVIDE, left), (node, MULTIPLY, 1.0)]
    return [(node, MULTIPLY, 1.0)]
