"""Programs one step away from a given one: what a search that stops near the best description may have missed."""

from collections.abc import Collection, Iterator
from typing import Final

from atoll.expression.operators import ADD, ARITY, CONSTANT, COS, DIVIDE, MULTIPLY, SIN, SUBTRACT, VARIABLE
from atoll.expression.program import Program
from atoll_coordinator.model.structure.rewriting import FRESH, Node, changed, nodes_of, turned

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
    nodes = nodes_of(program)
    yield from changed(
        program,
        nodes,
        operators,
        lambda index: (*_exchanged(nodes, index, variables), *_joined(index, variables)),
    )


def _exchanged(nodes: list[Node], index: int, variables: Collection[int]) -> Iterator[list[Node]]:
    code, left, right, _ = nodes[index]
    if code in (VARIABLE, CONSTANT):
        yield from ([(VARIABLE, other, 0, 0.0)] for other in variables if (code, left) != (VARIABLE, other))
    if code == VARIABLE:
        yield [(CONSTANT, 0, 0, FRESH)]
    if code in _EXCHANGED:
        yield [(_EXCHANGED[code], left, right, 0.0)]
    if code in (SUBTRACT, DIVIDE):
        yield [(code, right, left, 0.0)]
    if code in (SIN, COS) and ARITY[nodes[left][0]] == 2:
        yield from turned(code, index, nodes[left])


def _joined(index: int, variables: Collection[int]) -> Iterator[list[Node]]:
    made = index + 1
    yield [(CONSTANT, 0, 0, _NEAR_ZERO), (ADD, index, made, 0.0)]
    yield [(CONSTANT, 0, 0, _NEAR_ONE), (MULTIPLY, made, index, 0.0)]
    for variable in variables:
        leaf = (VARIABLE, variable, 0, 0.0)
        small = (CONSTANT, 0, 0, _NEAR_ZERO)
        yield [leaf, small, (MULTIPLY, made + 1, made, 0.0), (ADD, index, made + 2, 0.0)]
        yield [leaf, small, (DIVIDE, made + 1, made, 0.0), (ADD, index, made + 2, 0.0)]
        yield [leaf, (MULTIPLY, index, made, 0.0)]
        yield [leaf, (DIVIDE, index, made, 0.0)]
        yield [leaf, (ADD, index, made, 0.0)]
        yield [leaf, (SUBTRACT, index, made, 0.0)]
