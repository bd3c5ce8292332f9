"""Like terms gathered under one constant: ``x + x`` becomes ``2*x``, whose constant has an error and an interval.

As real algebra allows, like `atoll_coordinator.model.structure.algebra`; for equations that are shown, not for
candidates.
"""

from atoll.expression.builder import ProgramBuilder
from atoll.expression.operators import ADD, ARITY, CONSTANT, MULTIPLY, NEGATE, SUBTRACT
from atoll.expression.program import Node, Program
from atoll_coordinator.model.structure.algebra import tidied

_Term = tuple[float, int]
"""A coefficient and the new node that it is a factor of, -1 for the constant term."""


def gathered(program: Program) -> Program:
    """Return `program` with terms of a sum that differ by a factor alone as one term; itself where there are none."""
    gathering = _Gathering(program.nodes())
    output = gathering.copy(len(program) - 1)
    return tidied(gathering.builder.program(output)) if gathering.has_gathered else program


class _Gathering:
    """Copies a program node by node and joins the terms of its sums."""

    def __init__(self, old: list[Node]) -> None:
        self.has_gathered = False
        self.builder = ProgramBuilder()
        self._old = old
        self._copies: dict[int, int] = {}

    def copy(self, index: int) -> int:
        """Return the new place of an old node."""
        if index not in self._copies:
            self._copies[index] = self._copied(index)
        return self._copies[index]

    def _copied(self, index: int) -> int:
        code, left, right, value = self._old[index]
        if code not in (ADD, SUBTRACT):
            first = self.copy(left) if ARITY[code] else left
            return self.builder.add(code, first, self.copy(right) if ARITY[code] == 2 else right, value)
        terms = self._terms(index, 1.0)
        bases = [base for _, base in terms]
        if len(set(bases)) == len(bases):
            return self.builder.add(code, self.copy(left), self.copy(right))
        self.has_gathered = True
        output: int | None = None
        for base in dict.fromkeys(bases):
            term = self.builder.constant(sum(factor for factor, other in terms if other == base))
            term = term if base < 0 else self.builder.add(MULTIPLY, term, base)
            output = term if output is None else self.builder.add(ADD, output, term)
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
