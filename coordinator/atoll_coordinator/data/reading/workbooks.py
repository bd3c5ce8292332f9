"""Excel workbooks -> `RawTable`, by openpyxl, an extra: ``pip install 'atoll[xlsx]'``.

The first sheet that is not empty is read, from its first row that is not.
"""

import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from atoll_coordinator.data.reading.cells import cell_of
from atoll_coordinator.data.reading.raw_table import RawTable, table_of_records
from atoll_core.errors import DataError

_Record = tuple[int, list[str]]


def read_workbook(path: Path) -> RawTable:
    """Read a workbook; raises DataError."""
    try:
        import openpyxl
    except ImportError:
        raise DataError(f"reading {path.name} needs openpyxl; run: pip install 'atoll[xlsx]'") from None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of extensions that do not matter here
            book = openpyxl.load_workbook(path, read_only=True, data_only=True)
            try:
                sheets = [(sheet.title, [*_records(sheet)]) for sheet in book.worksheets]
            finally:
                book.close()
    except OSError:
        raise
    except Exception as error:  # of many kinds, for whatever is broken in there
        raise DataError(f"{path.name} is not an Excel workbook that can be read; save it anew, or as CSV") from error
    filled = {title: records for title, records in sheets if records}
    if not filled:
        raise DataError(f"{path.name} is empty; a header line and rows of numbers are expected")
    title, *others = filled
    records = filled[title]
    remarks = (f"Excel, sheet '{title}'", *([f"other sheets left out: {', '.join(others)}"] if others else []))
    used = [place for _, cells in records for place, cell in enumerate(cells) if cell]
    first, last = min(used), max(used) + 1
    cut = [(line, [*cells[first:last], *[""] * (last - max(len(cells), first))]) for line, cells in records]
    raw = table_of_records(path.name, cut[0][1], cut[1:])
    return replace(raw, remarks=(*remarks, *raw.remarks))


def _records(sheet: Any) -> Iterator[_Record]:
    """Yield the rows from the first that is not empty to the last."""
    waiting: list[_Record] = []
    for line, row in enumerate(sheet.iter_rows(values_only=True), start=1):
        waiting.append((line, [cell_of(value) for value in row]))
        if any(waiting[-1][1]):
            yield from waiting if len(waiting) < line else waiting[-1:]
            waiting = []
