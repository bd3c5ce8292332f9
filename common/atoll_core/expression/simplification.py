"""Simplify programs without changing a bit of what they compute: dead nodes, constant parts, equal parts.

No algebra in the sense of the real numbers: ``x - x`` stays, for it is no number where x is infinite. What remains is
the canonical program: nodes in the order in which a reader meets them, left operand first.
"""

from collections.abc import Callable, Iterable
from typing import Final

import numpy as np

from atoll_core.expression.operators import ADD, ARITY, CONSTANT, MULTIPLY, SQUARE, VARIABLE, Functions, definitions
from atoll_core.expression.program import Node, Program

_COMMUTATIVE: Final = frozenset({ADD, MULTIPLY})


def _strict(name: str) -> Callable[..., float]:
    """Return the kernels' elementary function of that name."""

    def function(*arguments: float) -> float:
        # Imported here: it loads the compiler, which programs that only print expressions do not need.
        from atoll_core.expression.kernels import elementary

        value: float = getattr(elementary, f"strict_{name}")(*arguments)
        return value

    return function


_SIN, _COS, _EXP, _LOG, _TANH, _POW = map(_strict, ("sin", "cos", "exp", "log", "tanh", "pow"))
_OPERATORS: Final = definitions(
    Functions(_SIN, _COS, _EXP, _LOG, np.sqrt, np.abs, _TANH, _POW, np.sign, lambda x, _: _LOG(x))
)
"""The operators as the kernels compute them, for single numbers; derivatives are not needed."""


def simplify_program(program: Program, *, merges_constants: bool = True) -> Program:
    """Return the canonical program of the same function: equal on every row, bit for bit.

    Nodes on which the output does not depend go; an operator on constants alone becomes its value, if that is finite;
    equal nodes become one, where ``a + b`` equals ``b + a`` and ``a*a`` equals ``a**2``; equal constants, too, unless
    they are to be fitted apart. Pure and deterministic.
    """
    return simplified(program.nodes(), merges_constants=merges_constants)


def simplified(given: Iterable[Node], *, merges_constants: bool = True) -> Program:
    """Return the same of the program with these nodes: code, arguments (or the variable's index), constant."""
    nodes, output = _distinct_nodes(given, merges_constants)
    order = _reading_order(nodes, output)
    place = {index: position for position, index in enumerate(order)}
    return Program.of(_moved(nodes[index], place) for index in order)


def complexity(program: Program) -> int:
    """Return the number of nodes, operators and terminals, of the canonical program."""
    return len(_reading_order(*_distinct_nodes(program.nodes())))


def _distinct_nodes(given: Iterable[Node], merges_constants: bool = True) -> tuple[list[Node], int]:
    """Return folded nodes without duplicates, and the index of the output among them."""
    nodes: list[Node] = []
    known: dict[tuple[int, int, int, str | None], int] = {}
    place: list[int] = []
    for code, left, right, value in given:
        arity = ARITY[code]
        node = (
            code,
            place[left] if arity else left,
            place[right] if arity == 2 else 0,
            value,
        )
        if arity:
            node = _folded(node, nodes)
        key = _key(node)
        if key not in known or (node[0] == CONSTANT and not merges_constants):
            known[key] = len(nodes)
            nodes.append(node)
        place.append(known[key])
    return nodes, place[-1]


def _key(node: Node) -> tuple[int, int, int, str | None]:
    """Return what makes two nodes equal; constants by their bits, so that 0.0 and -0.0 differ."""
    code, left, right, value = node
    if code == CONSTANT:
        return (code, 0, 0, value.hex())
    if code in _COMMUTATIVE:
        if code == MULTIPLY and left == right:
            return (SQUARE, left, 0, None)
        return (code, min(left, right), max(left, right), None)
    return (code, left, right, None)


def _folded(node: Node, nodes: list[Node]) -> Node:
    """Return a constant in place of an operator on constants, unless its value is not finite."""
    code, left, right, _ = node
    if nodes[left][0] != CONSTANT or (ARITY[code] == 2 and nodes[right][0] != CONSTANT):
        return node
    value = _value(code, nodes[left][3], nodes[right][3])
    # Infinity and NaN both give NaN here.
    return (CONSTANT, 0, 0, value) if value - value == 0.0 else node


def _value(code: int, a: float, b: float) -> float:
    """Return the value of one operator, computed as the kernels do."""
    with np.errstate(all="ignore"):
        return float(_OPERATORS[code].value(np.float64(a), np.float64(b)))


def _reading_order(nodes: list[Node], output: int) -> list[int]:
    """Return the live nodes, operands before operators and left before right."""
    order: list[int] = []
    done: set[int] = set()
    stack = [output]
    while stack:
        index = stack[-1]
        if index in done:
            stack.pop()
            continue
        code, left, right, _ = nodes[index]
        arity = ARITY[code]
        if arity and left not in done:
            stack.append(left)
        elif arity == 2 and right not in done:
            stack.append(right)
        else:
            stack.pop()
            done.add(index)
            order.append(index)
    return order


def _moved(node: Node, place: dict[int, int]) -> Node:
    code, left, right, value = node
    arity = ARITY[code]
    if arity == 0:
        return (code, left if code == VARIABLE else 0, 0, value if code == CONSTANT else 0.0)
    return (code, place[left], place[right] if arity == 2 else 0, 0.0)
