"""One file as text cells: `RawTable`, and which rows are its header, its units and its footer. Pure.

All rules depend on which cells are numbers or dates, because titles, notes and totals can have any text:

- header: the first row, unless that row holds data; or the second row, below names of groups. A recorder of several
  objects writes ``,mass A,,`` above ``t,frame,x,y``, and pandas writes two levels of columns in this way;
- units: a row below the header, without numbers, in which one cell is a known unit;
- footer: the rows below the last row of data (totals, sources, numbers of observations). Its first row must read as a
  line of text, or begin with a word in a column where all rows above have a number or a date. Any other row may be a
  damaged row of data and is refused, as a damaged row within the table is.
"""

import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, islice, pairwise
from typing import Final

from atoll_coordinator.data.reading.cells import is_missing, is_numeral, is_text, on_one_line, shortened
from atoll_coordinator.data.reading.dates import ascends, is_date, is_datum
from atoll_coordinator.data.roles.names_and_options import TIME_NAMES, are_units, split_unit
from atoll_core.errors import DataError

_BRACKETS: Final = re.compile(r"^\s*[\[(](.*)[\])]\s*$")
_NO_UNIT: Final = frozenset({"-", "–", "1"})
_FORM_OF_DATES: Final = re.compile(
    r"(?:(?:yyyy|yy|dd|mm?)[-./ ]?){2,3}(?:[T ]*(?:[-:. ]?(?:hh?|mm|ss|f+)){2,4})?|hh?:mm(?::ss)?(?:[.,][fs0]+)?",
    re.IGNORECASE,
)
"""The format of dates and clock times in a row of units, such as dd.mm.yyyy hh:mm."""
_SAMPLED: Final = 50
"""Number of first rows that decide which columns hold numbers; at most half of all rows, since a footer comes last."""
_QUOTED: Final = 3
"""Lines of a footer that a message quotes."""
_LETTERS: Final = r"[^\W\d_]"
_WORD: Final = re.compile(rf"[^0-9]*?(?:{_LETTERS}{{2,}}|[^\x00-\x7f\d\W_])[^0-9]*")
"""Text that has a word, or a letter such as Σ, and no digit: a damaged number has digits."""
_TEXTS: Final = rf"[^0-9]*{_LETTERS}{{2,}}.*|\W*{_LETTERS}(?:\s*[=:<>]|\)\s).*|\W*[^\w\s]{{3,}}\W*"
_BEGINS_WITH_A_WORD: Final = re.compile(_TEXTS, re.DOTALL)
"""Text with a word before any digit, such as ``n = 20``, ``p < 0.05``, ``(c) 2020``, or a line of three or more
marks."""
_LINE_OF_TEXT: Final = re.compile(rf"{_TEXTS}|\W*\d+ .*{_LETTERS}{{3,}}.*", re.DOTALL)
"""Text as in `_BEGINS_WITH_A_WORD`, or such as ``20 observations``, which may also be a damaged date."""
_ALIKE: Final = 3
"""Number of first characters that a damaged name or date has in common with others of its column, such as the first
letters of a month."""

Record = tuple[int, list[str]]
"""Line number and cells of one row."""


@dataclass(frozen=True)
class RawTable:
    """Cells of one file as text: `columns[i]` are the cells under `headers[i]`; `lines` their line numbers, or 0.

    A cell that the format stores as a number is a `NumberCell`. `units` come from a separate row or from the format, ""
    if there is no unit; `starts` are the rows at which trajectories begin; `remarks` say how the file was read;
    `separator` is the character between cells, "" if the format has none. `left_out` names the parts of the file that
    are not part of the table, for a warning.
    """

    headers: tuple[str, ...]
    columns: list[list[str]]
    lines: list[int]
    starts: list[int]
    remarks: tuple[str, ...]
    units: tuple[str, ...] = ()
    separator: str = ""
    left_out: tuple[str, ...] = ()


def table_of_records(
    file: str,
    headers: Sequence[str],
    records: Iterable[Record],
    has_row_names: bool = False,
    may_have_commas: bool = False,
) -> RawTable:
    """Return the table of records (line numbers and cells); blank records begin trajectories, a footer is left out.

    `has_row_names` tells whether rows may begin with a name for which the header has no cell. `may_have_commas` tells
    whether decimal commas may be the reason why a row has more cells than the header. Raises DataError if a record has
    more or fewer cells than the header, unless the rows show which columns have no name.
    """
    headers = [on_one_line(header) for header in headers]
    lines: list[int] = []
    kept: list[list[str]] = []
    starts = [0]
    for line, record in records:
        if any(cell.strip() for cell in record):
            kept.append(record)
            lines.append(line)
        else:
            starts.append(len(lines))
    end = len(kept) - footer_length(len(kept), kept.__getitem__)
    left_out = (_footer_phrase(lines[end:], kept[end:], "line"),) if end < len(kept) else ()
    kept, lines = kept[:end], lines[:end]
    headers, kept = _with_unnamed(headers, kept, starts, has_row_names, may_have_commas)
    for line, record in zip(lines, kept, strict=True):
        if len(record) != len(headers):
            count = f"{len(record)} {'cell' if len(record) == 1 else 'cells'}"
            raise DataError(f"line {line} of {file} has {count} where the header has {len(headers)}; correct it")
    columns = [list(column) for column in zip(*kept, strict=True)] or [[] for _ in headers]
    starts = sorted({start for start in starts if start < max(len(lines), 1)})
    return _take_units(RawTable(tuple(headers), columns, lines, starts, (), left_out=left_out))


def with_breaks(
    headers: Sequence[str], columns: list[list[str]], remarks: tuple[str, ...], units: Sequence[str] = ()
) -> RawTable:
    """Return the table of a format without lines; rows that are missing in every column separate trajectories."""
    count = len(columns[0]) if columns else 0
    blank = [all(is_missing(cell) for cell in row) for row in zip(*columns, strict=True)]
    kept = [row for row in range(count) if not blank[row]]
    length = footer_length(len(kept), lambda place: [column[kept[place]] for column in columns])
    kept, below = kept[: len(kept) - length], kept[len(kept) - length :]
    starts = [0] + [place for place, (row, after) in enumerate(pairwise(kept), start=1) if after != row + 1]
    taken = columns if len(kept) == count else [[column[row] for row in kept] for column in columns]
    rows_below = [[column[row] for column in columns] for row in below]
    left_out = (_footer_phrase([row + 1 for row in below], rows_below, "row"),) if below else ()
    return RawTable(tuple(headers), taken, [0] * len(kept), starts, remarks, tuple(units), left_out=left_out)


def _with_unnamed(
    headers: list[str], rows: list[list[str]], starts: Sequence[int], has_row_names: bool, may_have_commas: bool
) -> tuple[list[str], list[list[str]]]:
    """Return headers and rows if the header has too few cells: the first or the last columns have no name.

    Trailing cells that are empty in all rows are removed. If rows have names, the first column has no header. Otherwise
    the headers belong to the first columns or to the last columns. Exactly one of the two assignments must make the
    time ascend and put headers above numbers; if not, the result is unchanged.
    """
    width = len(rows[0]) if rows else 0
    if width <= len(headers) or any(len(row) != width for row in rows):
        return headers, rows
    while width > len(headers) and not any(row[width - 1].strip() for row in rows):  # separators at the end
        width, rows = width - 1, [row[: width - 1] for row in rows]
    blank = [""] * (width - len(headers))
    if not blank or (has_row_names and len(blank) == 1):
        return [*blank, *headers], rows
    time = next((name for name in headers if split_unit(name)[0] in TIME_NAMES), None)
    has_commas = may_have_commas and not any("." in cell and is_numeral(cell) for row in rows for cell in row)
    if time is None or has_commas:
        return headers, rows
    columns = [*zip(*rows, strict=True)]
    fitting = [
        named
        for named in ([*headers, *blank], [*blank, *headers])
        if ascends(columns[named.index(time)], starts)
        and not any(name and is_text(cells) for name, cells in zip(named, columns, strict=True))
    ]
    return fitting[0] if len(fitting) == 1 else headers, rows


# ------------------------------------------------------------------------------------------------------- row of units


def _take_units(raw: RawTable) -> RawTable:
    """Return the table; if its first row holds units and no numbers, they become its `units`."""
    if len(raw.lines) < 2 or not is_units_row([column[0] for column in raw.columns], raw.headers):
        return raw
    if not any(is_numeral(column[1]) for column in raw.columns):
        return raw
    return replace(
        raw,
        columns=[column[1:] for column in raw.columns],
        lines=raw.lines[1:],
        starts=sorted({max(start - 1, 0) for start in raw.starts}),
        remarks=(*raw.remarks, f"units in {f'line {raw.lines[0]}' if raw.lines[0] else 'the first row'}"),
        units=tuple(plain_unit(column[0]) for column in raw.columns),
    )


def is_units_row(cells: Sequence[str], headers: Sequence[str]) -> bool:
    """Tell whether `cells` hold units, or marks for no unit, and are not a repeated header.

    A cell may also say how dates are written (yyyy-mm-dd); no cell is a number.
    """
    texts = [unit for unit in map(plain_unit, cells) if unit]
    is_header = [on_one_line(cell) for cell in cells] == list(headers)
    is_nothing = all(is_missing(cell) for cell in cells) or any(is_numeral(cell) for cell in cells)
    return not is_header and (are_units(texts) if texts else not is_nothing)


def plain_unit(cell: str) -> str:
    """Return a unit without its brackets, "" for none."""
    match = _BRACKETS.match(cell)
    text = on_one_line(match[1] if match else cell)
    return "" if text in _NO_UNIT or is_missing(text) or _FORM_OF_DATES.fullmatch(text) else text


# ------------------------------------------------------------------------------------------------------------- footer


def footer_length(count: int, row: Callable[[int], Sequence[str]]) -> int:
    """Return how many of the last rows, among `count` nonblank rows, are not data; `row` returns a row by its index.

    The result is 0 if the last row holds data, and also if it may be a damaged row.
    """
    if count < 2:
        return 0
    first = [row(place) for place in range(min(max(count // 2, min(count, 3)), _SAMPLED))]
    width = Counter(map(len, first)).most_common(1)[0][0]
    sample = [cells for cells in first if len(cells) == width]
    numeric = []
    for place in range(width):
        filled = [is_datum(cells[place]) for cells in sample if not is_missing(cells[place])]
        if 2 * sum(filled) > len(filled):
            numeric.append(place)
    end = count
    while end and not _is_data(row(end - 1), width, numeric):
        end -= 1
    if not numeric or end in (0, count):
        return 0
    below = [row(place) for place in range(end, count)]
    wide = [cells[0].strip() for cells in below if len(cells) == width and any(map(is_datum, cells))]
    if len(set(wide)) < len(wide):
        return 0  # rows that begin with the name of a trajectory, which is not a number
    if width == 1 and below[0][0].strip().isalpha():
        return 0  # a word in place of a number
    names = [cell for place in range(end) if any(map(str.isalpha, cell := row(place)[0].strip()))]
    return len(below) if _is_footer(below[0], 0 in numeric, names) else 0


def _is_data(cells: Sequence[str], width: int, numeric: Sequence[int]) -> bool:
    """Tell whether a row is as wide as the table, with numbers, dates or nothing in the columns of numbers."""
    if len(cells) != width:
        return False
    filled = [cells[place] for place in numeric if not is_missing(cells[place])]
    return bool(filled) and all(map(is_datum, filled))


def _is_footer(cells: Sequence[str], is_numeric: bool, names: Sequence[str]) -> bool:
    """Tell whether a row is neither data nor a damaged row of data.

    `is_numeric`: the first column holds numbers or dates. `names` are the cells of this column with letters, including
    dates.
    """
    first, filled = cells[0].strip(), [cell for cell in cells if not is_missing(cell)]
    if is_missing(first) or is_datum(first) or any(name.startswith(first[:_ALIKE]) for name in names):
        return False  # a truncated row of data begins like other rows of data
    has_numbers = any(map(is_datum, filled))
    if _WORD.fullmatch(first) and (is_numeric or not has_numbers):
        return True
    may_be_date = any(name[0].isdecimal() for name in names)
    is_sentence = _BEGINS_WITH_A_WORD if may_be_date else _LINE_OF_TEXT
    is_split = sum(not is_datum(cell) for cell in filled) > 1  # a sentence that was split at its spaces
    return is_sentence.fullmatch(" ".join(cells)) is not None and (is_split or not has_numbers)


def _footer_phrase(lines: Sequence[int], rows: Sequence[Sequence[str]], kind: str) -> str:
    places = f"{kind} {lines[0]}" if len(lines) == 1 else f"{kind}s {lines[0]} to {lines[-1]}"
    quoted = ", ".join(f"'{shortened(' '.join(cells), 40)}'" for cells in rows[:_QUOTED])
    return f"{places} below the table left out: {quoted}{', …' if len(rows) > _QUOTED else ''}"


# ------------------------------------------------------------------------------------------------------------- header


@dataclass(frozen=True)
class Header:
    """The header of a table in line `line`: its `names`, and for each name the group above it, if any.

    `is_made` is true for a table without a header.
    """

    line: int
    names: list[str]
    groups: tuple[str, ...] = ()
    is_made: bool = False

    def applied(self, raw: RawTable) -> RawTable:
        """Return the table with this header; a name that several groups have is extended by the name of its group.

        Equal columns of one name, such as the times of several objects, become one column.
        """
        if self.is_made:
            return named_by_place(raw)
        if not self.groups or len(raw.headers) != len(self.groups):
            return raw
        counts = Counter(name for name in raw.headers if name)
        kept: dict[int, str] = {}
        for place, (name, group) in enumerate(zip(raw.headers, self.groups, strict=True)):
            same = [other for other, header in enumerate(raw.headers) if header == name]
            is_shared = all(raw.columns[other] == raw.columns[place] for other in same)
            if counts[name] > 1 and is_shared and place > same[0]:
                continue
            is_repeated = counts[name] > 1 and not is_shared and group
            kept[place] = f"{group} {name}" if is_repeated else name
        named = ", ".join(dict.fromkeys(filter(None, self.groups)))
        return replace(
            raw,
            headers=tuple(kept.values()),
            columns=[raw.columns[place] for place in kept],
            units=tuple(raw.units[place] for place in kept) if raw.units else (),
            remarks=(*raw.remarks, f"header in line {self.line} below names of groups: {named}"),
        )


def take_header(records: Iterable[Record]) -> tuple[Header, Iterator[Record]]:
    """Return the header and the rows below it; if all rows are empty, a header without names."""
    rows = iter(records)
    line, top = next(((line, cells) for line, cells in rows if any(map(str.strip, cells))), (0, [""]))
    following = [*islice(rows, 3)]
    if _begins_with_data(top, [cells for _, cells in following]):
        return Header(line, [""] * len(top), is_made=True), chain([(line, top)], following, rows)
    if not following or not are_groups(top, following[0][1], [cells for _, cells in following[1:]]):
        return Header(line, top), chain(following, rows)
    (line, names), *below = following
    if below and not names[0].strip() and _names_index(below[0][1]):  # pandas writes two levels of columns in this way
        names, below = [below[0][1][0], *names[1:]], below[1:]
    groups: list[str] = []
    for name in map(on_one_line, top):
        groups.append(name or (groups[-1] if groups else ""))
    return Header(line, names, tuple(groups)), chain(below, rows)


def _begins_with_data(top: Sequence[str], following: Sequence[Sequence[str]]) -> bool:
    """Tell whether the first row holds data: numbers and dates, also in its first cell, as the row below it does.

    Both rows may have text in the same cells if they also have at least two numbers or dates.
    """
    below = next((cells for cells in following if any(map(str.strip, cells))), top)
    filled = [cell.strip() for cell in top if cell.strip()]
    if any(filled == [str(place + first) for place in range(len(filled))] for first in (0, 1)) and len(filled) > 1:
        return all(cell.strip() == "" or cell.strip().isdigit() for cell in below)  # 0, 1, 2 are names of columns
    if len(below) != len(top) or not any(map(is_numeral, top)):
        return False
    if all(is_missing(cell) or is_datum(cell) for cell in (*top, *below)):
        return True
    kinds = [[(is_datum(cell), is_missing(cell)) for cell in cells] for cells in (top, below)]
    return kinds[0] == kinds[1] and is_datum(top[0]) and sum(map(is_datum, top)) > 1


def named_by_place(raw: RawTable) -> RawTable:
    """Return the table, which has no header, with names: t for a first column that ascends, x1, x2, … for others."""
    has_time = len(raw.headers) > 1 and ascends(raw.columns[0], raw.starts)
    count = len(raw.headers) - has_time
    names = (*(("t",) if has_time else ()), *(("x",) if count == 1 else [f"x{place + 1}" for place in range(count)]))
    return replace(raw, headers=names, remarks=(*raw.remarks, f"no header: columns are called {', '.join(names)}"))


def are_groups(top: Sequence[str], names: Sequence[str], below: Sequence[Sequence[str]]) -> bool:
    """Tell whether `top` holds names of groups of the columns `names`; `below` are a row or two of data.

    The names of a header are complete and different. Names of groups are repeated, or have empty cells where the row
    below has names above numbers. A row of units comes below the header.
    """
    texts = [cell.strip() for cell in top]
    filled = [text for text in texts if text]
    headers = [name.strip() for name in names]
    if len(texts) != len(headers) or not filled or any(map(is_numeral, (*filled, *headers))):
        return False
    if any(text in TIME_NAMES for text in filled) or all(are_units([plain_unit(name)]) for name in headers if name):
        return False

    def has_data(place: int) -> bool:
        cells = [row[place] for row in below if place < len(row)]
        return any(not is_missing(cell) and (is_numeral(cell) or is_date(cell)) for cell in cells)

    new = [place for place, name in enumerate(headers) if name and not texts[place] and has_data(place)]
    if any(place > 0 or headers[place] in TIME_NAMES for place in new):
        return True
    if not texts[0] and not headers[0] and below and _names_index(below[0]):
        return True
    is_repeated = len(set(filled)) < len(filled)
    has_time = any(name in TIME_NAMES for name in headers)
    return is_repeated and any(map(has_data, range(len(headers)))) and (has_time or not is_units_row(names, top))


def _names_index(cells: Sequence[str]) -> bool:
    """Tell whether only the first cell of a row has a name."""
    return bool(cells) and not is_missing(cells[0]) and not is_numeral(cells[0]) and not any(map(str.strip, cells[1:]))
