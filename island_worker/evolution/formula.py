"""A program as short Python lists, for the few that reach the front: scaling worked in, parts left out.

Nothing here is in a hot loop; whatever is built is put on a tape and measured again before it is believed.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from common.expression.operators import ADD, ARITY, CONSTANT, DIVIDE, MULTIPLY, SUBTRACT
from common.expression.program import Program
from island_worker.evolution.structures import Tape


@dataclass(frozen=True)
class Node:
    """One node: operator code, arguments (or the variable's index), and the value of a constant."""

    code: int
    left: int = 0
    right: int = 0
    constant: float = 0.0


Formula = tuple[Node, ...]
"""Nodes in order; the last is the output."""


def from_tape(tape: Tape, count: int) -> Formula:
    """Return the first `count` nodes of `tape`."""
    columns = (tape.code[:count], tape.left[:count], tape.right[:count], tape.constants[:count])
    return tuple(map(Node, *(column.tolist() for column in columns)))


def onto_tape(formula: Formula, tape: Tape) -> int:
    """Write `formula` on `tape`; return its number of nodes. The tape must be long enough."""
    for i, node in enumerate(formula):
        tape.code[i], tape.left[i], tape.right[i], tape.constants[i] = node.code, node.left, node.right, node.constant
    return len(formula)


def to_program(formula: Formula) -> Program:
    """Return `formula`, which must have no dead nodes, as a canonical program."""
    return Program(
        np.array([node.code for node in formula], np.int8),
        np.array([node.left for node in formula], np.int16),
        np.array([node.right for node in formula], np.int16),
        np.array([node.constant for node in formula]),
    )


def scaled(formula: Formula, a: float, b: float) -> Formula:
    """Return a * formula + b with as few nodes as will do; what becomes dead stays in the list.

    A constant summand of `formula` joins b, a constant factor joins a, a difference changes sides when a is -1.
    """
    factor, formula, shift = _without_shift(formula)
    b += a * shift
    a *= factor
    factor, formula = _without_factor(formula)
    a *= factor
    if a == -1.0 and formula[-1].code == SUBTRACT:
        top = formula[-1]
        formula, a = (*formula[:-1], Node(SUBTRACT, top.right, top.left)), 1.0
    formula = formula if a == 1.0 else _joined(MULTIPLY, formula, a)
    return formula if b == 0.0 else _joined(ADD, formula, b)


def _joined(code: int, formula: Formula, constant: float) -> Formula:
    top = len(formula) - 1
    return (*formula, Node(CONSTANT, constant=constant), Node(code, top, top + 1))


def _rooted(formula: Formula, root: int) -> Formula:
    return formula[: root + 1]


def _without_shift(formula: Formula) -> tuple[float, Formula, float]:
    """Return sign, rest and constant so that formula = sign * rest + constant."""
    top = formula[-1]
    if top.code in (ADD, SUBTRACT):
        left, right = formula[top.left], formula[top.right]
        sign = 1.0 if top.code == ADD else -1.0
        if right.code == CONSTANT:
            return 1.0, _rooted(formula, top.left), sign * right.constant
        if left.code == CONSTANT:
            return sign, _rooted(formula, top.right), left.constant
    return 1.0, formula, 0.0


def _without_factor(formula: Formula) -> tuple[float, Formula]:
    """Return factor and rest so that formula = factor * rest."""
    top = formula[-1]
    if top.code in (MULTIPLY, DIVIDE):
        left, right = formula[top.left], formula[top.right]
        if right.code == CONSTANT:
            return (right.constant if top.code == MULTIPLY else 1.0 / right.constant), _rooted(formula, top.left)
        if left.code == CONSTANT and top.code == MULTIPLY:
            return left.constant, _rooted(formula, top.right)
    return 1.0, formula


def reductions(formula: Formula) -> Iterator[Formula]:
    """Yield `formula` with one operator replaced by an argument of it or by a constant, from the output downwards."""
    for i in range(len(formula) - 1, -1, -1):
        arity = ARITY[formula[i].code]
        if arity == 0:
            continue
        yield _redirected(formula, i, formula[i].left)
        if arity == 2 and formula[i].right != formula[i].left:
            yield _redirected(formula, i, formula[i].right)
        yield (*formula[:i], Node(CONSTANT, constant=1.0), *formula[i + 1 :])


def _redirected(formula: Formula, old: int, new: int) -> Formula:
    """Return `formula` with every use of node `old` turned to the earlier node `new`."""
    if old == len(formula) - 1:
        return formula[: new + 1]

    def turned(node: Node) -> Node:
        arity = ARITY[node.code]
        left = new if arity > 0 and node.left == old else node.left
        right = new if arity > 1 and node.right == old else node.right
        return Node(node.code, left, right, node.constant)

    return (*formula[: old + 1], *(turned(node) for node in formula[old + 1 :]))
