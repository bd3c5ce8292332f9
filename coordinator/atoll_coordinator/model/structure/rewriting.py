"""Programs rewritten as real algebra allows: neutral constants gone, signs gathered, parts left out.

Unlike `atoll.expression.simplification`, which keeps every bit, this is meant for models that are fitted and measured
again: ``1*x`` is ``x`` here, ``x - (-y)`` is ``x + y``, and ``x/4`` is ``0.25*x``.
"""

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from typing import Final

import numpy as np

from atoll.expression.operators import ADD, ARITY, CONSTANT, COS, DIVIDE, MULTIPLY, NEGATE, SIN, SUBTRACT
from atoll.expression.program import Program
from atoll.expression.simplification import simplified
from atoll_coordinator.model.regression.gradient import value_of

Node = tuple[int, int, int, float]
"""Operator code, arguments (or the variable's index), value of a constant."""

FRESH: Final = 1.5
"""Value of a constant that is going to be fitted; not a neutral one, which would not stay."""

_NEUTRAL: Final = (0.0, 1.0, -1.0)


def nodes_of(program: Program) -> list[Node]:
    """Return the nodes of `program`."""
    columns = (program.operators, program.left, program.right, program.constants)
    return list(zip(*(column.tolist() for column in columns), strict=True))


def constant_places(program: Program) -> list[int]:
    """Return the indices of the constants of `program`."""
    return np.flatnonzero(program.operators == np.int8(CONSTANT)).tolist()


def with_constants(program: Program, values: Mapping[int, float]) -> Program:
    """Return `program` with other values at the constants of these indices, otherwise as it is."""
    constants = program.constants.copy()
    for place, value in values.items():
        constants[place] = value
    return Program(program.operators, program.left, program.right, constants)


def tidied(program: Program, values: Mapping[int, float] | None = None) -> Program:
    """Return `program`, with `values` at these constants, without neutral elements and needless signs."""
    draft = _Draft()
    return draft.program(draft.copy(nodes_of(program), values or {}))


def reductions(program: Program) -> Iterator[Program]:
    """Yield smaller programs, tidied, whose constants want to be fitted; each structure once, from the output down.

    An operator gives way to an argument or a constant, a constant to 0, 1 or -1; a factor that two terms share is
    taken out of their sum; the cosine of a multiple becomes a square.
    """
    nodes = nodes_of(program)
    known = {structure(program)}
    for index in range(len(nodes) - 1, -1, -1):
        for made in _reduced_at(nodes, index):
            reduced = rebuilt(nodes, index, made)
            if _weight(reduced) < _weight(program) and structure(reduced) not in known:
                known.add(structure(reduced))
                yield reduced


def _weight(program: Program) -> tuple[int, int]:
    """Return the number of nodes and that of their uses."""
    return len(program), sum(ARITY[code] for code in program.operators.tolist())


def _reduced_at(nodes: list[Node], index: int) -> Iterator[list[Node]]:
    """Yield what may take the place of node `index`."""
    code, left, right, _ = nodes[index]
    if code == CONSTANT:
        yield from ([(CONSTANT, 0, 0, value)] for value in _NEUTRAL)
    if not ARITY[code]:
        return
    for argument in dict.fromkeys((left, right)[: ARITY[code]]):
        yield [nodes[argument]]
    yield [(CONSTANT, 0, 0, FRESH)]
    if code == SUBTRACT:
        yield [(NEGATE, right, 0, 0.0)]
    if code in (ADD, SUBTRACT):
        yield from _factored(nodes, index)
    if code in (SIN, COS) and ARITY[nodes[left][0]] == 2:
        yield from turned(code, index, nodes[left])


def turned(code: int, index: int, argument: Node) -> Iterator[list[Node]]:
    """Yield what the sine or cosine of a sum or a product may be: its cofunction, its negative, or a square.

    For sin(u + pi/2) = cos u, sin(u + pi) = -sin u, and cos 2u = 2 cos^2 u - 1.
    """
    kind, *parts, _ = argument
    for part in parts:
        if kind in (ADD, SUBTRACT):
            for its in (SIN, COS):
                yield [(its, part, 0, 0.0)]
                yield [(its, part, 0, 0.0), (NEGATE, index + 1, 0, 0.0)]
        if code == COS:
            yield [(COS, part, 0, 0.0), (MULTIPLY, index + 1, index + 1, 0.0)]


def _factored(nodes: list[Node], index: int) -> Iterator[list[Node]]:
    """Yield f (a + b) for a sum f a + f b, where a and b may be 1, and likewise for differences and quotients."""
    code, left, right, _ = nodes[index]
    one = (CONSTANT, 0, 0, 1.0)
    for factor, kind, a in _factors(nodes, left):
        for other, its_kind, b in _factors(nodes, right):
            if (factor, kind) != (other, its_kind):
                continue
            first, second = (index + 1 if its is None else its for its in (a, b))
            total = (code, first, second, 0.0)
            yield [one, total, (kind, index + 2, factor, 0.0)]


def _factors(nodes: list[Node], node: int) -> list[tuple[int, int, int | None]]:
    """Return (f, MULTIPLY or DIVIDE, a) for each way to write the node as a f or a/f; a is None for 1."""
    code, left, right, _ = nodes[node]
    if code == MULTIPLY:
        return [(left, MULTIPLY, right), (right, MULTIPLY, left), (node, MULTIPLY, None)]
    if code == DIVIDE:
        return [(right, DIVIDE, left), (node, MULTIPLY, None)]
    return [(node, MULTIPLY, None)]


def rebuilt(nodes: list[Node], index: int, made: list[Node]) -> Program:
    """Return the tidied program in which the last node of `made` stands for node `index`.

    Nodes of `made` refer to nodes up to `index`, the old one included, and to each other: the first is `index` + 1.
    """
    shift = len(made)
    place = [*range(index), index + shift, *range(index + 1 + shift, len(nodes) + shift)]

    def moved(node: Node) -> Node:
        code, left, right, value = node
        return (code, place[left], place[right] if ARITY[code] == 2 else 0, value) if ARITY[code] else node

    draft = _Draft()
    return draft.program(draft.copy([*nodes[: index + 1], *made, *map(moved, nodes[index + 1 :])], {}))


def changed(
    program: Program, nodes: list[Node], operators: Collection[int], makes: Callable[[int], Iterable[list[Node]]]
) -> Iterator[Program]:
    """Yield the programs in which one node gives way to what `makes` returns of it, tidied; each structure once.

    Args:
        program: the one to be changed, which is not yielded itself.
        nodes: its nodes.
        operators: codes; nothing else is brought in.
        makes: by the index of a node, what may take its place, as `rebuilt` wants it.
    """
    known = {structure(program)}
    for index in range(len(nodes)):
        for made in makes(index):
            if any(ARITY[code] and code not in operators for code, *_ in made):
                continue
            its = rebuilt(nodes, index, made)
            if structure(its) not in known:
                known.add(structure(its))
                yield its


def structure(program: Program) -> bytes:
    """Return what tells programs apart that differ in more than the values of their constants."""
    return program.operators.tobytes() + program.left.tobytes() + program.right.tobytes()


class _Draft:
    """An operation list under construction. Its operations know the neutral elements and the signs."""

    def __init__(self) -> None:
        self._nodes: list[Node] = []
        self._places: dict[Node, int] = {}

    def program(self, output: int) -> Program:
        """Return the canonical program of the node `output`."""
        with np.errstate(all="ignore"):
            return simplified(self._nodes[: output + 1])

    def copy(self, nodes: list[Node], values: Mapping[int, float]) -> int:
        """Add all `nodes`, with `values` at these constants; return the place of the last."""
        place: list[int] = []
        for index, (code, left, right, value) in enumerate(nodes):
            if not ARITY[code]:
                place.append(self._add(code, left, right, values.get(index, value)))
            else:
                place.append(self._operate(code, place[left], place[right] if ARITY[code] == 2 else 0))
        return place[-1]

    def _add(self, code: int, left: int = 0, right: int = 0, value: float = 0.0) -> int:
        node = (code, left, right, value)
        place = self._places.setdefault(node, len(self._nodes))
        if place == len(self._nodes):
            self._nodes.append(node)
        return place

    def _operate(self, code: int, left: int, right: int) -> int:
        folded = self._folded(code, left, right)
        if folded is not None:
            return self._add(CONSTANT, value=folded)
        match code:
            case c if c == ADD:
                return self._sum(left, right)
            case c if c == SUBTRACT:
                return self._difference(left, right)
            case c if c == MULTIPLY:
                return self._product(left, right)
            case c if c == DIVIDE:
                return self._quotient(left, right)
            case c if c == NEGATE:
                return self._negative(left)
            case c if c in (SIN, COS):
                return self._periodic(code, left)
            case _:
                return self._add(code, left, right)

    def _folded(self, code: int, left: int, right: int) -> float | None:
        """Return the value of an operator on constants; None when it is none, or not finite."""
        if self._nodes[left][0] != CONSTANT or (ARITY[code] == 2 and self._nodes[right][0] != CONSTANT):
            return None
        value = value_of(code, self._nodes[left][3], self._nodes[right][3])
        return value if math.isfinite(value) else None

    def _is(self, node: int, value: float) -> bool:
        code, _, _, its = self._nodes[node]
        return code == CONSTANT and its == value

    def _opposite(self, node: int) -> int | None:
        """Return the node of which `node` is the negative, None when it is no negative."""
        code, left, _, value = self._nodes[node]
        if code == NEGATE:
            return left
        return self._add(CONSTANT, value=-value) if code == CONSTANT and value < 0.0 else None

    def _sum(self, left: int, right: int) -> int:
        if self._is(left, 0.0):
            return right
        if self._is(right, 0.0):
            return left
        for one, other in ((left, right), (right, left)):
            positive = self._opposite(other)
            if positive is not None and self._nodes[other][0] == NEGATE:
                return self._difference(one, positive)
        return self._add(ADD, left, right)

    def _difference(self, left: int, right: int) -> int:
        if left == right:
            return self._add(CONSTANT)
        if self._is(right, 0.0):
            return left
        if self._is(left, 0.0):
            return self._negative(right)
        if self._nodes[left][0] == NEGATE:
            return self._negative(self._sum(self._nodes[left][1], right))
        positive = self._opposite(right)
        return self._sum(left, positive) if positive is not None else self._add(SUBTRACT, left, right)

    def _negative(self, node: int) -> int:
        code, left, right, value = self._nodes[node]
        if code == CONSTANT:
            return self._add(CONSTANT, value=-value)
        if code == NEGATE:
            return left
        return self._add(SUBTRACT, right, left) if code == SUBTRACT else self._add(NEGATE, node)

    def _product(self, left: int, right: int) -> int:
        for one, other in ((left, right), (right, left)):
            if self._is(one, 0.0):
                return one
            if self._is(one, 1.0):
                return other
            if self._is(one, -1.0):
                return self._negative(other)
        return self._signed(MULTIPLY, left, right)

    def _quotient(self, left: int, right: int) -> int:
        if self._is(left, 0.0) or self._is(right, 1.0):
            return left
        if self._is(right, -1.0):
            return self._negative(left)
        if left == right:
            return self._add(CONSTANT, value=1.0)
        divisor = self._nodes[right][3] if self._nodes[right][0] == CONSTANT else 0.0
        if divisor != 0.0 and math.isfinite(1.0 / divisor):  # 0.075*x is as simple as a number can be, x/13.3333 not
            return self._product(self._add(CONSTANT, value=1.0 / divisor), left)
        return self._signed(DIVIDE, left, right)

    def _periodic(self, code: int, argument: int) -> int:
        """Add sin(-u) as -sin(u), cos(-u) as cos(u)."""
        positive = self._mirrored(argument)
        if positive is None:
            return self._add(code, argument)
        node = self._add(code, positive)
        return self._negative(node) if code == SIN else node

    def _mirrored(self, node: int) -> int | None:
        """Return u when the node is -u, or a product with a negative constant; else None."""
        code, left, right, _ = self._nodes[node]
        if code == NEGATE:
            return left
        if code == MULTIPLY:
            for one, other in ((left, right), (right, left)):
                if self._nodes[one][0] == CONSTANT and self._nodes[one][3] < 0.0:
                    return self._product(self._add(CONSTANT, value=-self._nodes[one][3]), other)
        return None

    def _signed(self, code: int, left: int, right: int) -> int:
        """Add a product or quotient, the sign of an argument that is a negative taken in front of it."""
        negated = [self._nodes[node][0] == NEGATE for node in (left, right)]
        first = self._nodes[left][1] if negated[0] else left
        second = self._nodes[right][1] if negated[1] else right
        node = self._add(code, first, second)
        return self._negative(node) if negated[0] != negated[1] else node
