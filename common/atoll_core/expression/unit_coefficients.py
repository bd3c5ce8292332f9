"""Write out the coefficients that are 1 and are not written: without these coefficients, standard errors would be too
small.

In ``3*x - x**2`` the coefficient 1 of x**2 was estimated from the data just like the 3 of x. Standard errors are
therefore computed for all coefficients together: each term of a sum has one coefficient, and a product outside of a sum
has one coefficient. Factors inside functions stay implicit. If one of several factors is redundant, as a in a*(b*x +
c*y), one of these factors stays implicit.
"""

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import Final

from atoll_core.expression import operators as op
from atoll_core.expression.program import Node, Program, ProgramBuilder, constant_places, with_constants
from atoll_core.expression.writing.shortest import collected

ONE: Final = 1.0


@dataclass(frozen=True, eq=False)
class ExplicitCoefficients:
    """A program whose factors equal to 1 are constants.

    `origins` has for each constant of `program`, in node order, its number among the constants of the original program;
    None for a new factor equal to 1. `terms` has the terms of these new factors, in the same order.
    """

    program: Program
    origins: tuple[int | None, ...]
    terms: tuple[Program, ...]


def make_coefficients_explicit(program: Program) -> ExplicitCoefficients:
    """Return `program` with its factors equal to 1 as constants; it has the same values."""
    draft = _CoefficientDraft(program.nodes())
    output = draft.rewrite(len(program) - 1, has_factor=False)
    return draft.finished(output)


def write_factors(explicit: ExplicitCoefficients, fitted: Program, chosen: Collection[int]) -> Program:
    """Return the original program with the factors of the `chosen` terms written out; the other factors are 1.

    `fitted` is the program of `explicit` with other values of constants.
    """
    places = constant_places(fitted)
    factors = [place for place, origin in zip(places, explicit.origins, strict=True) if origin is None]
    rest = {place: ONE for term, place in enumerate(factors) if term not in chosen}
    return collected(with_constants(fitted, rest))


def as_written(program: Program) -> ExplicitCoefficients:
    """Return `program` without new factors."""
    return ExplicitCoefficients(program, tuple(range(len(constant_places(program)))), ())


class _CoefficientDraft:
    """A program under construction: nodes of the original are copied where they are needed, each constant once."""

    def __init__(self, old: list[Node]) -> None:
        self._old = old
        constants = (place for place, node in enumerate(old) if node[0] == op.CONSTANT)
        self._numbers = {place: number for number, place in enumerate(constants)}
        self._new = ProgramBuilder()
        self._copies: dict[int, int] = {}
        self._origins: dict[int, int | None] = {}
        self._terms: dict[int, int] = {}

    def rewrite(self, index: int, *, has_factor: bool) -> int:
        """Return the new place of an old node, made explicit; `has_factor`: a constant scales it already."""
        code, left, right, _ = self._old[index]
        if code == op.CONSTANT:
            return self._copy(index)
        if code in (op.ADD, op.SUBTRACT):
            return self._sum(index, next(self._without_factor(index), None) if has_factor else None)
        if code == op.NEGATE:
            return self._new.append(op.NEGATE, self.rewrite(left, has_factor=has_factor))
        if code == op.MULTIPLY:
            return self._product(index, has_factor=has_factor)
        if code == op.DIVIDE:
            above = self.rewrite(left, has_factor=has_factor or self._scales(right))
            return self._new.append(op.DIVIDE, above, self._scaled(right))
        return self._copy(index) if has_factor else self._factored(self._copy(index))

    def finished(self, output: int) -> ExplicitCoefficients:
        """Return the program that ends with the node `output`."""
        program = self._new.program(output)
        places = [index for index, node in enumerate(self._new.nodes[: output + 1]) if node[0] == op.CONSTANT]
        terms = [self._new.program(self._terms[place]) for place in places if self._origins[place] is None]
        return ExplicitCoefficients(program, tuple(self._origins[place] for place in places), tuple(terms))

    def _sum(self, index: int, spared: int | None) -> int:
        """Add factors in a sum; the term `spared` stays implicit, since another constant scales the whole sum."""
        code, left, right, _ = self._old[index]
        if code in (op.ADD, op.SUBTRACT):
            return self._new.append(code, self._sum(left, spared), self._sum(right, spared))
        return self.rewrite(index, has_factor=index == spared)

    def _without_factor(self, index: int) -> Iterator[int]:
        """Yield the terms of a sum that have no constant factor."""
        code, left, right, _ = self._old[index]
        if code in (op.ADD, op.SUBTRACT):
            yield from self._without_factor(left)
            yield from self._without_factor(right)
        elif not self._holds_factor(index):
            yield index

    def _product(self, index: int, *, has_factor: bool) -> int:
        """Give a product a factor, and return its new place.

        If the product has a constant, this constant is the factor. If not, and if the product contains a sum, the terms
        of this sum get factors. In all other cases the whole product gets a factor.
        """
        _, left, right, _ = self._old[index]
        if has_factor or self._holds_factor(index):
            return self._new.append(op.MULTIPLY, self._scaled(left), self._scaled(right))
        first, second = (left, right) if self._holds_sum(left) else (right, left)
        if not self._holds_sum(first):
            return self._factored(self._copy(index))
        return self._new.append(op.MULTIPLY, self.rewrite(first, has_factor=False), self._scaled(second))

    def _scaled(self, index: int) -> int:
        """Return the new place of a node that has a factor already."""
        return self.rewrite(index, has_factor=True)

    def _holds_factor(self, index: int) -> bool:
        """Tell whether constants scale a product, quotient or negative."""
        code, left, right, _ = self._old[index]
        if code == op.MULTIPLY:
            return self._holds_factor(left) or self._holds_factor(right)
        if code == op.DIVIDE:
            return self._holds_factor(left) or self._scales(right)
        return self._holds_factor(left) if code == op.NEGATE else code == op.CONSTANT

    def _scales(self, index: int) -> bool:
        """Tell whether every term of a divisor has a constant factor. These constants together act as a factor of the
        numerator."""
        code, left, right, _ = self._old[index]
        if code in (op.ADD, op.SUBTRACT):
            return self._scales(left) and self._scales(right)
        if code in (op.MULTIPLY, op.DIVIDE):
            return self._scales(left) or self._scales(right)
        return self._scales(left) if code in (op.NEGATE, op.SQUARE) else code == op.CONSTANT

    def _holds_sum(self, index: int) -> bool:
        """Tell whether a product or the numerator of a quotient contains a sum."""
        code, left, right, _ = self._old[index]
        if code == op.MULTIPLY:
            return self._holds_sum(left) or self._holds_sum(right)
        if code in (op.DIVIDE, op.NEGATE):
            return self._holds_sum(left)
        return code in (op.ADD, op.SUBTRACT)

    def _copy(self, index: int) -> int:
        """Return the new place of an old node as it is."""
        if index not in self._copies:
            code, left, right, value = self._old[index]
            if op.ARITY[code]:
                left = self._copy(left)
                right = self._copy(right) if op.ARITY[code] == 2 else 0
            self._copies[index] = self._new.append(code, left, right, value)
            if code == op.CONSTANT:
                self._origins[self._copies[index]] = self._numbers[index]
        return self._copies[index]

    def _factored(self, place: int) -> int:
        factor = self._new.append(op.CONSTANT, value=ONE)
        self._origins[factor] = None
        self._terms[factor] = place
        return self._new.append(op.MULTIPLY, factor, place)
