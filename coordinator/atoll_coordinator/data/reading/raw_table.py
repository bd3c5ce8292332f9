"""What is read from one file, before cells are numbers: `RawTable`. Pure."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

from atoll_coordinator.data.reading.cells import is_missing, is_numeral, is_text, on_one_line
from atoll_coordinator.data.reading.dates import ascends
from atoll_coordinator.data.reading.footer import footer_below, footer_length, footer_phrase
from atoll_coordinator.data.roles.column_options import split_unit
from atoll_coordinator.data.roles.time_column import TIME_NAMES
from atoll_coordinator.data.roles.unit_texts import are_units
from atoll_core.errors import DataError

_BRACKETS: Final = re.compile(r"^\s*[\[(](.*)[\])]\s*$")
_NO_UNIT: Final = frozenset({"-", "–", "1"})
_FORM_OF_DATES: Final = re.compile(
    r"(?:(?:yyyy|yy|dd|mm?)[-./ ]?){2,3}(?:[T ]*(?:[-:. ]?(?:hh?|mm|ss|f+)){2,4})?|hh?:mm(?::ss)?(?:[.,][fs0]+)?",
    re.IGNORECASE,
)
"""How dates and clock times are written, as a row of units may say: dd.mm.yyyy hh:mm."""


@dataclass(frozen=True)
class RawTable:
    """Cells of one file as text: `columns[i]` are the cells under `headers[i]`; `lines` their line numbers, or 0.

    What the format holds as a number is a `NumberCell`.

    `units` are those that a row of their own or the format gives, "" where there is none; `starts` are the rows at
    which trajectories begin; `remarks` say how the file was read; `separator` is what stands between cells, "" where
    the format has none. `left_out` says what of the file is no part of the table, for a warning.
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
    records: Iterable[tuple[int, list[str]]],
    has_row_names: bool = False,
    may_have_commas: bool = False,
) -> RawTable:
    """Return the rows of line numbers and cells; blank records become starts of trajectories, footers are left out.

    `has_row_names` says whether rows may begin with a name for which the header has no cell, `may_have_commas` whether
    more cells than those of the header may come of decimal commas. Raises DataError where a record has more or fewer
    cells than the header, unless the rows tell which columns have no name.
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
    length = footer_length(kept)
    below, lines_below = kept[len(kept) - length :], lines[len(lines) - length :]
    kept, lines = kept[: len(kept) - length], lines[: len(lines) - length]
    headers, kept = _with_unnamed(headers, kept, starts, has_row_names, may_have_commas)
    for line, record in zip(lines, kept, strict=True):
        if len(record) != len(headers):
            count = f"{len(record)} {'cell' if len(record) == 1 else 'cells'}"
            raise DataError(f"line {line} of {file} has {count} where the header has {len(headers)}; correct it")
    columns = [list(column) for column in zip(*kept, strict=True)] or [[] for _ in headers]
    starts = sorted({start for start in starts if start < max(len(lines), 1)})
    left_out = (footer_phrase(lines_below, below),) if below else ()
    return take_units(RawTable(tuple(headers), columns, lines, starts, (), left_out=left_out))


def _with_unnamed(
    headers: list[str], rows: list[list[str]], starts: Sequence[int], has_row_names: bool, may_have_commas: bool
) -> tuple[list[str], list[list[str]]]:
    """Return headers and rows of a header over too few columns: those without a name are the first or the last ones.

    Cells that are empty in all rows are cut off. Names of rows stand first. Elsewhere the names are those of the first
    columns or of the last ones, if only one of both ways makes the time ascend above numbers.
    """
    width = len(rows[0]) if rows else 0
    if width <= len(headers) or any(len(row) != width for row in rows):
        return headers, rows
    while width > len(headers) and not any(row[width - 1].strip() for row in rows):  # separators at the end
        width, rows = width - 1, [row[: width - 1] for row in rows]
    blank = [""] * (width - len(headers))
    if not blank or (has_row_names and len(blank) == 1):
        return [*blank, *headers], rows
    if may_have_commas and not any("." in cell and is_numeral(cell) for row in rows for cell in row):
        return headers, rows
    place = next((place for place, name in enumerate(headers) if split_unit(name)[0] in TIME_NAMES), None)
    if place is None:
        return headers, rows
    columns = [*zip(*rows, strict=True)]
    fitting = [
        named
        for named in ([*headers, *blank], [*blank, *headers])
        if ascends(columns[named.index(headers[place])], starts)
        and not any(name and is_text(cells) for name, cells in zip(named, columns, strict=True))
    ]
    return fitting[0] if len(fitting) == 1 else headers, rows


def take_units(raw: RawTable) -> RawTable:
    """Return `rows` without a first row that holds units in place of numbers; these become the units."""
    if len(raw.lines) < 2 or not is_units_row([column[0] for column in raw.columns], raw.headers):
        return raw
    if not any(is_numeral(column[1]) for column in raw.columns):
        return raw
    place = f"line {raw.lines[0]}" if raw.lines[0] else "the first row"
    return replace(
        raw,
        columns=[column[1:] for column in raw.columns],
        lines=raw.lines[1:],
        starts=sorted({max(start - 1, 0) for start in raw.starts}),
        remarks=(*raw.remarks, f"units in {place}"),
        units=tuple(plain_unit(column[0]) for column in raw.columns),
    )


def is_units_row(cells: Sequence[str], headers: Sequence[str]) -> bool:
    """Tell whether `cells` hold units, or marks that there are none, and not the header once more.

    Beside them may stand how dates are written (yyyy-mm-dd); no cell is a number.
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


def with_breaks(
    headers: Sequence[str], columns: list[list[str]], remarks: tuple[str, ...], units: Sequence[str] = ()
) -> RawTable:
    """Return the rows of a format without lines; those that are missing in every column separate trajectories.

    A footer is left out, as of text.
    """
    count = len(columns[0]) if columns else 0
    blank = [all(is_missing(cell) for cell in row) for row in zip(*columns, strict=True)]
    kept = [row for row in range(count) if not blank[row]]
    length = footer_below(len(kept), lambda place: [column[kept[place]] for column in columns])
    kept, below = kept[: len(kept) - length], kept[len(kept) - length :]
    starts = [0] + [place for place, (row, after) in enumerate(pairwise(kept), start=1) if after != row + 1]
    taken = columns if len(kept) == count else [[column[row] for row in kept] for column in columns]
    rows_below = [[column[row] for column in columns] for row in below]
    left_out = (footer_phrase([row + 1 for row in below], rows_below, "row"),) if below else ()
    return RawTable(tuple(headers), taken, [0] * len(kept), starts, remarks, tuple(units), left_out=left_out)
