"""Programs simplified as real algebra allows: neutral constants gone, signs gathered.

Unlike `atoll.expression.simplification`, which keeps every bit, this is meant for models that are fitted and measured
again: ``1*x`` is ``x`` here, ``x - (-y)`` is ``x + y``, and ``x/4`` is ``0.25*x``.
"""

import math
from collections.abc import Hashable

import numpy as np

from atoll.expression.builder import ProgramBuilder
from atoll.expression.evaluation import value_of
from atoll.expression.operators import ADD, ARITY, CONSTANT, COS, DIVIDE, MULTIPLY, NEGATE, SIN, SUBTRACT
from atoll.expression.program import Program
from atoll.expression.simplification import simplified


def tidied(program: Program) -> Program:
    """Return `program` without neutral elements and needless signs."""
    builder = AlgebraicBuilder()
    return builder.program(builder.copy(program.nodes())[-1])


class AlgebraicBuilder(ProgramBuilder):
    """Builds programs whose operators are simplified by the neutral elements and the rules of signs."""

    def program(self, output: int) -> Program:
        """Return the canonical program of the node `output`."""
        with np.errstate(all="ignore"):
            return simplified(self.nodes[: output + 1])

    def key(self, code: int, left: int, right: int, value: float) -> Hashable:
        """Return what makes two nodes equal: 0.0 and -0.0 are one number here."""
        return code, left, right, value

    def operate(self, code: int, left: int, right: int = 0) -> int:
        """Return the index of a node of the value of this operator, as simple as real algebra allows."""
        folded = self._folded(code, left, right)
        if folded is not None:
            return self.constant(folded)
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
                return self.add(code, left, right)

    def _folded(self, code: int, left: int, right: int) -> float | None:
        """Return the value of an operator on constants; None when it is none, or not finite."""
        if self.nodes[left][0] != CONSTANT or (ARITY[code] == 2 and self.nodes[right][0] != CONSTANT):
            return None
        value = value_of(code, self.nodes[left][3], self.nodes[right][3])
        return value if math.isfinite(value) else None

    def _is(self, node: int, value: float) -> bool:
        code, _, _, its = self.nodes[node]
        return code == CONSTANT and its == value

    def _opposite(self, node: int) -> int | None:
        """Return the node of which `node` is the negative, None when it is no negative."""
        code, left, _, value = self.nodes[node]
        if code == NEGATE:
            return left
        return self.constant(-value) if code == CONSTANT and value < 0.0 else None

    def _sum(self, left: int, right: int) -> int:
        if self._is(left, 0.0):
            return right
        if self._is(right, 0.0):
            return left
        for one, other in ((left, right), (right, left)):
            positive = self._opposite(other)
            if positive is not None and self.nodes[other][0] == NEGATE:
                return self._difference(one, positive)
        return self.add(ADD, left, right)

    def _difference(self, left: int, right: int) -> int:
        if left == right:
            return self.constant(0.0)
        if self._is(right, 0.0):
            return left
        if self._is(left, 0.0):
            return self._negative(right)
        if self.nodes[left][0] == NEGATE:
            return self._negative(self._sum(self.nodes[left][1], right))
        positive = self._opposite(right)
        return self._sum(left, positive) if positive is not None else self.add(SUBTRACT, left, right)

    def _negative(self, node: int) -> int:
        code, left, right, value = self.nodes[node]
        if code == CONSTANT:
            return self.constant(-value)
        if code == NEGATE:
            return left
        return self.add(SUBTRACT, right, left) if code == SUBTRACT else self.add(NEGATE, node)

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
            return self.constant(1.0)
        divisor = self.nodes[right][3] if self.nodes[right][0] == CONSTANT else 0.0
        if divisor != 0.0 and math.isfinite(1.0 / divisor):  # 0.075*x is as simple as a number can be, x/13.3333 not
            return self._product(self.constant(1.0 / divisor), left)
        return self._signed(DIVIDE, left, right)

    def _periodic(self, code: int, argument: int) -> int:
        """Add sin(-u) as -sin(u), cos(-u) as cos(u)."""
        positive = self._mirrored(argument)
        if positive is None:
            return self.add(code, argument)
        node = self.add(code, positive)
        return self._negative(node) if code == SIN else node

    def _mirrored(self, node: int) -> int | None:
        """Return u when the node is -u, or a product with a negative constant; else None."""
        code, left, right, _ = self.nodes[node]
        if code == NEGATE:
            return left
        if code == MULTIPLY:
            for one, other in ((left, right), (right, left)):
                if self.nodes[one][0] == CONSTANT and self.nodes[one][3] < 0.0:
                    return self._product(self.constant(-self.nodes[one][3]), other)
        return None

    def _signed(self, code: int, left: int, right: int) -> int:
        """Add a product or quotient, the sign of an argument that is a negative taken in front of it."""
        negated = [self.nodes[node][0] == NEGATE for node in (left, right)]
        first = self.nodes[left][1] if negated[0] else left
        second = self.nodes[right][1] if negated[1] else right
        node = self.add(code, first, second)
        return self._negative(node) if negated[0] != negated[1] else node
