"""Programs under construction: nodes are added one after another, and each refers to earlier ones.

`ProgramBuilder` adds what it is told. A subclass may override `operate`, by which all operators are added, to simplify
on the way.
"""

from collections.abc import Hashable, Iterable, Iterator, Sequence
from typing import TypeAlias

from atoll_core.expression.operators import ARITY, CONSTANT, VARIABLE
from atoll_core.expression.program import Node, Program, moved

Expression: TypeAlias = "int | float | tuple[Expression, ...]"
"""What is to be built: a node by its index (int), a constant (float), ``(VARIABLE, index)``, or an operator's code with
its arguments, each an expression itself."""


class ProgramBuilder:
    """The nodes of a program under construction."""

    def __init__(self) -> None:
        self.nodes: list[Node] = []
        self._places: dict[Hashable, int] = {}

    def add(self, code: int, left: int = 0, right: int = 0, value: float = 0.0) -> int:
        """Return the index of a node, which is the earlier one if an equal node (see `key`) was added before."""
        key = self.key(code, left, right, value)
        if key not in self._places:
            self._places[key] = self.append(code, left, right, value)
        return self._places[key]

    def key(self, code: int, left: int, right: int, value: float) -> Hashable:
        """Return what makes two nodes equal; constants are when all their bits are."""
        return code, left, right, value.hex()

    def append(self, code: int, left: int = 0, right: int = 0, value: float = 0.0) -> int:
        """Return the index of a new node, which no later one is merged with: constants may then be fitted apart."""
        self.nodes.append((code, left, right, value))
        return len(self.nodes) - 1

    def constant(self, value: float) -> int:
        """Return the index of a constant."""
        return self.add(CONSTANT, value=value)

    def operate(self, code: int, left: int, right: int = 0) -> int:
        """Return the index of an operator on earlier nodes; `right` is 0 for one of a single argument."""
        return self.add(code, left, right)

    def copy(self, nodes: Iterable[Node], places: Sequence[int] = (), *, merges_constants: bool = True) -> list[int]:
        """Add nodes of another list behind those that are at `places`; return where all of its nodes are now."""
        new = list(places)
        for code, left, right, value in nodes:
            if ARITY[code]:
                new.append(self.operate(code, new[left], new[right] if ARITY[code] == 2 else 0))
            elif code == CONSTANT and not merges_constants:
                new.append(self.append(CONSTANT, value=value))
            else:
                new.append(self.add(code, left, right, value))
        return new

    def build(self, expression: Expression, places: Sequence[int] | None = None) -> int:
        """Add an expression and return its index; with `places`, the nodes in it are those of another list."""
        if isinstance(expression, int):
            return expression if places is None else places[expression]
        if isinstance(expression, float):
            return self.constant(expression)
        code, *arguments = expression
        assert isinstance(code, int)
        if code == VARIABLE:
            assert isinstance(arguments[0], int)
            return self.add(VARIABLE, arguments[0])
        return self.operate(code, *(self.build(argument, places) for argument in arguments))

    def program(self, output: int) -> Program:
        """Return the program of a node: the nodes on which it depends, in their order."""
        return Program.of(live_nodes(self.nodes, output))


def live_nodes(nodes: Sequence[Node], output: int) -> list[Node]:
    """Return the nodes on which `output` depends, in their order, renumbered."""
    needed = {output}
    for index in range(output, -1, -1):
        if index in needed:
            code, left, right, _ = nodes[index]
            needed.update((left, right)[: ARITY[code]])
    place = {old: new for new, old in enumerate(sorted(needed))}
    return [moved(nodes[old], place) for old in place]


def operators_in(expression: Expression) -> Iterator[int]:
    """Yield the codes of the operators of an expression, leaves left out."""
    if isinstance(expression, tuple):
        code, *arguments = expression
        assert isinstance(code, int)
        if ARITY[code]:
            yield code
            for argument in arguments:
                yield from operators_in(argument)
