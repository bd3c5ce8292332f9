"""Write programs as fractions of polynomials: angle sums and multiples expanded, even and odd rules applied.

Angles: the argument of sin or cos is split into terms ``c*m`` and a phase. For every m there is one base angle ``b*m``
such that all its coefficients in an expression are whole multiples of b; sin and cos of multiples are polynomials in
sin(b m) and cos(b m). Phases within `PHASE` of a multiple of pi/2 are that multiple; any other phase is expanded with
its numbers. Model and truth share an atom when their bases agree within the tolerance, or stand in a ratio of small
whole numbers within it. exp is treated likewise, with exp(b m) as atom.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from fractions import Fraction as Ratio
from typing import Final

import numpy as np

from benchmarks.fractions import (
    ONE,
    Atoms,
    FloatArray,
    Fraction,
    Monomial,
    Polynomial,
    add,
    added,
    atom,
    cancelled,
    constant,
    inverse,
    multiply,
    power,
    ratio,
    scaled,
)
from common.expression.operators import (
    ABS,
    ADD,
    CONSTANT,
    COS,
    DIVIDE,
    EXP,
    INVERSE,
    LOG,
    MULTIPLY,
    NEGATE,
    POW,
    SIN,
    SQRT,
    SQUARE,
    SUBTRACT,
    TANH,
    VARIABLE,
)
from common.expression.parse import from_infix
from common.expression.program import Program

PHASE: Final = 1e-6
"""Radians: phases as near as this to a multiple of pi/2 are that multiple."""

NEGLIGIBLE: Final = 1e-6
"""Angles (radians) and relative differences of angles inside one expression below this are none."""

LARGEST_MULTIPLE: Final = 8

Key = tuple[str, Monomial, Monomial]
"""What an angle is a multiple of: ("sin" or "exp", numerator, denominator)."""


@dataclass
class _Base:
    """The atoms of one base angle and its size in the truth (or in the model, where the truth has none)."""

    size: float
    first: int
    second: int


@dataclass
class Rewriting:
    """Turns programs over `columns` into fractions; the truth first, then the model.

    `differences` collects the relative differences of the angles' coefficients between model and truth.
    """

    columns: Mapping[str, FloatArray]
    tolerance: float
    atoms: Atoms = field(init=False)
    differences: list[float] = field(default_factory=list)
    _variables: list[Fraction] = field(default_factory=list)
    _bases: dict[Key, list[_Base]] = field(default_factory=dict)
    _opaque: list[tuple[str, tuple[Fraction, ...], int]] = field(default_factory=list)

    def __post_init__(self) -> None:
        rows = len(next(iter(self.columns.values())))
        self.atoms = Atoms(rows)
        self._variables = [atom(self.atoms.add(name, values)) for name, values in self.columns.items()]

    def rewrite(self, text: str) -> Fraction:
        """Return `text` as a fraction; raises UsageError, TooLargeError, UndefinedError."""
        program = from_infix(text, tuple(self.columns))
        collected: dict[Key, list[float]] = {}
        _Walk(self, collected, is_collecting=True).walk(program)
        for key, sizes in collected.items():
            self._prepare(key, sizes)
        return _Walk(self, collected, is_collecting=False).walk(program)

    def angle(self, key: Key, size: float) -> tuple[_Base, int]:
        """Return the base of which `size` is a multiple, and how many times."""
        for base, times in self._multiples(key, abs(size)):
            return base, times if size > 0 else -times
        base = self._new_base(key, abs(size))
        return base, 1 if size > 0 else -1

    def opaque(self, name: str, arguments: tuple[Fraction, ...], values: FloatArray) -> Fraction:
        """Return the atom of a function that is not looked into; one atom for equal arguments."""
        for known_name, known, number in self._opaque:
            if known_name == name and all(self._same(a, b) for a, b in zip(arguments, known, strict=True)):
                return atom(number)
        number = self.atoms.add(f"{name}(…)", values)
        self._opaque.append((name, arguments, number))
        return atom(number)

    def _same(self, left: Fraction, right: Fraction) -> bool:
        crossed = (
            self.atoms.multiply(left.numerator, right.denominator),
            self.atoms.multiply(right.numerator, left.denominator),
        )
        found = ratio(*crossed, tolerance=self.tolerance)
        return (not crossed[0] and not crossed[1]) or (found is not None and abs(found - 1.0) <= self.tolerance)

    def _prepare(self, key: Key, sizes: list[float]) -> None:
        """Make sure that every one of `sizes` is a multiple of a base."""
        for group, base_size in _groups(sizes):
            known = self._related(key, base_size, group)
            if known is None:
                self._new_base(key, base_size)

    def _related(self, key: Key, size: float, group: list[float]) -> _Base | None:
        """Return the base of the truth to which the model's base `size` belongs, and refine it when that takes halves."""
        for base in self._bases.get(key, []):
            quotient = Ratio(size / base.size).limit_denominator(4)
            if quotient == 0 or quotient.numerator > LARGEST_MULTIPLE:
                continue
            difference = abs(size / base.size / float(quotient) - 1.0)
            if difference <= self.tolerance:
                self.differences.append(difference)
                return base
        return None
