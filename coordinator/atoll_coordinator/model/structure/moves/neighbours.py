"""Programs one step away from a given one: what a search that stops near the best description may have missed."""

from collections.abc import Collection, Iterator
from typing import Final

from atoll.expression.builder import Expression
from atoll.expression.operators import ADD, ARITY, CONSTANT, COS, DIVIDE, MULTIPLY, SIN, SUBTRACT, VARIABLE
from atoll.expression.program import Node, Program
from atoll_coordinator.model.structure.moves.reductions import FRESH
from atoll_coordinator.model.structure.moves.replacement import cofunctions, replace_each

_NEAR_ONE: Final = 1.001
_NEAR_ZERO: Final = 0.001
"""Values of new constants that leave the program nearly as it is, so that the fit begins near the old one."""

_EXCHANGED: Final = {ADD: SUBTRACT, SUBTRACT: ADD, MULTIPLY: DIVIDE, DIVIDE: MULTIPLY, SIN: COS, COS: SIN}


def neighbours(program: Program, variables: Collection[int], operators: Collection[int]) -> Iterator[Program]:
    """Yield programs that differ from `program` in one place, tidied; each structure once. Their constants want to be
    fitted.

    At one node a leaf is exchanged for another, an operator for its relative, or a constant or variable is joined to
    it. Only `variables` (their indices) and `operators` (codes) are brought in.
    """
    nodes = program.nodes()
    yield from replace_each(
        program,
        nodes,
        operators,
        lambda index: (*_exchanged(nodes, index, variables), *_joined(index, variables)),
    )


def _exchanged(nodes: list[Node], index: int, variables: Collection[int]) -> Iterator[Expression]:
    code, left, right, _ = nodes[index]
    if code in (VARIABLE, CONSTANT):
        yield from ((VARIABLE, other) for other in variables if (code, left) != (VARIABLE, other))
    if code == VARIABLE:
        yield FRESH
    if code in _EXCHANGED:
        yield (_EXCHANGED[code], *(left, right)[: ARITY[code]])
    if code in (SUBTRACT, DIVIDE):
        yield (code, right, left)
    if code in (SIN, COS) and ARITY[nodes[left][0]] == 2:
        yield from cofunctions(code, nodes[left])


def _joined(node: int, variables: Collection[int]) -> Iterator[Expression]:
    yield (ADD, node, _NEAR_ZERO)
    yield (MULTIPLY, _NEAR_ONE, node)
    for variable in variables:
        leaf = (VARIABLE, variable)
        yield (ADD, node, (MULTIPLY, _NEAR_ZERO, leaf))
        yield (ADD, node, (DIVIDE, _NEAR_ZERO, leaf))
        for join in (MULTIPLY, DIVIDE, ADD, SUBTRACT):
            yield (join, node, leaf)
