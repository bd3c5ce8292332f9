"""Names of variables as mathematics: Greek letters, accents, and raised and lowered parts.

The rules are the rules of sympy, except for accents: sympy also finds them in words, such as "bar" in "crowbar". Parts
begin with ``_`` (lowered) and ``__`` (raised); digits at the end of a word of letters are lowered: theta_1, x2, k__on.
"""

import re
from html import escape
from typing import Final, NamedTuple

_NAMES: Final = """alpha beta gamma delta epsilon zeta eta theta iota kappa lambda mu
nu xi omicron pi rho sigma tau upsilon phi chi psi omega"""
_SMALL: Final = dict(zip(_NAMES.split(), "αβγδεζηθικλμνξοπρστυφχψω", strict=True))
_CAPITAL: Final = {name.capitalize(): letter.upper() for name, letter in _SMALL.items()}
GREEK: Final = {**_SMALL, **_CAPITAL, "lamda": "λ", "Lamda": "Λ"}
"""Greek letters by name."""

_LIKE_LATIN: Final = dict(zip("ΑΒΕΖΗΙΚΜΝΟΡΤΧ", "ABEZHIKMNOPTX", strict=True))
"""Capital letters without a command in LaTeX."""
_LATEX: Final = {
    name: rf"\mathrm{{{_LIKE_LATIN[letter]}}}" if letter in _LIKE_LATIN else f"\\{name.replace('amda', 'ambda')}"
    for name, letter in GREEK.items()
} | {"omicron": "o"}

_ACCENTS: Final = ("ddot", "dot", "hat", "bar", "tilde", "vec", "check", "breve", "acute", "grave")
_ACCENTED: Final = re.compile(rf"([^\W\d_]|{'|'.join(GREEK)})({'|'.join(_ACCENTS)})")
_PART: Final = re.compile(r"(?P<mark>__|_)(?P<text>(?:(?!__|_).)*)", re.DOTALL)
_DIGITS_AT_END: Final = re.compile(r"([^\W\d_]+)([0-9]+)")
_WORD: Final = re.compile(r"[^\W\d_]{2,}")
"""Two or more adjacent letters."""


class Parts(NamedTuple):
    """A name as its base and its raised and lowered parts."""

    base: str
    raised: tuple[str, ...]
    lowered: tuple[str, ...]


def parts_of(name: str) -> Parts:
    """Return the parts of `name`, which is not empty."""
    start = 1 if not name.startswith("__") else 2  # a mark at the beginning belongs to the base
    end = name.find("_", start)
    base, rest = (name, "") if end < 0 else (name[:end], name[end:])
    marked = [(match["mark"], match["text"]) for match in _PART.finditer(rest)]
    lowered = [text for mark, text in marked if mark == "_"]
    digits = _DIGITS_AT_END.fullmatch(base)
    if digits:
        base, lowered = digits[1], [digits[2], *lowered]
    return Parts(base, tuple(text for mark, text in marked if mark == "__"), tuple(lowered))


def name_to_latex(name: str) -> str:
    """Return a name, which is an identifier, as LaTeX mathematics.

    Words are upright, since adjacent italic letters mean a product.
    """
    base, raised, lowered = parts_of(name)
    text = _latex_part(base)
    text += f"^{{{' '.join(map(_latex_part, raised))}}}" if raised else ""
    return text + (f"_{{{' '.join(map(_latex_part, lowered))}}}" if lowered else "")


def _latex_part(part: str) -> str:
    if part in _LATEX:
        return _LATEX[part]
    accented = _ACCENTED.fullmatch(part)
    if accented:
        return rf"\{accented[2]}{{{_latex_part(accented[1])}}}"
    return _WORD.sub(lambda word: rf"\mathrm{{{word[0]}}}", part)


def name_to_mathml(name: str) -> str:
    """Return a name, which is an identifier, as an element of MathML (presentation)."""
    base, raised, lowered = parts_of(name)
    elements = [_mathml_part(base), *(_mathml_parts(parts) for parts in (lowered, raised) if parts)]
    if len(elements) == 1:
        return elements[0]
    element = "msubsup" if raised and lowered else "msup" if raised else "msub"
    return f"<{element}>{''.join(elements)}</{element}>"


def _mathml_parts(parts: tuple[str, ...]) -> str:
    if len(parts) == 1:
        return _mathml_part(parts[0])
    return f"<mrow>{'<mo> </mo>'.join(map(_mathml_part, parts))}</mrow>"


def _mathml_part(part: str) -> str:
    return f"<mi>{escape(GREEK.get(part, part))}</mi>"
