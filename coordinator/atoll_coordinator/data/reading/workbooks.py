"""Excel workbooks -> `RawTable`, by openpyxl, an extra: ``pip install 'atoll[xlsx]'``.

The sheet is read that is named, else the first that holds a table, else the one with the most numbers. Rows above the
header whose first cell alone is filled are notes.
"""

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import takewhile
from pathlib import Path
from typing import Any, Final

from atoll_coordinator.data.reading.cells import cell_of, is_missing, is_numeral
from atoll_coordinator.data.reading.dates import is_date
from atoll_coordinator.data.reading.header import Record, take_header
from atoll_coordinator.data.reading.preamble import find_preamble
from atoll_coordinator.data.reading.raw_table import RawTable, table_of_records
from atoll_coordinator.settings import SETTINGS
from atoll_core.errors import DataError, Field, UsageError
from atoll_core.quoting import did_you_mean

ENDINGS: Final = frozenset({".xlsx", ".xlsm"})
"""How the names of workbooks end."""


def read_workbook(path: Path, sheet: str | None = None) -> RawTable:
    """Read the sheet of a workbook that is named, or the first with a table; raises DataError."""
    sheets = _sheets(path)
    if sheet is not None and sheet not in sheets:
        titles = ", ".join(sheets)
        raise DataError(f"there is no sheet '{sheet}' in {path.name}, which has {titles}{did_you_mean(sheet, sheets)}")
    chosen = [sheet] if sheet is not None else [title for title, records in sheets.items() if records]
    tables = {title: table_of_rows(path.name, sheets[title]) for title in chosen if sheets[title]}
    if not tables:
        what = path.name if sheet is None else f"sheet '{sheet}' of {path.name}"
        raise DataError(f"{what} is empty; a header line and rows of numbers are expected")
    title = next((title for title, raw in tables.items() if _is_table(raw)), None)
    title = title or max(tables, key=lambda title: _numbers(tables[title]))
    others = [other for other, records in sheets.items() if other != title and records]
    left_out = (f"other sheets left out: {', '.join(others)}",) if others else ()
    raw = tables[title]
    return replace(raw, remarks=(f"Excel, sheet '{title}'", *raw.remarks), left_out=(*raw.left_out, *left_out))


def check_sheet(files: Sequence[Path], sheet: str | None) -> None:
    """Raise UsageError where a sheet is named, but no file is a workbook."""
    if sheet is not None and not any(file.suffix.lower() in ENDINGS for file in files):
        what = files[0].name if files else "what was given"
        raise UsageError("%s names a sheet of an Excel workbook, but %s is none; leave it out", Field("sheet"), what)


def _sheets(path: Path) -> dict[str, list[Record]]:
    """Return the rows of each sheet, by its title."""
    try:
        import openpyxl
    except ImportError:
        raise DataError(f"reading {path.name} needs openpyxl; run: pip install 'atoll[xlsx]'") from None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of extensions that do not matter here
            book = openpyxl.load_workbook(path, read_only=True, data_only=True)
            try:
                return {sheet.title: [*_records(sheet)] for sheet in book.worksheets}
            finally:
                book.close()
    except OSError:
        raise
    except Exception as error:  # of many kinds, for whatever is broken in there
        raise DataError(f"{path.name} is not an Excel workbook that can be read; save it anew, or as CSV") from error


def table_of_rows(file: str, records: Sequence[Record]) -> RawTable:
    """Return the cells of a sheet, without columns that are empty at its sides, and without notes above the table.

    `records` are its rows, of which one at least is not empty; `file` is for messages, which DataError has.
    """
    used = [place for _, cells in records for place, cell in enumerate(cells) if cell]
    first, last = min(used), max(used) + 1
    cut = [(line, [*cells[first:last], *[""] * (last - max(len(cells), first))]) for line, cells in records]
    preamble = find_preamble([(line, cells) for line, cells in cut if any(cells)])
    if preamble is not None:
        kept = [record for record in cut if record[0] >= preamble.header and record[0] not in preamble.below]
        header, below = take_header(kept)
        raw = header.applied(table_of_records(file, header.names, below))
        return replace(raw, remarks=(*preamble.remarks, *raw.remarks))
    above = len([*takewhile(lambda record: not any(record[1][1:]), cut)])
    above = 0 if above == len(cut) else above
    header, below = take_header(cut[above:])
    raw = header.applied(table_of_records(file, header.names, below))
    notes = sum(bool(cells[0]) for _, cells in cut[:above])
    counted = f"{notes} {'row' if notes == 1 else 'rows'} of notes left out"
    return replace(raw, remarks=(counted, *raw.remarks)) if notes else raw


def _is_table(raw: RawTable) -> bool:
    """Tell whether a sheet has enough rows for a search, with numbers or dates, and nothing else, in two columns."""
    filled = [[cell for cell in column if not is_missing(cell)] for column in raw.columns]
    columns = [cells for cells in filled if cells and all(is_numeral(cell) or is_date(cell) for cell in cells)]
    return len(raw.lines) >= SETTINGS.checks.min_rows and len(columns) > 1


def _numbers(raw: RawTable) -> int:
    """Return how many numbers a sheet holds."""
    return sum(is_numeral(cell) for column in raw.columns for cell in column)


def _records(sheet: Any) -> Iterator[Record]:
    """Yield the rows from the first that is not empty to the last."""
    waiting: list[Record] = []
    for line, row in enumerate(sheet.iter_rows(values_only=True), start=1):
        waiting.append((line, [cell_of(value) for value in row]))
        if any(waiting[-1][1]):
            yield from waiting if len(waiting) < line else waiting[-1:]
            waiting = []
