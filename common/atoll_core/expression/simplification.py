"""Simplify programs without changing a bit of their values: remove unused nodes, evaluate constant parts, and join
equal parts.

No algebra of real numbers is used: ``x - x`` is kept, because it is NaN if x is infinite. The result is the canonical
program: its nodes are in reading order, left operand first.
"""

import math
from collections.abc import Callable, Hashable
from typing import Final

import numpy as np

from atoll_core.expression.operators import ADD, ARITY, CONSTANT, MULTIPLY, SQUARE, Functions, definitions
from atoll_core.expression.program import Node, Program, ProgramBuilder, moved


def _strict(name: str) -> Callable[..., float]:
    """Return the elementary function of this name that the kernels use."""

    def function(*arguments: float) -> float:
        # Imported here, because the import loads the compiler, which is not needed to print expressions.
        from atoll_core.expression.kernels import elementary

        value: float = getattr(elementary, f"strict_{name}")(*arguments)
        return value

    return function


_SIN, _COS, _EXP, _LOG, _TANH, _POW = map(_strict, ("sin", "cos", "exp", "log", "tanh", "pow"))
_OPERATORS: Final = definitions(
    Functions(_SIN, _COS, _EXP, _LOG, np.sqrt, np.abs, _TANH, _POW, np.sign, lambda x, _: _LOG(x))
)
"""The operators as the kernels compute them, for single numbers."""


def simplify_program(program: Program, *, merges_constants: bool = True) -> Program:
    """Return the canonical program of the same function; its values are equal on every row, bit for bit.

    Nodes on which the output does not depend are removed. An operator on constants is replaced by its value, if this
    value is finite. Equal nodes are joined; ``a + b`` counts as equal to ``b + a``, and ``a*a`` as equal to ``a**2``.
    If `merges_constants`, equal constants are also joined; otherwise they are kept, and can be fitted separately. Pure
    and deterministic.
    """
    builder = _Simplifier(merges_constants)
    output = builder.copy(program.nodes(), merges_constants=merges_constants)[-1]
    place = {old: new for new, old in enumerate(_reading_order(builder.nodes, output))}
    return Program.of(moved(builder.nodes[old], place) for old in place)


def complexity(program: Program) -> int:
    """Return the number of nodes, operators and terminals, of the canonical program."""
    return len(simplify_program(program))


class _Simplifier(ProgramBuilder):
    """Nodes without duplicates, and constants in place of operators on constants."""

    def __init__(self, merges_constants: bool) -> None:
        super().__init__()
        self._add_value = self.add if merges_constants else self.append

    def key(self, code: int, left: int, right: int, value: float) -> Hashable:
        if code == MULTIPLY and left == right:
            code, right = SQUARE, 0
        elif code in (ADD, MULTIPLY) and right < left:
            left, right = right, left
        return super().key(code, left, right, value)

    def operate(self, code: int, left: int, right: int = 0) -> int:
        """Return the index of an operator. If its arguments are constants, return the index of its value, computed as
        in the kernels."""
        (kind, _, _, a), (other_kind, _, _, b) = self.nodes[left], self.nodes[right]
        if kind == CONSTANT and (ARITY[code] == 1 or other_kind == CONSTANT):
            with np.errstate(all="ignore"):
                value = float(_OPERATORS[code].value(np.float64(a), np.float64(b)))
            if math.isfinite(value):
                return self._add_value(CONSTANT, value=value)
        return super().operate(code, left, right)


def _reading_order(nodes: list[Node], output: int) -> list[int]:
    """Return the used nodes, operands before operators and left before right."""
    order: dict[int, None] = {}
    stack = [output]
    while stack:
        code, *arguments, _ = nodes[stack[-1]]
        waiting = next((argument for argument in arguments[: ARITY[code]] if argument not in order), None)
        if waiting is None:
            order[stack.pop()] = None
        else:
            stack.append(waiting)
    return list(order)
