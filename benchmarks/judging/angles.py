"""Which sines, cosines and other functions are the same in two expressions.

For every m that is the variable part of an angle ``c*m``, a base ``b*m`` is chosen of which all its angles are whole
multiples, so that their sines and cosines are polynomials in sin(b m) and cos(b m). An angle of the model is taken for
one of the truth when its coefficient agrees within the tolerance, also after multiplication by a simple fraction. exp
is treated likewise, with exp(b m) as atom. Other functions are not looked into: equal arguments, within the tolerance,
are equal atoms.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction as Ratio
from typing import Final, Literal

from benchmarks.judging.fractions import Atoms, FloatArray, Fraction, Monomial, atom

NEGLIGIBLE: Final = 1e-6
"""Angles (radians) and relative differences of angles inside one expression below this are none."""

LARGEST_MULTIPLE: Final = 16
_SMALL: Final = 4
"""Largest numerator and denominator of the ratio between a base of the model and one of the truth."""

Side = Literal["truth", "model"]
Key = tuple[str, Monomial, Monomial]
"""What an angle is a multiple of: "sin" or "exp", numerator, denominator."""


@dataclass
class _Base:
    """The atoms of one base angle, and what size it has in the truth and in the model (there perhaps several)."""

    sizes: dict[Side, list[float]]
    divisor: int = 1
    atoms: tuple[int, ...] = ()


@dataclass
class SharedAtoms:
    """The atoms that truth and model share, over `columns` of R values each.

    `differences` are the relative differences between angles of the model and those of the truth they were taken for;
    `loosest_argument` is the largest one between arguments of other functions that were taken for equal.
    """

    columns: Mapping[str, FloatArray]
    tolerance: float
    differences: list[float] = field(default_factory=list)
    loosest_argument: float = 0.0

    def __post_init__(self) -> None:
        self.atoms = Atoms(len(next(iter(self.columns.values()))))
        self._variables = [atom(self.atoms.add(name, values)) for name, values in self.columns.items()]
        self._bases: dict[Key, list[_Base]] = {}
        self._opaque: list[tuple[str, tuple[Fraction, ...], int]] = []

    def prepare(self, truth: Mapping[Key, list[float]], model: Mapping[Key, list[float]]) -> None:
        """Choose the base angles, given the coefficients of all angles in the truth and in the model."""
        for key in dict.fromkeys((*truth, *model)):
            self._bases[key] = self._shared(truth.get(key, []), model.get(key, []))

    def angle(self, key: Key, size: float, side: Side) -> tuple[tuple[int, ...], int]:
        """Return the atoms of the base of which `size` is a multiple, and how many times."""
        known = self._bases.setdefault(key, [])
        for base in known:
            for whole in base.sizes[side]:
                times = round(size * base.divisor / whole)
                if 0 < abs(times) <= LARGEST_MULTIPLE and _is_near(size, times * whole / base.divisor):
                    return self._atoms_of(key, base), times
        known.append(_Base({"truth": [abs(size)], "model": [abs(size)]}))
        return self._atoms_of(key, known[-1]), 1 if size > 0 else -1

    def opaque(self, name: str, arguments: tuple[Fraction, ...], values: FloatArray) -> int:
        """Return the atom of a function that is not looked into."""
        for known_name, known, number in self._opaque:
            if known_name == name and all(self._is_same(a, b) for a, b in zip(arguments, known, strict=True)):
                return number
        number = self.atoms.add(f"{name}(…)", values)
        self._opaque.append((name, arguments, number))
        return number

    def variable(self, index: int) -> Fraction:
        """Return an input variable."""
        return self._variables[index]

    def _is_same(self, left: Fraction, right: Fraction) -> bool:
        first = self.atoms.multiply(left.numerator, right.denominator)
        second = self.atoms.multiply(right.numerator, left.denominator)
        if first.keys() != second.keys():
            return False
        difference = max((abs(first[monomial] / second[monomial] - 1.0) for monomial in first), default=0.0)
        if difference <= self.tolerance:
            self.loosest_argument = max(self.loosest_argument, difference)
        return difference <= self.tolerance

    def _shared(self, truth: list[float], model: list[float]) -> list[_Base]:
        bases = [_Base({"truth": [size], "model": []}) for size in _bases_of(truth)]
        for size in _bases_of(model):
            if not any(self._join(base, size) for base in bases if base.sizes["truth"]):
                bases.append(_Base({"truth": [], "model": [size]}))
        return bases

    def _join(self, base: _Base, size: float) -> bool:
        """Make `size` of the model a multiple of `base`, if it stands in a simple ratio to it; say whether it does."""
        quotient = size / base.sizes["truth"][0]
        simple = Ratio(quotient).limit_denominator(_SMALL)
        if simple == 0 or simple.numerator > _SMALL:
            return False
        difference = abs(quotient / float(simple) - 1.0)
        if difference > self.tolerance:
            return False
        self.differences.append(difference)
        base.divisor = math.lcm(base.divisor, simple.denominator)
        base.sizes["model"].append(size / float(simple))
        return True

    def _atoms_of(self, key: Key, base: _Base) -> tuple[int, ...]:
        if not base.atoms:
            size = (base.sizes["truth"] or base.sizes["model"])[0] / base.divisor
            kind, above, below = key
            angle = size * self.atoms.value(above) / self.atoms.value(below)
            name = f"{size:.6g}*{self.atoms.text(above)}" + (f"/({self.atoms.text(below)})" if below else "")
            if kind == "sin":
                base.atoms = self.atoms.add_angle(name, angle)
            else:
                base.atoms = (self.atoms.add_exponential(name, angle),)
        return base.atoms


def _is_near(left: float, right: float) -> bool:
    return math.isclose(left, right, rel_tol=NEGLIGIBLE)


def _bases_of(sizes: list[float]) -> list[float]:
    """Return few numbers of which all `sizes` are whole multiples."""
    left = sorted({abs(size) for size in sizes})
    found: list[float] = []
    while left:
        candidates = [left[0] / part for part in range(1, _SMALL + 1)]
        base = max(candidates, key=lambda each: (sum(_is_multiple(size, each) for size in left), each))
        found.append(base)
        left = [size for size in left if not _is_multiple(size, base)]
    return found


def _is_multiple(size: float, base: float) -> bool:
    times = round(size / base)
    return 0 < times <= LARGEST_MULTIPLE and _is_near(size, times * base)
