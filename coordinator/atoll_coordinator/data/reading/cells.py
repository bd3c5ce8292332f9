"""One cell of a file: whether it is missing, a number, or text. Pure."""

import datetime
import decimal
import fractions
import math
import numbers
import re
import textwrap
from collections.abc import Sequence
from typing import Final

MISSING: Final = frozenset({"", "na", "n/a", "#n/a", "nan", "-nan", "+nan", "null", "none"})
"""Cells, in lower case, that stand for a missing number."""

SPACES: Final = " \u00a0\u2009\u202f'’"
"""Characters, beside commas and points, that separate thousands."""

_EXPONENT: Final = r"(?:[eE][+-]?\d+)?\s*"
WITH_POINT: Final = re.compile(rf"\s*[+-]?[1-9]\d{{,2}}([,{SPACES}])\d{{3}}(?:\1\d{{3}})*(?:\.\d*)?{_EXPONENT}")
"""A number with separators of thousands, the first of which is not zero, and perhaps a decimal point."""
WITH_COMMA: Final = re.compile(
    rf"\s*[+-]?(?:\d*,\d+|\d+,|[1-9]\d{{,2}}([.{SPACES}])\d{{3}}(?:\1\d{{3}})*(?:,\d*)?){_EXPONENT}"
)
"""A number with a decimal comma, or with separators of thousands that go with one."""
_OF_FORTRAN: Final = re.compile(r"\s*[+-]?(?=\.?\d)\d*\.\d*[dD][+-]?\d+\s*")
"""A number of double precision as Fortran writes it; its point tells it from a label such as 1D2."""


class NumberCell(str):
    """The text of a cell that its format holds as a number: its point is a decimal point in every country.

    It says nothing about how other cells of its column, which hold text, are written.
    """

    __slots__ = ()

    def strip(self, chars: str | None = None, /) -> "NumberCell":
        """Return the cell itself: a number has no spaces around it."""
        return self


def is_missing(cell: str) -> bool:
    """Tell whether `cell` stands for a missing number."""
    return cell.strip().lower() in MISSING


def number(cell: str) -> float | None:
    """Return the number in `cell` as Python prints it or Fortran does (NaN when missing), or None for anything else."""
    if is_missing(cell):
        return math.nan
    if "_" in cell:  # groups digits in programs, not in measurements
        return None
    if _OF_FORTRAN.fullmatch(cell):
        cell = cell.lower().replace("d", "e")
    try:
        return float(cell)
    except ValueError:
        return None


def is_numeral(cell: str) -> bool:
    """Tell whether `cell` is a number in some country's writing."""
    if is_missing(cell):
        return False
    return number(cell) is not None or any(form.fullmatch(cell) for form in (WITH_POINT, WITH_COMMA))


def is_text(cells: Sequence[str]) -> bool:
    """Tell whether no cell holds a number and at least one holds text."""
    return not any(map(is_numeral, cells)) and not all(map(is_missing, cells))


def cell_of(value: object) -> str:
    """Return a value that a format or a program holds as a cell.

    That is nothing for None and what is no date, a `NumberCell` for a number, 1 and 0 for what is true and false; dates
    with a time zone are in UTC.
    """
    if value is None or value != value:  # NaN, and NaT of pandas
        return ""
    match value:
        case bool():
            return NumberCell(int(value))
        case int() | float() | decimal.Decimal():
            return NumberCell(value)
        case bytes():
            return value.decode("utf-8", "replace")
        case datetime.datetime() if value.tzinfo is not None:
            return f"{value.astimezone(datetime.UTC).replace(tzinfo=None).isoformat()}Z"
        case datetime.datetime():
            return value.isoformat()
        case fractions.Fraction():
            return NumberCell(float(value))
        case numbers.Real():  # NumPy's
            return NumberCell(value)
    return str(value)


def shortened(text: str, most: int) -> str:
    """Return `text` on one line of at most so many characters, as messages show it."""
    return textwrap.shorten(on_one_line(text), most, placeholder="…")


def on_one_line(text: str) -> str:
    """Return `text` with single spaces for whatever white space it holds, and nothing that a terminal obeys."""
    return visible(" ".join(text.split()))


def visible(text: str) -> str:
    """Return `text` with escapes, as ``\\x1b``, for characters that cannot be seen."""
    if text.isprintable():
        return text
    return "".join(
        character if character.isprintable() else character.encode("unicode_escape").decode() for character in text
    )
