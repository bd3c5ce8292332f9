"""Derivatives of programs, as programs: reverse-mode differentiation with the table of operators.

The table has functions for the partial derivatives. These functions are called with nodes of an unfinished program;
arithmetic on these nodes adds further nodes. For derivatives with respect to constants, replace the constants by
variables first, see `with_variables`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from atoll_core.expression import operators as op
from atoll_core.expression.evaluation import value_of
from atoll_core.expression.operators import Functions, Partial, definitions, partial_definitions
from atoll_core.expression.program import Program, ProgramBuilder, constant_places, dependent_nodes


def derivative(program: Program, variable: int) -> Program:
    """Return the derivative with respect to the input variable of this index; 0 if the program does not contain it.

    The derivative may contain `PARTIAL_OPERATORS`, and more nodes than a message allows. The derivative is not finite
    where a partial derivative in the table of operators is not finite.
    """
    draft = _DerivativeDraft()
    output = draft.copy(program.nodes())[-1]
    leaves = [place for place, node in enumerate(draft.nodes) if node[:2] == (op.VARIABLE, variable)]
    depends = dependent_nodes(draft.nodes[: output + 1], leaves)
    adjoints = {output: _Part(draft, draft.constant(1.0))}
    for place in range(output, -1, -1):
        code, *arguments, _ = draft.nodes[place]
        if place not in adjoints or not depends[place] or not op.ARITY[code]:
            continue
        left, right = (_Part(draft, argument) for argument in arguments)
        at = left, right, _Part(draft, place)
        for argument, partial in ((left, _OPERATORS[code].left), (right, _OPERATORS[code].right))[: op.ARITY[code]]:
            if partial.sign and depends[argument.place]:
                share, known = _share(adjoints[place], partial, *at), adjoints.get(argument.place)
                adjoints[argument.place] = share if known is None else known + share
    ends = [adjoints[leaf].place for leaf in leaves if leaf in adjoints]
    return draft.program(ends[0] if ends else draft.constant(0.0))


def with_variables(program: Program, first: int) -> Program:
    """Return `program` with its constants replaced by variables. The new variables have the indices `first`, `first` +
    1, ... in node order."""
    operators, left, constants = program.operators.copy(), program.left.copy(), program.constants.copy()
    places = constant_places(program)
    operators[places], left[places], constants[places] = op.VARIABLE, range(first, first + len(places)), 0.0
    return Program(operators, left, program.right, constants)


class _DerivativeDraft(ProgramBuilder):
    """An unfinished program.

    Factors equal to 1, double signs and operators on constants are left out; this does not change a bit of the values.
    """

    def operate(self, code: int, left: int, right: int = 0) -> int:
        (kind, inner, _, value), (other_kind, other_inner, _, other_value) = self.nodes[left], self.nodes[right]
        if kind == op.CONSTANT and (op.ARITY[code] == 1 or other_kind == op.CONSTANT):
            result = value_of(code, value, other_value)
            if result - result == 0.0:
                return self.constant(result)
        if code == op.NEGATE and kind == op.NEGATE:
            return inner
        if code in (op.MULTIPLY, op.DIVIDE, op.POW) and (other_kind, other_value) == (op.CONSTANT, 1.0):
            return left
        if code == op.MULTIPLY and (kind, value) == (op.CONSTANT, 1.0):
            return right
        if code in (op.MULTIPLY, op.DIVIDE) and op.NEGATE in (kind, other_kind):
            positive = self.operate(
                code, inner if kind == op.NEGATE else left, other_inner if other_kind == op.NEGATE else right
            )
            return positive if kind == other_kind else self.operate(op.NEGATE, positive)
        if code in (op.ADD, op.SUBTRACT) and other_kind == op.NEGATE:
            return self.operate(op.ADD + op.SUBTRACT - code, left, other_inner)
        return super().operate(code, left, right)


@dataclass(frozen=True)
class _Part:
    """A node of a draft; arithmetic on it adds nodes to the draft."""

    draft: _DerivativeDraft
    place: int

    def under(self, code: int, *others: "_Part | float") -> "_Part":
        """Return operator `code` applied to this part and others."""
        places = [part.place if isinstance(part, _Part) else self.draft.constant(part) for part in others]
        return _Part(self.draft, self.draft.operate(code, self.place, *places))

    def __add__(self, other: "_Part") -> "_Part":
        return self.under(op.ADD, other)

    def __sub__(self, other: "_Part | float") -> "_Part":
        return self.under(op.SUBTRACT, other)

    def __rsub__(self, other: float) -> "_Part":
        return _Part(self.draft, self.draft.constant(other)) - self

    def __mul__(self, other: "_Part") -> "_Part":
        return self.under(op.MULTIPLY, other)


def _call(code: int) -> "Callable[..., _Part]":
    return lambda part, *others: part.under(code, *others)


_FUNCTIONS: Final = Functions(
    *map(_call, (op.SIN, op.COS, op.EXP, op.LOG, op.SQRT, op.ABS, op.TANH, op.POW, op.SIGN, op.BASE_LOG))
)
_OPERATORS: Final = {**definitions(_FUNCTIONS), **partial_definitions(_FUNCTIONS)}


def _share(part: _Part, partial: Partial, a: _Part, b: _Part, v: _Part) -> _Part:
    """Return `part`, the adjoint of an operator, times a partial derivative. The product is a part of the adjoint of an
    argument."""
    for factor in partial.factors:
        part = part * factor(a, b, v)
    if partial.divisor is not None:
        part = part.under(op.DIVIDE, partial.divisor(a, b, v))
    return part if partial.sign > 0 else part.under(op.NEGATE)
