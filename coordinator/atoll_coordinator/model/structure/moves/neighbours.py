"""Neighbours: programs with one node exchanged. A search may have missed these programs if it stopped near the shortest
description."""

from collections.abc import Collection, Iterator
from typing import Final

from atoll_coordinator.model.structure.moves.replacement import FRESH_CONSTANT, cofunctions, replace_each
from atoll_coordinator.settings import SETTINGS
from atoll_core.expression.operators import ADD, ARITY, CONSTANT, COS, DIVIDE, MULTIPLY, SIN, SUBTRACT, VARIABLE
from atoll_core.expression.program import Expression, Node, Program

_EXCHANGED: Final = {ADD: SUBTRACT, SUBTRACT: ADD, MULTIPLY: DIVIDE, DIVIDE: MULTIPLY, SIN: COS, COS: SIN}


def neighbours(program: Program, variables: Collection[int], operators: Collection[int]) -> Iterator[Program]:
    """Yield, as sums of products, the programs that differ from `program` in one place.

    Each structure is yielded once, and constants are not fitted yet.

    There are three kinds of changes at one node: a leaf is exchanged for another leaf; an operator is exchanged for a
    related operator (+ and -, * and /, sin and cos); or a constant or variable is added or multiplied. Only these
    `variables` (indices) and `operators` (codes) are used.
    """
    nodes = program.nodes()
    yield from replace_each(
        program,
        nodes,
        operators,
        lambda index: (*_exchanges(nodes, index, variables), *_additions(index, variables)),
    )


def _exchanges(nodes: list[Node], index: int, variables: Collection[int]) -> Iterator[Expression]:
    code, left, right, _ = nodes[index]
    if code in (VARIABLE, CONSTANT):
        yield from ((VARIABLE, variable) for variable in variables if (code, left) != (VARIABLE, variable))
    if code == VARIABLE:
        yield FRESH_CONSTANT
    if code in _EXCHANGED:
        yield (_EXCHANGED[code], *(left, right)[: ARITY[code]])
    if code in (SUBTRACT, DIVIDE):
        yield (code, right, left)
    if code in (SIN, COS) and ARITY[nodes[left][0]] == 2:
        yield from cofunctions(code, nodes[left])


def _additions(node: int, variables: Collection[int]) -> Iterator[Expression]:
    yield (ADD, node, SETTINGS.common.negligible)
    yield (MULTIPLY, 1.0 + SETTINGS.common.negligible, node)
    for variable in variables:
        leaf = (VARIABLE, variable)
        yield (ADD, node, (MULTIPLY, SETTINGS.common.negligible, leaf))
        yield (ADD, node, (DIVIDE, SETTINGS.common.negligible, leaf))
        for join in (MULTIPLY, DIVIDE, ADD, SUBTRACT):
            yield (join, node, leaf)
