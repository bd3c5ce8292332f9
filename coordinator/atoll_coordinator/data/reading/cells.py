"""Cells of a file: missing, a number, or text; and the numbers of columns in any country's notation. Pure.

Each column is read in one way: with decimal points or with decimal commas. If the cells of a column leave open whether
``1,234`` is 1.234 or 1234, the other columns of the file decide. If they do not decide, the separator between cells
decides. If this does not decide either, the file is refused. Cells that a file format stores as numbers (`NumberCell`)
are no evidence for the notation of the text cells around them.
"""

import datetime
import decimal
import fractions
import math
import numbers
import re
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from typing import Final, Literal

import numpy as np

from atoll_core.data.dataset import FloatArray
from atoll_core.errors import DataError

_MISSING: Final = frozenset({"", "na", "n/a", "#n/a", "nan", "-nan", "+nan", "null", "none"})
"""Cells, in lower case, that mean a missing number."""
_SPACES: Final = " \u00a0\u2009\u202f'’"
"""Characters, besides commas and points, that separate thousands."""
_WITHOUT_SPACES: Final = str.maketrans("", "", _SPACES)
_EXPONENT: Final = r"(?:[eE][+-]?\d+)?\s*"

DecimalMark = Literal["point", "comma"]
_FORMS: Final[dict[DecimalMark, re.Pattern[str]]] = {
    "point": re.compile(rf"\s*[+-]?[1-9]\d{{,2}}([,{_SPACES}])\d{{3}}(?:\1\d{{3}})*(?:\.\d*)?{_EXPONENT}"),
    "comma": re.compile(
        rf"\s*[+-]?(?:\d*,\d+|\d+,|[1-9]\d{{,2}}([.{_SPACES}])\d{{3}}(?:\1\d{{3}})*(?:,\d*)?){_EXPONENT}"
    ),
}
"""Numbers that `float` does not read: with separators of thousands (the first group is not zero) or a decimal comma."""
_MARK_OF_SEPARATOR: Final[dict[str, set[DecimalMark]]] = {",": {"point"}, ";": {"comma"}}
"""The decimal mark for each separator between cells: files with decimal commas have semicolons between cells."""
_THOUSANDS: Final = re.compile(r"\s*[+-]?[1-9]\d{0,2}(?:\.\d{3})+\s*")
_OF_FORTRAN: Final = re.compile(r"\s*[+-]?(?=\.?\d)\d*\.\d*[dD][+-]?\d+\s*")
"""Double precision as Fortran writes it; the decimal point distinguishes it from a label such as 1D2."""


class NumberCell(str):
    """The text of a cell that the file format stores as a number; a point in it is always a decimal point."""

    __slots__ = ()

    def strip(self, chars: str | None = None, /) -> "NumberCell":
        """Return the cell itself, which has no spaces around it."""
        return self


def is_missing(cell: str) -> bool:
    """Tell whether `cell` means a missing number."""
    return cell.strip().lower() in _MISSING


def number(cell: str) -> float | None:
    """Return the number in `cell` as Python or Fortran prints it (NaN if missing), None for any other cell."""
    if is_missing(cell):
        return math.nan
    if "_" in cell:  # the underscore groups digits in programs, not in measurements
        return None
    if _OF_FORTRAN.fullmatch(cell):
        cell = cell.lower().replace("d", "e")
    try:
        return float(cell)
    except ValueError:
        return None


def is_numeral(cell: str) -> bool:
    """Tell whether `cell` is a number in the notation of any country."""
    return not is_missing(cell) and (number(cell) is not None or any(form.fullmatch(cell) for form in _FORMS.values()))


def is_text(cells: Sequence[str]) -> bool:
    """Tell whether no cell holds a number and at least one holds text."""
    return not any(map(is_numeral, cells)) and not all(map(is_missing, cells))


def cell_of(value: object) -> str:
    """Return the cell of a value that a file format or a Python program holds.

    Empty for None, NaN and NaT; a `NumberCell` for a number; 1 and 0 for true and false; dates with a time zone in UTC.
    """
    if value is None or value != value:
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
        case numbers.Real():  # also the numbers of NumPy
            return NumberCell(value)
    return str(value)


def shortened(text: str, most: int) -> str:
    """Return `text` on one line of at most `most` characters, for a message."""
    return textwrap.shorten(on_one_line(text), most, placeholder="…")


def on_one_line(text: str) -> str:
    """Return `text` with single spaces for all white space, and without control characters for terminals."""
    return visible(" ".join(text.split()))


def visible(text: str) -> str:
    """Return `text` with escapes, such as ``\\x1b``, for invisible characters."""
    if text.isprintable():
        return text
    return "".join(
        character if character.isprintable() else character.encode("unicode_escape").decode() for character in text
    )


def place(lines: Sequence[int], row: int) -> str:
    """Return the line of a row for a message, or its number if the file has no lines."""
    return f"line {lines[row]}" if lines[row] else f"row {row + 1}"


def parse_numbers(
    file: str, columns: Mapping[str, Sequence[str]], lines: Sequence[int], separator: str
) -> tuple[dict[str, FloatArray], tuple[str, ...]]:
    """Return the numbers of the columns of one file, by name, and remarks on how they were read.

    `file` is its name for messages, `lines` the line numbers of the rows (0: none), `separator` the character between
    cells. Raises DataError if a cell holds no number, or a number that can be read in two ways.
    """
    plain = {name: values for name, cells in columns.items() if (values := _plain_numbers(cells)) is not None}
    possible = {name: _possible_marks(file, name, cells, lines) for name, cells in columns.items() if name not in plain}
    decided: set[DecimalMark] = {next(iter(marks)) for marks in possible.values() if len(marks) == 1}
    if any(len(marks) > 1 for marks in possible.values()) and any(_has_decimals(columns[name]) for name in plain):
        decided.add("point")
    usual = decided if len(decided) == 1 else _MARK_OF_SEPARATOR.get(separator, set()) if not decided else set()
    mark_of: dict[str, DecimalMark] = {}
    for name, marks in possible.items():
        chosen = marks & usual or marks
        cell = next((cell for cell in _text_cells(columns[name]) if "," in cell or _is_plain_decimal(cell)), None)
        if len(chosen) > 1 and cell is not None:
            readings = " or ".join(f"{_number(cell, mark):g}" for mark in _FORMS)
            message = f"column '{name}' of {file} holds '{cell.strip()}', which may be {readings}"
            raise DataError(f"{message}; leave out separators of thousands")
        mark_of[name] = next(iter(chosen))
    commas = [name for name, mark in mark_of.items() if mark == "comma" and any("," in cell for cell in columns[name])]
    if commas:
        with_points = {name for name in plain if any("." in cell for cell in _text_cells(columns[name]))}
        mark_of |= {name: "comma" for name in with_points if not _has_decimals(columns[name])}
    grouped = [name for name, mark in mark_of.items() if any(_is_grouped(cell, mark) for cell in columns[name])]
    read = {
        name: np.array([_number(cell, mark) for cell in columns[name]], dtype=np.float64)
        for name, mark in mark_of.items()
    }
    remarks = {"decimal commas": commas, "separators of thousands": grouped}
    return plain | read, tuple(f"{what} in {', '.join(names)}" for what, names in remarks.items() if names)


def _plain_numbers(cells: Sequence[str]) -> FloatArray | None:
    """Return the cells as numbers; None if a cell is not written as Python or Fortran prints numbers."""
    try:
        if not any("_" in cell for cell in cells):
            return np.array([float(cell) for cell in cells], dtype=np.float64)
    except ValueError:
        pass
    values = [number(cell) for cell in cells]
    return None if None in values else np.array(values, dtype=np.float64)


def _possible_marks(file: str, name: str, cells: Sequence[str], lines: Sequence[int]) -> set[DecimalMark]:
    """Return the decimal marks with which all cells of a column can be read; raises DataError if there is none."""
    marks: set[DecimalMark] = {"point", "comma"}
    for row, cell in enumerate(cells):
        if isinstance(cell, NumberCell):
            continue
        of_cell: set[DecimalMark] = {mark for mark, form in _FORMS.items() if form.fullmatch(cell)}
        if number(cell) is not None:
            of_cell = {"point"} if _has_decimals([cell]) else {"point", "comma"}
        if not of_cell:
            held = f"'{shortened(cell, 40)}' in {place(lines, row)}"
            raise DataError(f"column '{name}' of {file} holds {held} where a number is expected")
        if not marks & of_cell:
            raise DataError(
                f"column '{name}' of {file} holds '{on_one_line(cell)}' in {place(lines, row)}, but decimal "
                f"{'commas' if marks == {'comma'} else 'points'} above it; write all numbers in one way"
            )
        marks &= of_cell
    return marks


def _text_cells(cells: Sequence[str]) -> Iterator[str]:
    return (cell for cell in cells if not isinstance(cell, NumberCell))


def _is_plain_decimal(cell: str) -> bool:
    return "." in cell and number(cell) is not None


def _has_decimals(cells: Sequence[str]) -> bool:
    """Tell whether the text cells of a column have a point that cannot separate thousands, and so must be a decimal
    point."""
    return any("." in cell and not _THOUSANDS.fullmatch(cell) for cell in _text_cells(cells))


def _number(cell: str, mark: DecimalMark) -> float:
    if isinstance(cell, NumberCell):
        return float(cell)
    text = cell.strip().translate(_WITHOUT_SPACES)
    if mark == "point":
        text = text.replace(",", "")
    elif "," in text or _THOUSANDS.fullmatch(text):
        text = text.replace(".", "").replace(",", ".")
    value = math.nan if is_missing(cell) else number(text)
    assert value is not None
    return value


def _is_grouped(cell: str, mark: DecimalMark) -> bool:
    separators = ("," if mark == "point" else ".", *_SPACES)
    is_written = not isinstance(cell, NumberCell) and not is_missing(cell)
    return is_written and any(separator in cell.strip() for separator in separators)
