"""Units of columns and constants as unit definitions of SBML: products of powers of the SI's base units."""

import math
from typing import Final

from atoll.export.template import Values
from atoll_coordinator.units import expanded, is_factor, parse_unit
from atoll_core.errors import UsageError

_KINDS: Final = {
    "m": "metre",
    "s": "second",
    "g": "gram",
    "A": "ampere",
    "K": "kelvin",
    "mol": "mole",
    "cd": "candela",
}

Factor = tuple[str, float, float]
"""A unit of SBML: its kind, its exponent, its multiplier."""


class Units:
    """The unit definitions that a document needs."""

    def __init__(self) -> None:
        self._known: dict[tuple[Factor, ...], str] = {}

    def of(self, text: str | None) -> str:
        """Return the name of the definition of a unit; "" where there is none, or SBML does not know it."""
        factors = factors_of(text or "")
        if not factors:
            return ""
        return self._known.setdefault(factors, f"unit_{len(self._known) + 1}")

    def definitions(self) -> list[Values]:
        """Return the definitions of all units that were asked for, as the template of a document names their parts."""
        return [
            {
                "name": name,
                "factors": [
                    {"kind": kind, "exponent": f"{exponent:g}", "multiplier": multiplier}
                    for kind, exponent, multiplier in factors
                ],
            }
            for factors, name in self._known.items()
        ]


def factors_of(text: str) -> tuple[Factor, ...]:
    """Return the factors of a unit; none of what the SI does not know, and of too large a factor."""
    if not text.strip():
        return ()
    try:
        powers = expanded(parse_unit(text))
    except UsageError:
        return ()
    if any(not is_factor(symbol) and symbol not in _KINDS for symbol in powers):
        return ()
    kinds = [(_KINDS[symbol], float(power)) for symbol, power in powers.items() if symbol in _KINDS]
    kind, exponent = kinds[0] if kinds else ("dimensionless", 1.0)
    try:
        size = math.prod(float(symbol) ** float(power) for symbol, power in powers.items() if is_factor(symbol))
        multiplier = float(f"{size ** (1.0 / exponent):.15g}")  # (m u)^e: the first kind takes the size
    except (OverflowError, ZeroDivisionError):
        return ()
    if not 0.0 < multiplier < math.inf:
        return ()
    first = (kind, exponent, multiplier)
    return (first, *((kind, exponent, 1.0) for kind, exponent in kinds[1:]))
