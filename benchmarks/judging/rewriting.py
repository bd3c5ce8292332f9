"""Write expressions as fractions of polynomials: angle sums and multiples expanded, even and odd rules applied.

The argument of sin or cos is split into terms ``c*m`` (see `benchmarks.judging.angles`) and a phase. Phases within
`PHASE` of a multiple of pi/2 are that multiple; any other phase is expanded with its numbers.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from atoll_core.expression.evaluation import DEFINITIONS, value_of
from atoll_core.expression.operators import (
    ADD,
    CONSTANT,
    COS,
    DIVIDE,
    EXP,
    FUNCTIONS,
    INVERSE,
    MULTIPLY,
    NEGATE,
    POW,
    SIN,
    SQUARE,
    SUBTRACT,
    VARIABLE,
)
from atoll_core.expression.program import Program
from atoll_core.expression.text.parsing import from_infix
from benchmarks.judging.angles import LARGEST_MULTIPLE, NEGLIGIBLE, Key, SharedAtoms, Side
from benchmarks.judging.fractions import (
    ONE,
    Atoms,
    FloatArray,
    Fraction,
    Polynomial,
    add,
    added,
    atom,
    cancelled,
    constant,
    inverse,
    multiply,
    power,
    scaled,
)

PHASE: Final = 1e-6
"""Radians: phases as near as this to a multiple of pi/2 are that multiple."""


@dataclass(frozen=True)
class Rewritten:
    """Two expressions over common `atoms`; by how much angles and other arguments taken for equal differed."""

    truth: Fraction
    model: Fraction
    atoms: Atoms
    angle_difference: float
    argument_difference: float


def rewrite(truth: str, model: str, columns: Mapping[str, FloatArray], tolerance: float) -> Rewritten:
    """Return both expressions, over the names of `columns` (R values each), as fractions over common atoms.

    Raises:
        UsageError: a text is no expression.
        TooLargeError: a polynomial gets too many terms.
        UndefinedError: a part divides by zero everywhere.
    """
    shared = SharedAtoms(columns, tolerance)
    programs = {"truth": from_infix(truth, tuple(columns)), "model": from_infix(model, tuple(columns))}
    met: dict[str, dict[Key, list[float]]] = {"truth": {}, "model": {}}
    _Walk(shared, "truth", met["truth"]).walk(programs["truth"])
    _Walk(shared, "model", met["model"]).walk(programs["model"])
    shared.prepare(met["truth"], met["model"])
    fractions = (
        _Walk(shared, "truth", None).walk(programs["truth"]),
        _Walk(shared, "model", None).walk(programs["model"]),
    )
    return Rewritten(*fractions, shared.atoms, max(shared.differences, default=0.0), shared.loosest_argument)


class _Walk:
    """Builds the fraction of every node of one program.

    With `met`, angles are only collected there, and their sines and cosines are new atoms.
    """

    def __init__(self, shared: SharedAtoms, side: Side, met: dict[Key, list[float]] | None) -> None:
        self._shared = shared
        self._atoms = shared.atoms
        self._side: Side = side
        self._met = met

    def walk(self, program: Program) -> Fraction:
        fractions: list[Fraction] = []
        columns = (program.operators, program.left, program.right, program.constants)
        for code, left, right, value in zip(*(column.tolist() for column in columns), strict=True):
            if code == VARIABLE:
                fractions.append(self._shared.variable(left))
            elif code == CONSTANT:
                fractions.append(constant(value))
            elif code in (ADD, SUBTRACT, MULTIPLY, DIVIDE, POW):
                fractions.append(self._binary(code, fractions[left], fractions[right]))
            else:
                fractions.append(self._unary(code, fractions[left]))
        return fractions[-1]

    def _binary(self, code: int, left: Fraction, right: Fraction) -> Fraction:
        if code == ADD:
            return add(self._atoms, left, right)
        if code == SUBTRACT:
            return add(self._atoms, left, right, -1.0)
        if code == POW:
            return self._power(left, right)
        return multiply(self._atoms, left, right if code == MULTIPLY else inverse(right))

    def _unary(self, code: int, argument: Fraction) -> Fraction:
        if code == NEGATE:
            return Fraction(scaled(argument.numerator, -1.0), argument.denominator)
        if code == SQUARE:
            return multiply(self._atoms, argument, argument)
        if code == INVERSE:
            return inverse(argument)
        number = _number(argument)
        if number is not None:
            return constant(value_of(code, number, number))
        if code in (SIN, COS):
            return self._trigonometric(code, argument)
        if code == EXP:
            return self._exponential(argument)
        return self._other(FUNCTIONS[code], argument, self._function(code, argument))

    def _power(self, base: Fraction, exponent: Fraction) -> Fraction:
        number = _number(exponent)
        if number is not None and number.is_integer() and abs(number) <= LARGEST_MULTIPLE:
            return power(self._atoms, base, int(number))
        values = self._values(base) ** self._values(exponent)
        return atom(self._shared.opaque("pow", (base, exponent), values))

    def _other(self, name: str, argument: Fraction, values: FloatArray) -> Fraction:
        return atom(self._shared.opaque(name, (argument,), values))

    def _function(self, code: int, argument: Fraction) -> FloatArray:
        values = self._values(argument)
        return np.asarray(DEFINITIONS[code].value(values, values), dtype=np.float64)

    def _values(self, fraction: Fraction) -> FloatArray:
        return self._atoms.evaluate(fraction.numerator) / self._atoms.evaluate(fraction.denominator)

    def _trigonometric(self, code: int, argument: Fraction) -> Fraction:
        phase, terms = self._terms("sin", argument)
        if self._met is not None:
            return self._collected(code, argument, terms)
        sine, cosine = _of_phase(phase)
        for key, size in terms:
            atoms, times = self._shared.angle(key, size, self._side)
            sine, cosine = self._angle_sum((sine, cosine), self._multiple(atoms, times))
        return Fraction(sine if code == SIN else cosine, {ONE: 1.0})

    def _exponential(self, argument: Fraction) -> Fraction:
        shift, terms = self._terms("exp", argument)
        if self._met is not None:
            return self._collected(EXP, argument, terms)
        result = constant(math.exp(min(shift, 700.0)))
        for key, size in terms:
            (number,), times = self._shared.angle(key, size, self._side)
            result = multiply(self._atoms, result, power(self._atoms, atom(number), times))
        return result

    def _collected(self, code: int, argument: Fraction, terms: list[tuple[Key, float]]) -> Fraction:
        assert self._met is not None
        for key, size in terms:
            self._met.setdefault(key, []).append(size)
        return atom(self._atoms.add(FUNCTIONS[code], self._function(code, argument)))

    def _terms(self, kind: str, argument: Fraction) -> tuple[float, list[tuple[Key, float]]]:
        """Split an argument into its constant and its other terms, negligible ones left out."""
        if len(argument.denominator) > 1:
            whole = self._shared.opaque("angle", (argument,), self._values(argument))
            return 0.0, [((kind, ((whole, 1),), ONE), 1.0)]
        ((below, divisor),) = argument.denominator.items()
        shift = 0.0
        terms: list[tuple[Key, float]] = []
        for above, coefficient in sorted(argument.numerator.items()):
            term = cancelled(Fraction({above: coefficient / divisor}, {below: 1.0}))
            ((monomial, size),), (rest,) = term.numerator.items(), term.denominator
            if monomial == rest == ONE:
                shift = size
            elif _spread(size * self._atoms.value(monomial) / self._atoms.value(rest)) > NEGLIGIBLE:
                terms.append(((kind, monomial, rest), size))
        return shift, terms

    def _multiple(self, atoms: tuple[int, ...], times: int) -> tuple[Polynomial, Polynomial]:
        """Return sine and cosine of a multiple of a base angle; odd and even in `times`."""
        one: tuple[Polynomial, Polynomial] = ({((atoms[0], 1),): 1.0}, {((atoms[1], 1),): 1.0})
        total = one
        for _ in range(abs(times) - 1):
            total = self._angle_sum(total, one)
        return (scaled(total[0], -1.0), total[1]) if times < 0 else total

    def _angle_sum(
        self, left: tuple[Polynomial, Polynomial], right: tuple[Polynomial, Polynomial]
    ) -> tuple[Polynomial, Polynomial]:
        product = self._atoms.multiply
        sine = added(product(left[0], right[1]), product(left[1], right[0]))
        cosine = added(product(left[1], right[1]), product(left[0], right[0]), -1.0)
        return sine, cosine


def _number(fraction: Fraction) -> float | None:
    """Return the number that a fraction is, if it is one."""
    if not fraction.numerator:
        return 0.0
    if fraction.numerator.keys() == fraction.denominator.keys() == {ONE}:
        return fraction.numerator[ONE] / fraction.denominator[ONE]
    return None


def _of_phase(phase: float) -> tuple[Polynomial, Polynomial]:
    """Return sine and cosine of a phase as polynomials; exact near multiples of pi/2."""
    quarters = round(phase / (math.pi / 2))
    if abs(phase - quarters * math.pi / 2) <= PHASE:
        sine, cosine = ((0.0, 1.0), (1.0, 0.0), (0.0, -1.0), (-1.0, 0.0))[quarters % 4]
    else:
        sine, cosine = math.sin(phase), math.cos(phase)
    return constant(sine).numerator, constant(cosine).numerator


def _spread(values: FloatArray) -> float:
    finite = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(finite**2))) if len(finite) else math.inf
