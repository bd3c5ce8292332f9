"""Which texts are units of measurement, so that they are told from data and from remarks in a header. Pure.

A unit is a product of powers of known symbols, such as ``m s^-2``, ``mol/(L h)`` or ``µg/mL``. What a unit means is not
of interest here.
"""

import re
from collections.abc import Sequence
from typing import Final

_PREFIXES: Final = ("da", *"YZEPTGMkhdcmuµμnpfazy")
_WITH_PREFIX_TEXT: Final = (
    "s sec m g A K mol cd rad sr Hz N Pa J W C V F S Wb T H lm lx Bq Gy Sv kat L l M eV B bit b bar Ω Ohm ohm cal Da U "
    "Wh Torr pixel"
)
_PLAIN_TEXT: Final = (
    "min h hr hrs d a y yr secs second seconds minute minutes mins hour hours day days week weeks wk month months year "
    "years ° deg degree degrees °C °F degC degF ℃ ℉ celsius kelvin fahrenheit % ‰ ppm ppb ppt counts count cts "
    "individuals ind cells cell thousands millions dBm pH psi atm torr mmHg inch in ft mi yd lb lbs oz gal mph kph kn "
    "knots kt t ha au AU a.u. arb OD RFU CFU rpm px pixels frame frames step steps cycle cycles rev turns radians "
    "grams meter meters metre metres volt volts amp amps watt watts newton joule kmh dimensionless unitless"
)
_WITH_PREFIX: Final = frozenset(_WITH_PREFIX_TEXT.split())
_PLAIN: Final = frozenset(_PLAIN_TEXT.split())
_SYMBOL: Final = re.compile(r"[^\W\d_⁰¹²³⁴⁵⁶⁷⁸⁹]+|[°℃℉%‰][^\W\d_]*")
_BETWEEN: Final = re.compile(r"[\d\s*/·⋅×.()^⁰¹²³⁴⁵⁶⁷⁸⁹⁻⁺−+-]*")
_LONGEST: Final = 30


def are_units(texts: Sequence[str]) -> bool:
    """Tell whether `texts` are units: one of them is known, and none is a number or too long to be one."""
    if any(len(text) > _LONGEST or _SYMBOL.search(text) is None or _is_number(text) for text in texts):
        return False
    return any(_is_known(text) for text in texts)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _is_known(text: str) -> bool:
    """Tell whether `text` is a product of powers of known symbols."""
    if text in _PLAIN:
        return True
    if text[0].isdigit() and not text.startswith("1/"):
        return False
    return _BETWEEN.fullmatch(_SYMBOL.sub("", text)) is not None and all(map(_is_symbol, _SYMBOL.findall(text)))


def _is_symbol(text: str) -> bool:
    if text in _PLAIN or text in _WITH_PREFIX:
        return True
    return any(text.startswith(prefix) and text[len(prefix) :] in _WITH_PREFIX for prefix in _PREFIXES)
