"""Where the table begins in a file whose first rows are something else: titles, settings, names of the recorder. Pure.

The first rows of numbers tell where: the header is the row above them. Where several rows of text stand there, the one
that names a time is the header; where none does, or several do, nothing is decided here.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from atoll_coordinator.data.reading.cells import is_missing
from atoll_coordinator.data.reading.dates import is_datum
from atoll_coordinator.data.reading.footer import footer_length
from atoll_coordinator.data.reading.header import Record, are_groups
from atoll_coordinator.data.reading.raw_table import is_units_row
from atoll_coordinator.data.reading.times_as_columns import has_times
from atoll_coordinator.data.roles.column_options import split_unit
from atoll_coordinator.data.roles.time_column import TIME_NAMES

SAMPLED: Final = 200
"""Rows among which a table begins, if it has a preamble: they bound what a long file costs.

Preambles have a few dozen lines. 498 files that `benchmarks.operations.files` draws are read alike with 20 to 2,000.
"""
_ALIKE: Final = 20
"""So many rows, if there are as many, hold numbers in the same columns where a table begins.

Of those 498 files, five that are not damaged are refused with 2 rows; with 3 and 10 the same are read as with 20, and
some damaged ones are refused with another sentence; from 12 on nothing changes. The tables have 6 to 15 rows.
"""
_TIMES: Final = frozenset({"t", "time", "times", "timestamp", "date", "datetime", "day", "hour", "year"})
"""What a column of times is called, in lower case, where that tells a header from other rows of text."""


@dataclass(frozen=True)
class Preamble:
    """The rows of a file before its table: `header` is the line of the header, which `above` lines stand above.

    `below` are lines of text between the header and the first numbers, which are neither units nor data.
    """

    header: int
    above: tuple[int, ...]
    below: tuple[int, ...] = ()

    @property
    def remarks(self) -> tuple[str, ...]:
        """What is said of the lines that are left out."""
        places = ((self.above, "above"), (self.below, "below"))
        return tuple(f"{_lines(lines)} {where} the header left out" for lines, where in places if lines)


def _lines(lines: Sequence[int]) -> str:
    return f"line {lines[0]}" if len(lines) == 1 else f"lines {lines[0]} to {lines[-1]}"


def find_preamble(rows: Sequence[Record]) -> Preamble | None:
    """Return what stands before the table in rows that are not blank; None where that is nothing, or cannot be told."""
    rows = rows[:SAMPLED]
    first = next((place for place in range(len(rows)) if _begins(rows[place:])), None)
    if not first or any(_is_data(cells, rows[first][1]) for _, cells in rows[:first]):
        return None  # there is no header, it is a comment, or there are two tables
    if has_times(rows[first][1], [cells for _, cells in rows[first + 1 :]]):
        return Preamble(rows[first][0], tuple(line for line, _ in rows[:first]))
    block = _block(rows, first)
    place = _header_of(rows, block)
    if place is None:
        return None
    start = place
    following = [cells for _, cells in rows[place : place + 4]]
    if place and are_groups(rows[place - 1][1], following[0], following[1:3]):
        start = place - 1
    between = [(line, cells) for line, cells in rows[place + 1 : first]]
    if between and is_units_row(between[0][1], rows[place][1]):
        between = between[1:]
    if len(block) < 3:
        between = []  # a word in place of a number is refused, unless a recorder has several rows of such words
    if not start and not between:
        return None
    return Preamble(rows[start][0], tuple(line for line, _ in rows[:start]), tuple(line for line, _ in between))


def begins_within(rows: Sequence[Record]) -> bool:
    """Tell whether a table begins among rows at all, as they were split."""
    filled = [(line, cells) for line, cells in rows[:SAMPLED] if any(map(str.strip, cells))]
    return any(_begins(filled[place:]) for place in range(len(filled)))


def _begins(rows: Sequence[Record]) -> bool:
    """Tell whether rows of numbers begin here: all of one width, with columns of numbers or dates alone.

    A setting such as ``Rate, 100`` fills one of them only.
    """
    alike = [cells for _, cells in rows[:_ALIKE]]
    width = len(alike[0])
    if width < 2 or not any(map(is_datum, alike[0])):
        return False
    if len(rows) <= 2 * _ALIKE:  # else a footer is no part of these
        alike = alike[: len(rows) - footer_length([cells for _, cells in rows])]
    if any(len(cells) != width for cells in alike):
        return False
    columns = [[cell for cell in column if not is_missing(cell)] for column in zip(*alike, strict=True)]
    numbers = [place for place, column in enumerate(columns) if column and all(map(is_datum, column))]
    filled = sum(is_datum(alike[0][place]) for place in numbers)
    return bool(numbers) and 2 * filled >= len(numbers)


def _is_data(cells: Sequence[str], below: Sequence[str]) -> bool:
    """Tell whether a row holds nothing but numbers and dates, or all those that the rows of the table hold."""
    filled = [cell for cell in cells if not is_missing(cell)]
    of_table = [place for place, cell in enumerate(below) if is_datum(cell)]
    is_like = len(cells) == len(below) and len(of_table) > 1 and all(is_datum(cells[place]) for place in of_table)
    return is_like or (len(filled) > 1 and all(map(is_datum, filled)))


def _block(rows: Sequence[Record], first: int) -> list[int]:
    """Return the places of the rows of text that stand right above row `first`, and are no wider."""
    width = len(rows[first][1])
    block: list[int] = []
    for place in range(first - 1, -1, -1):
        line, cells = rows[place]
        is_next = line + 1 == rows[place + 1][0]
        if block and not is_next:
            break
        if any(map(is_datum, cells)) or not 2 <= len(cells) <= width:
            break
        block.append(place)
    return block[::-1]


def _header_of(rows: Sequence[Record], block: Sequence[int]) -> int | None:
    """Return the place of the header among rows of text; None where that is not clear.

    It is the only one that is wide enough, or that names a time; below something else, the first one.
    """
    width = max((len(rows[place][1]) for place in block), default=0)
    wide = [place for place in block if len(rows[place][1]) == width]
    if len(wide) == 1:
        return wide[0]
    most = max((_filled(rows[place][1]) for place in wide), default=0)
    for known in (frozenset(TIME_NAMES), _TIMES):
        named = [place for place in wide if any(_plain(cell) in known for cell in rows[place][1])]
        if len(named) == 1:
            return named[0] if _filled(rows[named[0]][1]) >= min(most, 2) else None
    return wide[0] if wide and wide[0] > 0 else None


def _plain(cell: str) -> str:
    name = split_unit(cell)[0].strip()
    return name if name in TIME_NAMES else name.lower()


def _filled(cells: Sequence[str]) -> int:
    return sum(bool(cell.strip()) for cell in cells)
