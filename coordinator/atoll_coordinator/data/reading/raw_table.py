"""What is read from one file, before cells are numbers: `RawTable`. Pure."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

from atoll_coordinator.data.reading.cells import is_missing, is_numeral, on_one_line
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
) -> RawTable:
    """Return the rows of line numbers and cells; blank records become starts of trajectories.

    `has_row_names` says whether rows may begin with a name for which the header has no cell. Raises DataError where a
    record has more or fewer cells than the header.
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
    if kept and all(len(record) == len(headers) + 1 for record in kept):
        if not any(record[-1].strip() for record in kept):  # a separator at the end
            kept = [record[:-1] for record in kept]
        elif has_row_names:
            headers = ["", *headers]
    for line, record in zip(lines, kept, strict=True):
        if len(record) != len(headers):
            count = f"{len(record)} {'cell' if len(record) == 1 else 'cells'}"
            raise DataError(f"line {line} of {file} has {count} where the header has {len(headers)}; correct it")
    columns = [list(column) for column in zip(*kept, strict=True)] or [[] for _ in headers]
    starts = sorted({start for start in starts if start < max(len(lines), 1)})
    return take_units(RawTable(tuple(headers), columns, lines, starts, ()))


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
    """Return the rows of a format without lines; those that are missing in every column separate trajectories."""
    count = len(columns[0]) if columns else 0
    blank = [all(is_missing(cell) for cell in row) for row in zip(*columns, strict=True)]
    kept = [row for row in range(count) if not blank[row]]
    starts = [0] + [place for place, (row, after) in enumerate(pairwise(kept), start=1) if after != row + 1]
    taken = columns if len(kept) == count else [[column[row] for row in kept] for column in columns]
    return RawTable(tuple(headers), taken, [0] * len(kept), starts, remarks, tuple(units))
