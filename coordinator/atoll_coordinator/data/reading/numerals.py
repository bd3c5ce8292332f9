"""Cells -> numbers, in whatever way a country writes them: decimal commas or points, separators of thousands. Pure.

Each column is read in one way. Where its own cells leave open whether ``1,234`` is 1.234 or 1234, the other columns of
the file decide, then what separates its cells; else the file is refused. Cells that their format holds as numbers are
these numbers, and tell nothing of the others.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Final, Literal

import numpy as np

from atoll_coordinator.data.reading.cells import (
    SPACES,
    WITH_COMMA,
    WITH_POINT,
    NumberCell,
    is_missing,
    number,
    on_one_line,
    shortened,
)
from atoll_core.data.dataset import FloatArray
from atoll_core.errors import DataError

_THOUSANDS: Final = re.compile(r"\s*[+-]?[1-9]\d{0,2}(?:\.\d{3})+\s*")
_GROUPS: Final = str.maketrans("", "", SPACES)

Decimal = Literal["point", "comma"]
_OF_SEPARATOR: Final[dict[str, set[Decimal]]] = {",": {"point"}, ";": {"comma"}}
"""How numbers are written where that separates cells: semicolons do where commas are decimal."""


def read_numbers(
    file: str, columns: Mapping[str, Sequence[str]], lines: Sequence[int], separator: str
) -> tuple[dict[str, FloatArray], tuple[str, ...]]:
    """Return the numbers of the columns of one file, by name, and remarks on how they were read.

    `file` is its name, for messages, `lines` are line numbers, 0 where there are none; `separator` stands between
    cells. Raises DataError where a cell holds no number, or one that may be two.
    """
    plain = {name: numbers for name, cells in columns.items() if (numbers := _plain(cells)) is not None}
    ways = {name: _ways(file, name, cells, lines) for name, cells in columns.items() if name not in plain}
    seen: set[Decimal] = {next(iter(possible)) for possible in ways.values() if len(possible) == 1}
    if any(len(possible) > 1 for possible in ways.values()) and any(_has_decimals(columns[name]) for name in plain):
        seen.add("point")
    usual = seen if len(seen) == 1 else _OF_SEPARATOR.get(separator, set()) if not seen else set()
    decimals: dict[str, Decimal] = {
        name: next(iter(possible & usual)) if possible & usual else _only(file, name, columns[name], possible)
        for name, possible in ways.items()
    }
    commas = [name for name, way in decimals.items() if way == "comma" and any("," in cell for cell in columns[name])]
    if commas:
        decimals |= {name: "comma" for name in plain if _has_thousands(columns[name])}
    grouped = [name for name, way in decimals.items() if any(_is_grouped(cell, way) for cell in columns[name])]
    read = {
        name: np.array([_number(cell, way) for cell in columns[name]], dtype=np.float64)
        for name, way in decimals.items()
    }
    remarks = {"decimal commas": commas, "separators of thousands": grouped}
    return plain | read, tuple(f"{what} in {', '.join(names)}" for what, names in remarks.items() if names)


def _plain(cells: Sequence[str]) -> FloatArray | None:
    """Return the cells as numbers; None where one of them is not written as Python prints numbers."""
    try:
        if not any("_" in cell for cell in cells):
            return np.array([float(cell) for cell in cells], dtype=np.float64)
    except ValueError:
        pass
    numbers = [number(cell) for cell in cells]
    return None if None in numbers else np.array(numbers, dtype=np.float64)


def _ways(file: str, name: str, cells: Sequence[str], lines: Sequence[int]) -> set[Decimal]:
    """Return in which ways all cells of a column can be read."""
    ways: set[Decimal] = {"point", "comma"}
    for row, cell in enumerate(cells):
        cell_ways = _ways_of(cell)
        if not cell_ways:
            held = f"'{shortened(cell, 40)}' in {place(lines, row)}"
            raise DataError(f"column '{name}' of {file} holds {held} where a number is expected")
        if not ways & cell_ways:
            raise DataError(
                f"column '{name}' of {file} holds '{on_one_line(cell)}' in {place(lines, row)}, but decimal "
                f"{'commas' if ways == {'comma'} else 'points'} above it; write all numbers in one way"
            )
        ways &= cell_ways
    return ways


def _ways_of(cell: str) -> set[Decimal]:
    if isinstance(cell, NumberCell):
        return {"point", "comma"}
    if number(cell) is not None:
        return {"point"} if _has_decimals([cell]) else {"point", "comma"}
    forms: dict[Decimal, re.Pattern[str]] = {"point": WITH_POINT, "comma": WITH_COMMA}
    return {way for way, form in forms.items() if form.fullmatch(cell)}


def _has_decimals(cells: Sequence[str]) -> bool:
    """Tell whether a point in the texts of a column is none that separates thousands."""
    return any("." in cell and not _THOUSANDS.fullmatch(cell) for cell in _texts(cells))


def _has_thousands(cells: Sequence[str]) -> bool:
    """Tell whether all points in the texts of a column separate thousands."""
    return any("." in cell for cell in _texts(cells)) and not _has_decimals(cells)


def _texts(cells: Sequence[str]) -> Iterator[str]:
    """Yield the cells that are text in their format."""
    return (cell for cell in cells if not isinstance(cell, NumberCell))


def _only(file: str, name: str, cells: Sequence[str], ways: set[Decimal]) -> Decimal:
    """Return the only way, or either where both give the same numbers."""
    cell = next((cell for cell in _texts(cells) if "," in cell or (number(cell) is not None and "." in cell)), None)
    if len(ways) == 1 or cell is None:
        return next(iter(ways))
    readings = " or ".join(f"{_number(cell, way):g}" for way in ("point", "comma"))
    raise DataError(
        f"column '{name}' of {file} holds '{cell.strip()}', which may be {readings}; leave out separators of thousands"
    )


def _number(cell: str, way: Decimal) -> float:
    if isinstance(cell, NumberCell):
        return float(cell)
    if is_missing(cell):
        return float("nan")
    text = cell.strip().translate(_GROUPS)
    if way == "point":
        plain = text.replace(",", "")
    else:
        plain = (text.replace(".", "") if "," in text or _THOUSANDS.fullmatch(text) else text).replace(",", ".")
    value = number(plain)
    assert value is not None
    return value


def _is_grouped(cell: str, way: Decimal) -> bool:
    separators = ("," if way == "point" else ".", *SPACES)
    is_text = not isinstance(cell, NumberCell) and not is_missing(cell)
    return is_text and any(separator in cell.strip() for separator in separators)


def place(lines: Sequence[int], row: int) -> str:
    """Return where a row stands: its line, or its number in a file without lines."""
    return f"line {lines[row]}" if lines[row] else f"row {row + 1}"
