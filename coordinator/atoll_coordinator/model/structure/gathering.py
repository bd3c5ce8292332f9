"""Like terms gathered under one constant: ``x + x`` becomes ``2*x``, whose constant has an error and an interval.

As real algebra allows, like `atoll_coordinator.model.structure.rewriting`; for equations that are shown, not for
candidates.
"""

import numpy as np

from atoll.expression.operators import ADD, ARITY, CONSTANT, MULTIPLY, NEGATE, SUBTRACT
from atoll.expression.program import Program
from atoll_coordinator.model.structure.rewriting import Node, nodes_of, tidied

_Term = tuple[float, int]
"""A coefficient and the new node that it is a factor of, -1 for the constant term."""


def gathered(program: Program) -> Program:
    """Return `program` with terms of a sum that differ by a factor alone as one term; itself where there are none."""
    draft = _Gathering(nodes_of(program))
    output = draft.copy(len(program) - 1)
    return tidied(draft.program(output)) if draft.has_gathered else program


class _Gathering:
    """A program under construction: equal nodes are one, and sums are made of their terms."""

    def __init__(self, old: list[Node]) -> None:
        self.has_gathered = False
        self._old = old
        self._new: list[Node] = []
        self._places: dict[Node, int] = {}
        self._copies: dict[int, int] = {}

    def copy(self, index: int) -> int:
        """Return the new place of an old node."""
        if index not in self._copies:
            self._copies[index] = self._copied(index)
        return self._copies[index]

    def program(self, output: int) -> Program:
        """Return the program of a new node."""
        codes, lefts, rights, values = zip(*self._new[: output + 1], strict=True)
        return Program(
            np.array(codes, np.int8), np.array(lefts, np.int16), np.array(rights, np.int16), np.array(values)
        )

    def _copied(self, index: int) -> int:
        code, left, right, value = self._old[index]
        if code not in (ADD, SUBTRACT):
            first = self.copy(left) if ARITY[code] else left
            return self._add((code, first, self.copy(right) if ARITY[code] == 2 else right, value))
        terms = self._terms(index, 1.0)
        bases = [base for _, base in terms]
        if len(set(bases)) == len(bases):
            return self._add((code, self.copy(left), self.copy(right), 0.0))
        self.has_gathered = True
        sums = {base: sum(factor for factor, other in terms if other == base) for base in bases}
        output: int | None = None
        for base, factor in sums.items():
            constant = self._add((CONSTANT, 0, 0, factor))
            term = constant if base < 0 else self._add((MULTIPLY, constant, base, 0.0))
            output = term if output is None else self._add((ADD, output, term, 0.0))
        assert output is not None
        return output

    def _terms(self, index: int, sign: float) -> list[_Term]:
        """Return the terms of an old sum, or of a node that is none."""
        code, left, right, value = self._old[index]
        if code in (ADD, SUBTRACT):
            return [*self._terms(left, sign), *self._terms(right, sign if code == ADD else -sign)]
        if code == NEGATE:
            return self._terms(left, -sign)
        if code == CONSTANT:
            return [(sign * value, -1)]
        if code == MULTIPLY:
            for factor, rest in ((left, right), (right, left)):
                if self._old[factor][0] == CONSTANT:
                    return [(sign * self._old[factor][3], self.copy(rest))]
        return [(sign, self.copy(index))]

    def _add(self, node: Node) -> int:
        if node not in self._places:
            self._places[node] = len(self._new)
            self._new.append(node)
        return self._places[node]
