"""An equation as an expanded sum of terms, in which each constant has a separate meaning.

In ``x*(3 - 2*y)`` the coefficient of x*y is a product of two numbers and a sign; in ``3*x - 2*x*y`` it is one constant.
The constants of the expanded form are the *coefficients* of terms and the numbers *inside* terms: in divisors, powers
and arguments of functions. Sums in divisors, and sums that are factors and cannot be expanded, are normalised: they are
divided by the coefficient of their first term with a variable. For example, ``x/(4 + 2*y)`` becomes ``0.5*x/(2 + y)``.
"""

from collections import Counter
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import reduce
from typing import Final, TypeAlias

from atoll_core.expression import operators as op
from atoll_core.expression.program import MAX_NODES, Program, ProgramBuilder, structure
from atoll_core.expression.writing.layout import in_order
from atoll_core.expression.writing.shortest import sum_of
from atoll_core.expression.writing.sums_of_products import (
    ONE,
    Atom,
    Monomial,
    Sum,
    UndefinedError,
    add,
    contained,
    distribute,
    merged,
    nonzero,
)

MOST_TERMS: Final = 40
"""Most terms of an expanded sum; larger sums are not expanded."""

Shape = Hashable
"""The form of a term without its numbers."""
Path: TypeAlias = tuple[tuple[str, int], ...]


@dataclass(frozen=True)
class Role:
    """The meaning of a constant of an expanded program.

    The coefficient of the term with this `shape` is `sign` times the value of the constant. If `is_inner`, this product
    is a number inside the term instead. `path` is the position of the number inside the term: factor, sum, term and so
    on. In a path, each part is identified by its shape, and equal shapes are numbered. So a path does not change if
    other numbers lead to another order of the parts.
    """

    shape: Shape
    sign: float
    is_inner: bool
    path: Path = ()


@dataclass(frozen=True, eq=False)
class Expansion:
    """The expanded `program` and the role of each of its constants, in node order.

    `units` are the roles of unwritten numbers 1 and -1 inside terms; the `sign` of such a role is the number.
    """

    program: Program
    roles: tuple[Role, ...]
    units: tuple[Role, ...] = ()


IsWritten = Callable[[Shape, float], bool]
"""A function of the shape of a term and its coefficient, which is 1 or -1. It tells whether the coefficient is written
as a constant."""


def terms_of(program: Program) -> Sum:
    """Return the terms of a program with their coefficients; raises UndefinedError if it cannot be expanded."""
    return expand_sum(sum_of(program))


@contained
def expand_sum(terms: Sum) -> Sum:
    """Return a sum without brackets in its numerators. Raises UndefinedError if the sum has more than `MOST_TERMS`
    terms."""
    while True:
        powers = ((place, power) for place, (monomial, _) in enumerate(terms) for power in monomial)
        bracket = next((found for found in powers if found[1][0][0] == op.ADD and found[1][1] > 0), None)
        if bracket is None:
            return terms
        place, (atom, exponent) = bracket
        monomial, coefficient = terms[place]
        rest = [(other, count) for other, count in monomial if other != atom]
        rest += [(atom, exponent - 1)] * (exponent > 1)
        product = distribute(((tuple(sorted(rest)), coefficient),), atom[1])
        terms = add((1.0, (*terms[:place], *terms[place + 1 :])), (1.0, product))
        if len(terms) > MOST_TERMS:
            raise UndefinedError


def shape_of(monomial: Monomial) -> Shape:
    """Return a term without its numbers."""
    return tuple(sorted(((_atom_shape(atom), count) for atom, count in monomial), key=repr))


def _atom_shape(atom: Atom) -> Shape:
    kind, *rest = atom
    if kind == op.VARIABLE:
        return atom
    return (kind, *(tuple(sorted((shape_of(monomial) for monomial, _ in inner), key=repr)) for inner in rest))


def form_of(program: Program) -> Hashable:
    """Return the form of a program. Programs have the same form if they differ only in their writing and in the values
    of constants.

    Brackets in numerators are expanded: ``0.1*y*(x - 4)`` has the form of ``0.1*x*y - 0.4*y``. If a program cannot be
    expanded, its form is the structure of its nodes.
    """
    try:
        return tuple(sorted((shape_of(monomial) for monomial, _ in terms_of(program)), key=repr))
    except UndefinedError:
        return structure(program)


def inner_numbers(terms: Sum) -> list[float]:
    """Return the numbers inside the terms of a sum, except the numbers that normalisation sets to 1."""
    return [number for monomial, _ in terms for atom, _ in monomial for number in _numbers(atom)]


def _numbers(atom: Atom) -> list[float]:
    kind, *rest = atom
    if kind == op.VARIABLE:
        return []
    numbers: list[float] = []
    for inner in rest:
        leads = (monomial for monomial, _ in inner if monomial != ONE and kind == op.ADD)
        lead = next(leads, None)  # normalisation sets this coefficient to 1
        numbers += [
            coefficient
            for monomial, coefficient in inner
            if monomial != lead and (monomial == ONE or abs(coefficient) != 1.0)
        ]
        numbers += inner_numbers(inner)
    return numbers


def raised_quotients(terms: Sum) -> Iterator[tuple[Shape, Sum]]:
    """Find each quotient n/(c + u) in a sum that also has a term n. Yield the shape of n*u/(c + u), and the sum in
    which this term replaces the quotient.

    The number of terms does not grow: n/(c + u) is (n - n*u/(c + u))/c.
    """
    factors = dict(terms)
    for monomial, factor in terms:
        for atom, count in monomial:
            below = dict(atom[1]) if atom[0] == op.ADD and count == -1 and len(atom[1]) == 2 else {}
            constant = below.pop(ONE, 0.0)
            rest = merged(power for power in monomial if power[0] != atom)
            if constant and rest in factors:
                ((lead, number),) = below.items()
                others = tuple(term for term in terms if term[0] != monomial)
                with suppress(UndefinedError):
                    raised = merged([*rest, *lead, (atom, -1)])
                    instead = ((rest, nonzero(factor / constant)), (raised, nonzero(-factor * number / constant)))
                    yield shape_of(raised), add((1.0, others), (1.0, instead))


def expand_program(program: Program, is_written: IsWritten = lambda *_: False) -> Expansion | None:
    """Return the expanded form of a program. None if the program cannot be expanded, or if the form is too large.

    `is_written` tells which coefficients equal to 1 or -1 become constants.
    """
    try:
        return write_expansion(terms_of(program), is_written)
    except UndefinedError:
        return None


def write_expansion(terms: Sum, is_written: IsWritten = lambda *_: False) -> Expansion | None:
    """Return the program of an expanded sum, as `expand_program` does."""
    try:
        return _built(terms, is_written)
    except UndefinedError:
        return None


@contained
def _built(terms: Sum, is_written: IsWritten) -> Expansion | None:
    builder = _Builder(is_written)
    output = builder.sum_of_terms(terms)
    if len(builder.nodes) > MAX_NODES:
        return None
    return Expansion(builder.program(output), tuple(builder.roles), tuple(builder.units))


class _Builder(ProgramBuilder):
    """Writes sums, with a separate node for each constant, and records the roles of constants."""

    def __init__(self, is_written: IsWritten) -> None:
        super().__init__()
        self._is_written = is_written
        self.roles: list[Role] = []
        self.units: list[Role] = []

    def number(self, value: float, role: Role) -> int:
        """Return the index of a new constant."""
        self.roles.append(role)
        return self.append(op.CONSTANT, value=value)

    def sum_of_terms(self, terms: Sum) -> int:
        """Return the index of an expanded sum; it begins with a positive term if there is one."""
        if not terms:
            return self.number(0.0, Role(shape_of(ONE), 1.0, is_inner=False))
        return self._added(terms, inner=None)

    def _added(self, summands: Sum, inner: Shape | None, path: Path = ()) -> int:
        terms = list(in_order(summands))
        first = next((place for place, (_, coefficient) in enumerate(terms) if coefficient > 0.0), 0)
        terms.insert(0, terms.pop(first))
        counts: Counter[str] = Counter()
        top = -1
        for place, (monomial, coefficient) in enumerate(terms):
            within = () if inner is None else _extended(path, repr(shape_of(monomial)), counts)
            term = self._term(monomial, coefficient, inner, within, is_first=place == 0)
            top = self.operate(op.ADD if coefficient > 0.0 else op.SUBTRACT, top, term) if place else term
        return top

    def _term(self, monomial: Monomial, coefficient: float, inner: Shape | None, path: Path, *, is_first: bool) -> int:
        """Return the index of a term without its sign, unless it is the first term."""
        shape = shape_of(monomial) if inner is None else inner
        sign = 1.0 if is_first or coefficient > 0.0 else -1.0
        role = Role(shape, sign, inner is not None, path)
        if monomial == ONE:
            return self.number(sign * coefficient, role)
        is_plain = abs(coefficient) == 1.0 and (inner is not None or not self._is_written(shape, coefficient))
        if is_plain and inner is not None:
            self.units.append(replace(role, sign=coefficient))
        factor = None if is_plain else self.number(sign * coefficient, role)
        node = self._product(monomial, factor, shape, path)
        return self.operate(op.NEGATE, node) if is_plain and sign * coefficient < 0.0 else node

    def _product(self, monomial: Monomial, factor: int | None, shape: Shape, path: Path) -> int:
        counts: Counter[str] = Counter()
        above = [] if factor is None else [factor]
        above += [self._atom(atom, shape, path, counts) for atom, count in monomial for _ in range(count)]
        below = [self._atom(atom, shape, path, counts) for atom, count in monomial for _ in range(-count)]
        if not below:
            return self._chained(above)
        divisor = self._chained(below)
        return self.operate(op.DIVIDE, self._chained(above), divisor) if above else self.operate(op.INVERSE, divisor)

    def _chained(self, factors: Sequence[int]) -> int:
        return reduce(lambda node, factor: self.operate(op.MULTIPLY, node, factor), factors)

    def _atom(self, atom: Atom, shape: Shape, path: Path, counts: Counter[str]) -> int:
        kind, *rest = atom
        if kind == op.VARIABLE:
            return self.add(op.VARIABLE, rest[0])
        path = _extended(path, repr(_atom_shape(atom)), counts)
        if kind == op.ADD:
            return self._added(rest[0], shape, path)
        if kind == op.POW:
            if not rest[0]:
                raise UndefinedError
            base = self._added(rest[0], shape, (*path, ("base", 0)))
            return self.operate(op.POW, base, self._added(rest[1], shape, (*path, ("exponent", 0))))
        return self.operate(kind, self._added(rest[0], shape, path))


def _extended(path: Path, name: str, counts: Counter[str]) -> Path:
    """Return the path to the next part with this name, and increase the count of this name."""
    counts[name] += 1
    return (*path, (name, counts[name]))


def factored_forms(program: Program) -> Iterator[Program]:
    """For each term s of the expansion, with the coefficient a, yield ``a*(s + b*t + …)``. Nothing is yielded if there
    is only one term."""
    try:
        terms = terms_of(program)
    except UndefinedError:
        return
    for lead in range(len(terms) if len(terms) > 1 else 0):
        with suppress(UndefinedError):
            yield _factored(terms, lead)


@contained
def _factored(terms: Sum, lead: int) -> Program:
    """Return a sum with the coefficient of one of its terms in front of a bracket."""
    factor = terms[lead][1]
    builder = _Builder(lambda *_: False)
    scale = builder.append(op.CONSTANT, value=factor)
    inner = tuple(
        (monomial, 1.0 if place == lead else nonzero(number / factor)) for place, (monomial, number) in enumerate(terms)
    )
    return builder.program(builder.operate(op.MULTIPLY, scale, builder.sum_of_terms(inner)))
