"""A program as an operation list of a given shape, made of given operators: how a guess comes into a population.

An operation list begins with its terminals and ends with its output. What people write uses squares, minus signs and
quotients that the operators of a job may lack; where others can take their place, they do. Pure.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Final

from atoll.errors import UsageError
from atoll.expression.operators import (
    ADD,
    ARITY,
    CONSTANT,
    DIVIDE,
    INVERSE,
    MULTIPLY,
    NEGATE,
    OPERATORS,
    SQUARE,
    SUBTRACT,
)
from atoll.expression.program import Program
from atoll.expression.simplification import simplify_program
from atoll.expression.text.parsing import from_infix


@dataclass(frozen=True, slots=True)
class PlacedNode:
    """Node `index` of a list; for terminals and operators `left` and `right` are as in `Program`."""

    index: int
    code: int
    left: int
    right: int
    constant: float


def placed_text(
    text: str, names: Sequence[str], operators: Collection[int], terminals: int, operator_nodes: int
) -> tuple[PlacedNode, ...]:
    """Return the nodes of a list that computes what `text` says over the symbols `names`, see `placed`.

    Every number in it is a constant of its own; where there is no room for that, equal ones are one constant.

    Raises:
        UsageError: the text cannot be read or placed.
    """
    try:
        apart = from_infix(text, names, merges_constants=False)
        return placed(apart, operators, terminals, operator_nodes)
    except UsageError:
        return placed(from_infix(text, names), operators, terminals, operator_nodes)


def placed(program: Program, operators: Collection[int], terminals: int, operator_nodes: int) -> tuple[PlacedNode, ...]:
    """Return the nodes of a list that computes what `program` does, up to rounding.

    Terminals come first, operators last; what lies between is the caller's.

    Args:
        program: any valid program.
        operators: codes that the list may use.
        terminals: nodes at the beginning of a list, which hold variables and constants.
        operator_nodes: nodes after them; the last one is the output.

    Raises:
        UsageError: other operators would be needed, or more nodes; a sentence without its subject, such as
            ``has 30 operators, …``.
    """
    rows = _Writing(frozenset(operators)).written(simplify_program(program, merges_constants=False))
    leaves = [index for index, row in enumerate(rows) if not ARITY[row[0]]]
    inner = [index for index, row in enumerate(rows) if ARITY[row[0]]]
    for found, possible, what in (
        (len(leaves), terminals, "different variables and constants"),
        (len(inner), operator_nodes, "operators"),
    ):
        if found > possible:
            raise UsageError(f"has {found} {what}, but an operation list has room for {possible}; shorten it")
    end = terminals + operator_nodes
    place = {old: new for new, old in enumerate(leaves)}
    place |= {old: end - len(inner) + number for number, old in enumerate(inner)}
    return tuple(_moved(rows[old], new, place) for old, new in place.items())


_Row = tuple[int, int, int, float]


def _moved(row: _Row, index: int, place: dict[int, int]) -> PlacedNode:
    code, left, right, value = row
    if not ARITY[code]:
        return PlacedNode(index, code, left, 0, value)
    return PlacedNode(index, code, place[left], place[right] if ARITY[code] == 2 else 0, 0.0)


class _Writing:
    """Writes a program anew with the operators at hand; equal nodes are written once, but for its constants."""

    def __init__(self, operators: frozenset[int]) -> None:
        self._operators = operators
        self._rows: list[_Row] = []
        self._known: dict[tuple[int, int, int, str], int] = {}

    def written(self, program: Program) -> list[_Row]:
        """Return the rows, the output last; raises UsageError."""
        place: list[int] = []
        columns = (program.operators, program.left, program.right, program.constants)
        for code, left, right, value in zip(*(column.tolist() for column in columns), strict=True):
            if ARITY[code]:
                place.append(self._operation(code, place[left], place[right] if ARITY[code] == 2 else 0))
            else:
                place.append(self._number(value) if code == CONSTANT else self._add(code, left))
        if not ARITY[self._rows[place[-1]][0]]:
            place[-1] = self._unchanged(place[-1])
        return self._live(place[-1])

    def _add(self, code: int, left: int, right: int = 0, value: float = 0.0) -> int:
        key = (code, left, right, value.hex())
        if key not in self._known:
            self._known[key] = len(self._rows)
            self._rows.append((code, left, right, value))
        return self._known[key]

    def _number(self, value: float) -> int:
        """Return a new constant, which is fitted apart from equal ones."""
        self._rows.append((CONSTANT, 0, 0, value))
        return len(self._rows) - 1

    def _constant(self, value: float) -> int:
        """Return the constant that stands for an operator wherever it is needed."""
        return self._add(CONSTANT, 0, 0, value)

    def _value(self, node: int) -> float | None:
        return self._rows[node][3] if self._rows[node][0] == CONSTANT else None

    def _operation(self, code: int, left: int, right: int) -> int:
        if code in self._operators:
            return self._add(code, left, right)
        substitute = _SUBSTITUTES.get(code)
        node = substitute(self, left, right) if substitute is not None else None
        if node is None:
            raise UsageError(
                f"needs '{OPERATORS[code].name}', but may be made of {_names(self._operators)} only; "
                "write it otherwise, or allow more operators"
            )
        return node

    def _product(self, left: int, right: int) -> int | None:
        if MULTIPLY in self._operators:
            return self._add(MULTIPLY, left, right)
        return self._add(SQUARE, left) if left == right and SQUARE in self._operators else None

    def _negated(self, node: int) -> int | None:
        value = self._value(node)
        if value is not None:
            return self._number(-value)
        if NEGATE in self._operators:
            return self._add(NEGATE, node)
        if MULTIPLY in self._operators:
            return self._add(MULTIPLY, self._constant(-1.0), node)
        return self._add(SUBTRACT, self._constant(0.0), node) if SUBTRACT in self._operators else None

    def _joined(self, code: int, left: int, right: int) -> int | None:
        """Return ``left - right`` as a sum, or ``left + right`` as a difference; `code` is the operator to use."""
        negated = self._negated(right) if code in self._operators else None
        return None if negated is None else self._add(code, left, negated)

    def _quotient(self, left: int, right: int) -> int | None:
        value = self._value(right)
        if value and abs(1.0 / value) < float("inf"):
            return self._product(left, self._number(1.0 / value))
        if INVERSE not in self._operators:
            return None
        inverse = self._add(INVERSE, right)
        return inverse if self._value(left) == 1.0 else self._product(left, inverse)

    def _inverse(self, node: int) -> int | None:
        return self._add(DIVIDE, self._constant(1.0), node) if DIVIDE in self._operators else None

    def _unchanged(self, leaf: int) -> int:
        """Return an operation with the value of a variable or constant: the output of a list is no terminal."""
        for code, value in ((MULTIPLY, 1.0), (ADD, 0.0), (SUBTRACT, 0.0), (DIVIDE, 1.0)):
            if code in self._operators:
                return self._add(code, leaf, self._constant(value))
        raise UsageError(f"is a single variable or number, which {_names(self._operators)} cannot leave as it is")

    def _live(self, output: int) -> list[_Row]:
        """Return the rows on which `output` depends, in their order."""
        needed = {output}
        for index in range(output, -1, -1):
            if index in needed:
                code, left, right, _ = self._rows[index]
                needed.update((left, right)[: ARITY[code]])
        place = {old: new for new, old in enumerate(sorted(needed))}
        return [self._renumbered(self._rows[old], place) for old in place]

    @staticmethod
    def _renumbered(row: _Row, place: dict[int, int]) -> _Row:
        code, left, right, value = row
        if not ARITY[code]:
            return row
        return (code, place[left], place[right] if ARITY[code] == 2 else 0, value)


_SUBSTITUTES: Final[dict[int, Callable[[_Writing, int, int], int | None]]] = {
    SQUARE: lambda its, left, _: its._product(left, left),
    MULTIPLY: lambda its, left, right: its._product(left, right),
    NEGATE: lambda its, left, _: its._negated(left),
    SUBTRACT: lambda its, left, right: its._joined(ADD, left, right),
    ADD: lambda its, left, right: its._joined(SUBTRACT, left, right),
    DIVIDE: lambda its, left, right: its._quotient(left, right),
    INVERSE: lambda its, left, _: its._inverse(left),
}


def _names(operators: Collection[int]) -> str:
    return ",".join(OPERATORS[code].name for code in sorted(operators))
