"""A program as short Python lists, for the few that reach the front: coefficients worked in, parts left out.

Nothing here is in a hot loop; whatever is built is put on a tape and measured again before it is believed.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from atoll_core.expression.operators import ADD, ARITY, CONSTANT, MULTIPLY, NEGATE, SUBTRACT
from atoll_core.expression.program import Program
from atoll_island_worker.evolution.structures import Book, Tape


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
    return _nodes(tape.code[:count], tape.left[:count], tape.right[:count], tape.constants[:count])


def from_book(book: Book, k: int) -> Formula:
    """Return program `k` of `book`."""
    count = int(book.size[k])
    return _nodes(book.code[k, :count], book.left[k, :count], book.right[k, :count], book.constants[k, :count])


def onto_tape(formula: Formula, tape: Tape) -> int:
    """Write `formula` on `tape`; return its number of nodes. The tape must be long enough."""
    for i, node in enumerate(formula):
        tape.code[i], tape.left[i], tape.right[i], tape.constants[i] = node.code, node.left, node.right, node.constant
    return len(formula)


def from_program(program: Program) -> Formula:
    """Return the nodes of `program`."""
    return _nodes(program.operators, program.left, program.right, program.constants)


def _nodes(*columns: npt.NDArray[Any]) -> Formula:
    return tuple(map(Node, *(column.tolist() for column in columns)))


def to_program(formula: Formula) -> Program:
    """Return `formula`, which must have no dead nodes, as a canonical program."""
    return Program(
        np.array([node.code for node in formula], np.int8),
        np.array([node.left for node in formula], np.int16),
        np.array([node.right for node in formula], np.int16),
        np.array([node.constant for node in formula]),
    )


def combine_terms(formula: Formula, terms: Sequence[int], coefficients: Sequence[float], shift: float) -> Formula:
    """Return shift + sum of coefficient times term, the terms being nodes of `formula`; zero ones are left out.

    A positive term comes first where there is one, so that signs become differences. What is dead stays in the list.
    """
    nodes = list(formula)
    pairs = [(node, a) for node, a in zip(terms, coefficients, strict=True) if a != 0.0]
    pairs.sort(key=lambda pair: pair[1] < 0.0)
    top = -1
    for node, a in pairs:
        top = _joined(nodes, top, node, a)
    if top < 0:
        nodes.append(Node(CONSTANT, constant=shift))
    elif shift != 0.0:
        nodes += [Node(CONSTANT, constant=shift), Node(ADD, top, len(nodes))]
    elif top < len(nodes) - 1:
        nodes = nodes[: top + 1]
    return tuple(nodes)


def _joined(nodes: list[Node], top: int, node: int, a: float) -> int:
    """Append what makes ``top + a * node`` (``a * node`` when there is no top yet); return its index."""
    size = abs(a) if top >= 0 else a
    if size == -1.0:
        nodes.append(Node(NEGATE, node))
        node = len(nodes) - 1
    elif size != 1.0:
        nodes += [Node(CONSTANT, constant=size), Node(MULTIPLY, node, len(nodes))]
        node = len(nodes) - 1
    if top < 0:
        return node
    nodes.append(Node(ADD if a > 0.0 else SUBTRACT, top, node))
    return len(nodes) - 1


def reductions(formula: Formula) -> Iterator[Formula]:
    """Yield `formula` with one operator replaced by an argument of it or by a constant, from the output downwards.

    A difference is also replaced by its negative part alone.
    """
    for i in range(len(formula) - 1, -1, -1):
        arity = ARITY[formula[i].code]
        if arity == 0:
            continue
        yield _redirected(formula, i, formula[i].left)
        if arity == 2 and formula[i].right != formula[i].left:
            yield _redirected(formula, i, formula[i].right)
        if formula[i].code == SUBTRACT:
            yield (*formula[:i], Node(NEGATE, formula[i].right), *formula[i + 1 :])
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
