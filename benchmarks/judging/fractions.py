"""Expressions as fractions of polynomials in *atoms*: variables, sines and cosines of angles, other functions.

A polynomial is a dictionary from monomials to coefficients, a monomial a sorted tuple of (atom, exponent > 0). sin**2
is always replaced by 1 - cos**2, so that every polynomial in sines and cosines has one form. Common polynomial factors
of numerator and denominator are not looked for (`benchmarks.judging.forms` solves for them), common monomials are
cancelled.
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
Monomial = tuple[tuple[int, int], ...]
Polynomial = dict[Monomial, float]

ONE: Final[Monomial] = ()
LARGEST: Final = 4_000
"""Terms of a polynomial above which a comparison is given up."""

ROUNDING: Final = 1e-13
"""A sum that is smaller than this share of its parts is a zero left over by rounding."""


class TooLargeError(Exception):
    """Raised when a polynomial gets more than `LARGEST` terms."""


class UndefinedError(Exception):
    """Raised when an expression divides by zero everywhere."""


@dataclass(frozen=True)
class Fraction:
    """numerator / denominator."""

    numerator: Polynomial
    denominator: Polynomial


class Atoms:
    """The atoms known so far, their values on the data, and the arithmetic of polynomials in them."""

    def __init__(self, rows: int) -> None:
        self.rows = rows
        self.values: list[FloatArray] = []
        self.names: list[str] = []
        self._scalable: dict[int, tuple[FloatArray, tuple[tuple[int, Callable[[FloatArray], FloatArray]], ...]]] = {}
        self._cosine_of: dict[int, int] = {}
        self._reduced: dict[Monomial, Polynomial] = {}

    def add(self, name: str, values: FloatArray) -> int:
        """Make a new atom with `values` (R,); return its number."""
        self.values.append(np.asarray(values, dtype=np.float64))
        self.names.append(name)
        return len(self.values) - 1

    def add_angle(self, name: str, angle: FloatArray) -> tuple[int, int]:
        """Make the sine and the cosine of `angle` (R,); return their numbers."""
        sine, cosine = self.add(f"sin({name})", np.sin(angle)), self.add(f"cos({name})", np.cos(angle))
        self._cosine_of[sine] = cosine
        self._scalable[sine] = (angle, ((sine, np.sin), (cosine, np.cos)))
        return sine, cosine

    def add_exponential(self, name: str, argument: FloatArray) -> int:
        """Make the exponential of `argument` (R,); return its number."""
        number = self.add(f"exp({name})", np.exp(argument))
        self._scalable[number] = (argument, ((number, np.exp),))
        return number

    @property
    def scalable(self) -> tuple[int, ...]:
        """Atoms whose argument `scale_argument` can change: sines, each with its cosine, and exponentials."""
        return tuple(self._scalable)

    def scale_argument(self, number: int, factor: float) -> None:
        """Set the values of an atom, and of a sine's cosine, to those of `factor` times the argument."""
        argument, functions = self._scalable[number]
        for which, function in functions:
            self.values[which] = function(factor * argument)

    def value(self, monomial: Monomial) -> FloatArray:
        """Return the values (R,) of `monomial` on the data."""
        value = np.ones(self.rows)
        for atom, exponent in monomial:
            value = value * self.values[atom] ** exponent
        return value

    def evaluate(self, polynomial: Polynomial) -> FloatArray:
        """Return the values (R,) of `polynomial` on the data."""
        total = np.zeros(self.rows)
        for monomial, coefficient in polynomial.items():
            total = total + coefficient * self.value(monomial)
        return total

    def text(self, monomial: Monomial) -> str:
        """Return `monomial` for people."""
        return "*".join(self.names[a] + (f"**{e}" if e > 1 else "") for a, e in monomial) or "1"

    def multiply(self, left: Polynomial, right: Polynomial) -> Polynomial:
        """Return the product; raises TooLargeError."""
        terms = (
            (monomial, factor * a * b)
            for first, a in left.items()
            for second, b in right.items()
            for monomial, factor in self._product(first, second).items()
        )
        return _collected(terms)

    def _product(self, first: Monomial, second: Monomial) -> Polynomial:
        exponents = dict(first)
        for atom, exponent in second:
            exponents[atom] = exponents.get(atom, 0) + exponent
        merged = tuple(sorted(exponents.items()))
        if merged not in self._reduced:
            self._reduced[merged] = self._without_squares_of_sines(merged)
        return self._reduced[merged]

    def _without_squares_of_sines(self, monomial: Monomial) -> Polynomial:
        for sine, exponent in monomial:
            if sine in self._cosine_of and exponent > 1:
                rest = tuple((a, e - 2 if a == sine else e) for a, e in monomial if a != sine or e > 2)
                cosine_squared: Polynomial = {((self._cosine_of[sine], 2),): 1.0}
                rest_reduced = self._without_squares_of_sines(rest)
                return added(rest_reduced, self.multiply(cosine_squared, rest_reduced), -1.0)
        return {monomial: 1.0}


def constant(value: float) -> Fraction:
    """Return a number as a fraction."""
    return Fraction({ONE: value} if value else {}, {ONE: 1.0})


def atom(number: int) -> Fraction:
    """Return an atom as a fraction."""
    return Fraction({((number, 1),): 1.0}, {ONE: 1.0})


def scaled(polynomial: Polynomial, factor: float) -> Polynomial:
    """Return factor * polynomial."""
    return {monomial: factor * coefficient for monomial, coefficient in polynomial.items()}


def added(left: Polynomial, right: Polynomial, factor: float = 1.0) -> Polynomial:
    """Return left + factor * right; raises TooLargeError."""
    return _collected((*left.items(), *scaled(right, factor).items()))


def _collected(terms: Iterable[tuple[Monomial, float]]) -> Polynomial:
    """Join equal monomials; what cancels up to rounding goes."""
    sums: Polynomial = {}
    sizes: Polynomial = {}
    for monomial, coefficient in terms:
        sums[monomial] = sums.get(monomial, 0.0) + coefficient
        sizes[monomial] = sizes.get(monomial, 0.0) + abs(coefficient)
        if len(sums) > LARGEST:
            raise TooLargeError
    return {monomial: value for monomial, value in sums.items() if abs(value) > ROUNDING * sizes[monomial]}


def ratio(left: Polynomial, right: Polynomial, tolerance: float = 1e-12) -> float | None:
    """Return the number r with left = r * right, each coefficient within `tolerance`; None when there is none."""
    if left.keys() != right.keys() or not left:
        return None
    pivot = max(right, key=lambda monomial: (abs(right[monomial]), monomial))
    found = left[pivot] / right[pivot]
    agrees = all(math.isclose(left[m], found * right[m], rel_tol=tolerance) for m in left)
    return found if agrees else None


def add(atoms: Atoms, left: Fraction, right: Fraction, sign: float = 1.0) -> Fraction:
    """Return left + sign * right."""
    same = ratio(left.denominator, right.denominator)
    if same is not None:
        return cancelled(Fraction(added(left.numerator, right.numerator, sign * same), left.denominator))
    numerator = added(
        atoms.multiply(left.numerator, right.denominator), atoms.multiply(right.numerator, left.denominator), sign
    )
    return cancelled(Fraction(numerator, atoms.multiply(left.denominator, right.denominator)))


def multiply(atoms: Atoms, left: Fraction, right: Fraction) -> Fraction:
    """Return left * right."""
    left, right = _crossed(left, right)
    return cancelled(
        Fraction(atoms.multiply(left.numerator, right.numerator), atoms.multiply(left.denominator, right.denominator))
    )


def inverse(fraction: Fraction) -> Fraction:
    """Return 1 / fraction; raises UndefinedError when it is zero."""
    if not fraction.numerator:
        raise UndefinedError
    return Fraction(fraction.denominator, fraction.numerator)


def power(atoms: Atoms, base: Fraction, exponent: int) -> Fraction:
    """Return base**exponent for a whole exponent."""
    if exponent < 0:
        base, exponent = inverse(base), -exponent
    result = constant(1.0)
    for _ in range(exponent):
        result = multiply(atoms, result, base)
    return result


def _crossed(left: Fraction, right: Fraction) -> tuple[Fraction, Fraction]:
    """Cancel a numerator that is a multiple of the other's denominator."""
    for _ in range(2):
        same = ratio(left.numerator, right.denominator)
        if same is not None:
            left, right = Fraction({ONE: same}, left.denominator), Fraction(right.numerator, {ONE: 1.0})
        left, right = right, left
    return left, right


def cancelled(fraction: Fraction) -> Fraction:
    """Divide numerator and denominator by the monomial that is common to all their terms."""
    if not fraction.numerator:
        return constant(0.0)
    monomials = [*fraction.numerator, *fraction.denominator]
    common = dict(monomials[0])
    for monomial in monomials[1:]:
        exponents = dict(monomial)
        common = {atom: min(e, exponents[atom]) for atom, e in common.items() if atom in exponents}
        if not common:
            return fraction
    return Fraction(_divided(fraction.numerator, common), _divided(fraction.denominator, common))


def _divided(polynomial: Polynomial, by: dict[int, int]) -> Polynomial:
    return {
        tuple((atom, e - by.get(atom, 0)) for atom, e in monomial if e > by.get(atom, 0)): coefficient
        for monomial, coefficient in polynomial.items()
    }
