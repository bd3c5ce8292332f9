"""Writes a program as an operation list of a given shape with given operators, so that a user's guess can be put into a
population.

An operation list begins with its terminals and ends with its output. The operators of a job may not include the
squares, minus signs and quotients of a guess; if possible, these are replaced by other operators. Pure.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from atoll_core.errors import UsageError
from atoll_core.expression import operators as op
from atoll_core.expression.program import Node, Program, ProgramBuilder, live_nodes, moved
from atoll_core.expression.simplification import simplify_program
from atoll_core.expression.text.parsing import from_infix


@dataclass(frozen=True, slots=True)
class PlacedNode:
    """Node `index` of a list. `left` and `right` have the same meaning as in `Program`."""

    index: int
    code: int
    left: int
    right: int
    constant: float


def placed_text(
    text: str, names: Sequence[str], operators: Collection[int], terminals: int, operator_nodes: int
) -> tuple[PlacedNode, ...]:
    """Return the nodes of a list that computes `text` over the symbols `names`, see `placed`.

    Every number becomes a separate constant. If the list has too few nodes for this, equal numbers share one constant.

    Raises:
        UsageError: the text cannot be read or placed.
    """
    try:
        return placed(from_infix(text, names, merges_constants=False), operators, terminals, operator_nodes)
    except UsageError:
        return placed(from_infix(text, names), operators, terminals, operator_nodes)


def placed(program: Program, operators: Collection[int], terminals: int, operator_nodes: int) -> tuple[PlacedNode, ...]:
    """Return the nodes of a list with these operators. The values of the list are the values of `program`, up to
    rounding.

    A list has `terminals` nodes for variables and constants, then `operator_nodes` nodes for operators; its last node
    is the output. Terminals are placed at the beginning of the list, operators at its end. The caller fills the nodes
    between them.

    Raises:
        UsageError: other operators or more nodes are needed. The message has no subject, as in ``has 30 operators, …``.
    """
    nodes = _Rewriting(frozenset(operators)).rewritten(simplify_program(program, merges_constants=False))
    leaves = [index for index, node in enumerate(nodes) if not op.ARITY[node[0]]]
    inner = [index for index, node in enumerate(nodes) if op.ARITY[node[0]]]
    for count, possible, kind, option in (
        (len(leaves), terminals, "different variables and constants", "terminals"),
        (len(inner), operator_nodes, "operators", "operator_nodes"),
    ):
        if count > possible:
            raise UsageError(
                f"has {count} {kind}, but an operation list has room for {possible}; shorten it, or give a job file "
                f"with more {option} in [space]"
            )
    end = terminals + operator_nodes
    place = {old: new for new, old in enumerate(leaves)}
    place |= {old: end - len(inner) + number for number, old in enumerate(inner)}
    return tuple(PlacedNode(new, *moved(nodes[old], place)) for old, new in place.items())


class _Rewriting(ProgramBuilder):
    """Builds a program with the allowed operators. Each constant of the original program has a separate node."""

    def __init__(self, operators: frozenset[int]) -> None:
        super().__init__()
        self._operators = operators

    def rewritten(self, program: Program) -> list[Node]:
        """Return the nodes, the output last; raises UsageError."""
        output = self.copy(program.nodes(), merges_constants=False)[-1]
        if not op.ARITY[self.nodes[output][0]]:  # the output of a list is an operator
            neutral = ((op.MULTIPLY, 1.0), (op.ADD, 0.0), (op.SUBTRACT, 0.0), (op.DIVIDE, 1.0))
            allowed = next((pair for pair in neutral if pair[0] in self._operators), None)
            if allowed is None:
                names = _names(self._operators)
                raise UsageError(
                    f"is a single variable or number, but a list needs an operator, and {names} would change the value"
                )
            output = self.add(allowed[0], output, self.constant(allowed[1]))
        return live_nodes(self.nodes, output)

    def operate(self, code: int, left: int, right: int = 0) -> int:
        """Return the index of a node that has the value of an operator. If necessary, other operators are used."""
        if code in self._operators:
            return self.add(code, left, right)
        node = self._substitute(code, left, right)
        if node is None:
            raise UsageError(
                f"needs '{op.OPERATORS[code].name}', but may be made of {_names(self._operators)} only; "
                "write it otherwise, or allow more operators"
            )
        return node

    def _substitute(self, code: int, left: int, right: int) -> int | None:
        """Return a node that has the value of an operator that is not allowed. None: the operator cannot be
        replaced."""
        match op.OPERATORS[code].name:
            case "square":
                return self._product(left, left)
            case "*":
                return self._product(left, right)
            case "neg":
                return self._negated(left)
            case "-":
                return self._joined(op.ADD, left, right)
            case "+":
                return self._joined(op.SUBTRACT, left, right)
            case "/":
                value = self._value(right)
                if value and abs(1.0 / value) < float("inf"):
                    return self._product(left, self.append(op.CONSTANT, value=1.0 / value))
                if op.INVERSE not in self._operators:
                    return None
                inverse = self.add(op.INVERSE, right)
                return inverse if self._value(left) == 1.0 else self._product(left, inverse)
            case "inverse" if op.DIVIDE in self._operators:
                return self.add(op.DIVIDE, self.constant(1.0), left)
        return None

    def _value(self, node: int) -> float | None:
        return self.nodes[node][3] if self.nodes[node][0] == op.CONSTANT else None

    def _product(self, left: int, right: int) -> int | None:
        if op.MULTIPLY in self._operators:
            return self.add(op.MULTIPLY, left, right)
        return self.add(op.SQUARE, left) if left == right and op.SQUARE in self._operators else None

    def _negated(self, node: int) -> int | None:
        value = self._value(node)
        if value is not None:  # a new constant: it is fitted separately, even if others are equal
            return self.append(op.CONSTANT, value=-value)
        if op.NEGATE in self._operators:
            return self.add(op.NEGATE, node)
        if op.MULTIPLY in self._operators:
            return self.add(op.MULTIPLY, self.constant(-1.0), node)
        return self.add(op.SUBTRACT, self.constant(0.0), node) if op.SUBTRACT in self._operators else None

    def _joined(self, code: int, left: int, right: int) -> int | None:
        """Return ``left - right`` as a sum, or ``left + right`` as a difference; `code` is the operator to use."""
        negated = self._negated(right) if code in self._operators else None
        return None if negated is None else self.add(code, left, negated)


def _names(operators: Collection[int]) -> str:
    return ",".join(op.OPERATORS[code].name for code in sorted(operators))
