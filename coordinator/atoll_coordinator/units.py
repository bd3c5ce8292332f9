"""Units of measurement as products of powers of symbols, such as ``m/s^2`` or ``cells/(mL h)``. Pure.

Any word is a unit: an unknown word, such as cells or EUR, is a base symbol. Known symbols are expanded to SI base
units, with factors as powers of 2, 3 and 5: N is kg m s^-2, and min is 60 s. Three kinds of known symbols are not
expanded: temperatures on shifted scales, units whose factor is not such a product (ft, eV), and pH, which is read as
the acidity. A picohenry must be written nH/1000.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Final

from atoll_core.errors import UsageError

Powers = Mapping[str, Fraction]

_TOKEN: Final = re.compile(
    r"\s*(?:(?P<number>\d+(?:\.\d+)?)|(?P<symbol>[^\W\d_⁰¹²³⁴⁵⁶⁷⁸⁹]+|[°℃℉%‰][^\W\d_]*)"
    r"|(?P<power>\*\*|\^)|(?P<raised>[⁻⁺]?[⁰¹²³⁴⁵⁶⁷⁸⁹]+)|(?P<sign>[*/·⋅×.()−+-]))"
)
_RAISED: Final = str.maketrans("⁻⁺⁰¹²³⁴⁵⁶⁷⁸⁹", "-+0123456789")
_NONE: Final = frozenset({"", "1", "-", "dimensionless", "unitless", "rad", "radians"})
_PREFIXES: Final = {
    "T": 12, "G": 9, "M": 6, "k": 3, "h": 2, "da": 1, "d": -1, "c": -2, "m": -3, "µ": -6, "μ": -6, "u": -6, "n": -9,
    "p": -12, "f": -15,
}  # fmt: skip
_BASE: Final = "m s g A K mol cd"
_DERIVED: Final = {
    "N": "kg m s^-2", "Pa": "kg m^-1 s^-2", "J": "kg m^2 s^-2", "W": "kg m^2 s^-3", "C": "A s", "V": "kg m^2 s^-3 A^-1",
    "F": "kg^-1 m^-2 s^4 A^2", "Ω": "kg m^2 s^-3 A^-2", "ohm": "kg m^2 s^-3 A^-2", "S": "kg^-1 m^-2 s^3 A^2",
    "Wb": "kg m^2 s^-2 A^-1", "T": "kg s^-2 A^-1", "H": "kg m^2 s^-2 A^-2", "Hz": "s^-1", "Bq": "s^-1", "L": "dm^3",
    "l": "dm^3", "M": "mol dm^-3", "bar": "100 kPa", "Wh": "3600 J",
}  # fmt: skip
_PLAIN: Final = {
    "min": "60 s", "h": "3600 s", "hr": "3600 s", "hour": "3600 s", "hours": "3600 s", "d": "86400 s", "day": "86400 s",
    "days": "86400 s", "week": "604800 s", "weeks": "604800 s", "sec": "s", "second": "s", "seconds": "s",
    "minute": "60 s", "minutes": "60 s", "%": "0.01", "‰": "0.001", "t": "1000 kg", "ha": "10000 m^2", "years": "year",
    "yr": "year", "yrs": "year", "y": "year", "a": "year", "meter": "m", "metre": "m", "degrees": "deg",
    "degree": "deg", "°": "deg",
}  # fmt: skip
_THEMSELVES: Final = frozenset({"pH"})
"""Units that look like a prefix with a symbol but are not."""
_PRIMES: Final = (2, 3, 5, 7)
_FACTORS: Final = frozenset(map(str, _PRIMES))
_OPENING, _CLOSING, _END = ("sign", "("), ("sign", ")"), ("end", "")
_LONGEST: Final = 300
"""Most characters of a unit. No real unit is as long, and a shorter text cannot have too many nested brackets for the
parser."""


def product_of(one: Powers, other: Powers, power: Fraction) -> dict[str, Fraction]:
    """Return the powers of the product of one unit with a power of another; zero powers are left out."""
    powers = dict(one)
    for symbol, exponent in other.items():
        powers[symbol] = powers.get(symbol, Fraction(0)) + exponent * power
    return {symbol: exponent for symbol, exponent in powers.items() if exponent}


@dataclass(frozen=True)
class Unit:
    """A unit: its symbols with their powers, not expanded."""

    powers: tuple[tuple[str, Fraction], ...] = ()

    @classmethod
    def of(cls, powers: Powers) -> "Unit":
        """Return the unit of these powers; zero powers are left out."""
        return cls(tuple((symbol, power) for symbol, power in powers.items() if power))

    @property
    def is_none(self) -> bool:
        """Whether the unit is 1, the unit of pure numbers."""
        return not expanded(self)

    def times(self, other: "Unit", power: Fraction | int = 1) -> "Unit":
        """Return the product with a power of another unit."""
        return Unit.of(product_of(dict(self.powers), dict(other.powers), Fraction(power)))

    def __str__(self) -> str:
        if not self.powers:
            return "1"
        # Numbers first: a number directly after a symbol would be read as its exponent.
        ordered = sorted(self.powers, key=lambda item: not is_factor(item[0]))
        above = [_power(symbol, power) for symbol, power in ordered if power > 0]
        below = [_power(symbol, -power) for symbol, power in ordered if power < 0]
        divisor = below[0] if len(below) == 1 else f"({' '.join(below)})"
        return (" ".join(above) or "1") + (f"/{divisor}" if below else "")


NO_UNIT: Final = Unit()


def _power(symbol: str, power: Fraction) -> str:
    if power == 1:
        return symbol
    return f"{symbol}^{power}" if power.denominator == 1 else f"{symbol}^({power})"


def parse_unit(text: str) -> Unit:
    """Return the unit that a text means, the unit of pure numbers for ``1`` and ``-``.

    Raises UsageError for other texts.
    """
    if text.strip() in _NONE:
        return NO_UNIT
    if len(text) > _LONGEST:
        raise _fault(text)
    tokens: list[tuple[str, str]] = []
    place, end = 0, len(text.rstrip())
    while place < end:
        match = _TOKEN.match(text, place)
        if match is None or match.lastgroup is None:
            raise _fault(text)
        tokens.append((match.lastgroup, match[match.lastgroup]))
        place = match.end()
    parser = _UnitParser(text, [*tokens, _END])
    unit = parser.product()
    parser.expect(_END)
    return unit


def _fault(text: str) -> UsageError:
    shown = text if len(text) <= _LONGEST else text[:30] + "…"
    return UsageError(f"{shown!r} is no unit; write a product of powers such as m/s^2 or mol/(L h)")


class _UnitParser:
    """Reads a product from left to right; a slash divides by the factors up to the next sign or bracket."""

    def __init__(self, text: str, tokens: list[tuple[str, str]]) -> None:
        self._text = text
        self._tokens = tokens
        self._place = 0

    def expect(self, token: tuple[str, str]) -> None:
        """Take the next token; raises UsageError if it differs from the expected one."""
        if self._take() != token:
            raise _fault(self._text)

    def product(self) -> Unit:
        """Return the product up to a closing bracket or the end."""
        unit, side = NO_UNIT, 1
        while self._next not in (_CLOSING, _END):
            kind, value = self._next
            if kind == "sign" and value in "*·⋅×.":
                self._place, side = self._place + 1, 1
            elif kind == "sign" and value == "/" and side > 0:
                self._place, side = self._place + 1, -1
            else:
                unit, side = unit.times(self._factor(), side), 1
        if side < 0:
            raise _fault(self._text)
        return unit

    @property
    def _next(self) -> tuple[str, str]:
        return self._tokens[self._place]

    def _take(self) -> tuple[str, str]:
        self._place += 1
        return self._tokens[self._place - 1]

    def _factor(self) -> Unit:
        kind, value = self._take()
        if kind == "symbol":
            base = NO_UNIT if value in _NONE else Unit(((value, Fraction(1)),))
        elif kind == "number":
            base = Unit.of(_factored(Fraction(value), self._text))
        elif (kind, value) == _OPENING:
            base = self.product()
            self.expect(_CLOSING)
        else:
            raise _fault(self._text)
        return NO_UNIT.times(base, self._exponent(is_symbol=kind != "number"))

    def _exponent(self, *, is_symbol: bool) -> Fraction:
        """Return the exponent that follows, 1 if there is none; a number directly after a symbol is an exponent."""
        kind, value = self._next
        if kind == "power":
            self._place += 1
            return self._number()
        is_negative = kind == "sign" and value in "-−"
        is_exponent = kind == "raised" or (is_symbol and (kind == "number" or is_negative))
        return self._number() if is_exponent else Fraction(1)

    def _number(self) -> Fraction:
        kind, value = self._take()
        if (kind, value) == _OPENING:
            number = self._number()
            if self._next == ("sign", "/"):
                self._place += 1
                divisor = self._number()
                if not divisor:
                    raise _fault(self._text)
                number /= divisor
            self.expect(_CLOSING)
            return number
        if kind == "sign" and value in "+-−":
            return self._number() * (1 if value == "+" else -1)
        if kind in ("number", "raised"):
            return Fraction(value.translate(_RAISED))
        raise _fault(self._text)


def _factored(number: Fraction, text: str) -> dict[str, Fraction]:
    """Return a number as powers of small primes; raises UsageError for a number with other prime factors."""
    powers: dict[str, Fraction] = {}
    for rest, sign in ((number.numerator, 1), (number.denominator, -1)):
        if rest <= 0:
            raise _fault(text)
        for prime in _PRIMES:
            while rest % prime == 0:
                powers[str(prime)] = powers.get(str(prime), Fraction(0)) + sign
                rest //= prime
        if rest != 1:
            raise _fault(text)
    return powers


def is_factor(symbol: str) -> bool:
    """Tell whether a symbol of an expanded unit is a number."""
    return symbol in _FACTORS


def expanded(unit: Unit) -> dict[str, Fraction]:
    """Return a unit in SI base symbols, with its factor as powers of small primes."""
    powers: dict[str, Fraction] = {}
    for symbol, power in unit.powers:
        for base, exponent in _expanded(symbol).items():
            powers[base] = powers.get(base, Fraction(0)) + exponent * power
    return {base: power for base, power in powers.items() if power}


def _expanded(symbol: str) -> dict[str, Fraction]:
    if symbol in _PLAIN:
        return expanded(parse_unit(_PLAIN[symbol]))
    if symbol in _BASE.split() or symbol in _THEMSELVES or is_factor(symbol):
        return {symbol: Fraction(1)}
    if symbol in _DERIVED:
        return expanded(parse_unit(_DERIVED[symbol]))
    for prefix, tens in _PREFIXES.items():
        rest = symbol.removeprefix(prefix)
        if rest != symbol and (rest in _BASE.split() or rest in _DERIVED):
            powers = _expanded(rest)
            for prime in ("2", "5"):
                powers[prime] = powers.get(prime, Fraction(0)) + tens
            return powers
    return {symbol: Fraction(1)}
