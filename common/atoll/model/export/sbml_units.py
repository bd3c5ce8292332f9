"""Units of columns as unit definitions of SBML, where they can be read: ``m/s``, ``mg L^-1``, ``1/h``."""

import re
from collections.abc import Iterable
from typing import Final

_KINDS: Final = {
    "1": ("dimensionless", 1.0),
    "m": ("metre", 1.0),
    "g": ("gram", 1.0),
    "s": ("second", 1.0),
    "min": ("second", 60.0),
    "h": ("second", 3600.0),
    "d": ("second", 86400.0),
    "day": ("second", 86400.0),
    "mol": ("mole", 1.0),
    "A": ("ampere", 1.0),
    "K": ("kelvin", 1.0),
    "rad": ("radian", 1.0),
    "L": ("litre", 1.0),
    "l": ("litre", 1.0),
    "N": ("newton", 1.0),
    "J": ("joule", 1.0),
    "W": ("watt", 1.0),
    "Pa": ("pascal", 1.0),
    "V": ("volt", 1.0),
    "C": ("coulomb", 1.0),
    "F": ("farad", 1.0),
    "Hz": ("hertz", 1.0),
}
"""Symbols of units: the base unit of SBML, and how many of them one is."""
_PREFIXES: Final = {"p": -12, "n": -9, "u": -6, "µ": -6, "μ": -6, "m": -3, "c": -2, "k": 3, "M": 6, "G": 9}
_FACTOR: Final = re.compile(r"([*/·]?)\s*([^\W\d_]+|1)(?:\s*(?:\^|\*\*)?\s*([-+]?\d))?\s*")

Factor = tuple[str, int, int, float]
"""Base unit, exponent, scale (a power of ten), multiplier."""


class Units:
    """The unit definitions that a document needs."""

    def __init__(self) -> None:
        self._known: dict[tuple[Factor, ...], str] = {}

    def of(self, text: str) -> str:
        """Return the name of the definition of a unit; "" where it cannot be read."""
        factors = read(text)
        if not factors:
            return ""
        return self._known.setdefault(factors, f"unit_{len(self._known) + 1}")

    def definitions(self) -> Iterable[str]:
        """Yield the lines that define all units that were asked for."""
        if not self._known:
            return
        yield "    <listOfUnitDefinitions>"
        for factors, name in self._known.items():
            yield f'      <unitDefinition id="{name}"><listOfUnits>'
            for kind, exponent, scale, multiplier in factors:
                numbers = f'exponent="{exponent}" scale="{scale}" multiplier="{multiplier!r}"'
                yield f'        <unit kind="{kind}" {numbers}/>'
            yield "      </listOfUnits></unitDefinition>"
        yield "    </listOfUnitDefinitions>"


def read(text: str) -> tuple[Factor, ...]:
    """Return the factors of a unit; none where it cannot be read. A line divides by the one unit behind it."""
    found, position = [], 0
    text = text.strip()
    while position < len(text):
        match = _FACTOR.match(text, position)
        factor = None if match is None else _factor(match[2])
        if match is None or factor is None:
            return ()
        exponent = int(match[3] or 1) * (-1 if match[1] == "/" else 1)
        if factor[0] != "dimensionless" or len(text) == 1:
            found.append((factor[0], exponent, *factor[1:]))
        position = match.end()
    return tuple(found)


def _factor(symbol: str) -> tuple[str, int, float] | None:
    """Return base unit, scale and multiplier of one symbol; None where it is unknown."""
    if symbol in _KINDS:
        kind, multiplier = _KINDS[symbol]
        return kind, 0, multiplier
    if symbol[0] in _PREFIXES and symbol[1:] in _KINDS and symbol[1:] not in ("1", "min", "h", "d", "day"):
        kind, multiplier = _KINDS[symbol[1:]]
        return kind, _PREFIXES[symbol[0]], multiplier
    return None
