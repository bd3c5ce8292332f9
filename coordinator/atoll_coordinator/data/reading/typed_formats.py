"""Formats whose cells have types -> `RawTable`: Excel workbooks, JSON and Parquet files.

Excel is read by openpyxl (``pip install 'atoll[xlsx]'``), Parquet by polars (``pip install 'atoll[parquet]'``). JSON
holds a list of records, one record per line, or columns by name, as pandas and polars write them.
"""

import json
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from atoll_coordinator.data.reading.cells import cell_of, is_missing, is_numeral
from atoll_coordinator.data.reading.dates import is_date
from atoll_coordinator.data.reading.raw_table import RawTable, Record, table_of_records, take_header, with_breaks
from atoll_coordinator.data.reading.text import decode, find_preamble
from atoll_coordinator.settings import SETTINGS
from atoll_core.errors import DataError, Field, UsageError
from atoll_core.quoting import did_you_mean

if TYPE_CHECKING:
    import polars

WORKBOOKS: Final = frozenset({".xlsx", ".xlsm"})
"""Endings of the names of workbooks."""
_EXPECTED: Final = 'a list of records such as [{"t": 0, "x": 1}] is expected'

# ---------------------------------------------------------------------------------------------------------- workbooks


def check_sheet(files: Sequence[Path], sheet: str | None) -> None:
    """Raise UsageError if options name a sheet, but no file is a workbook."""
    if sheet is not None and not any(file.suffix.lower() in WORKBOOKS for file in files):
        what = files[0].name if files else "the input"
        raise UsageError(
            "%s names a sheet of an Excel workbook, but %s is not a workbook; leave the option out",
            Field("sheet"),
            what,
        )


def read_workbook(path: Path, sheet: str | None = None) -> RawTable:
    """Read the sheet that options name, else the first sheet with a table, else the sheet with the most numbers.

    Raises DataError.
    """
    sheets = _sheets(path)
    if sheet is not None and sheet not in sheets:
        titles = ", ".join(sheets)
        raise DataError(f"there is no sheet '{sheet}' in {path.name}, which has {titles}{did_you_mean(sheet, sheets)}")
    chosen = [sheet] if sheet is not None else [*sheets]
    tables = {title: table_of_rows(path.name, sheets[title]) for title in chosen if sheets[title]}
    if not tables:
        what = path.name if sheet is None else f"sheet '{sheet}' of {path.name}"
        raise DataError(f"{what} is empty; a header line and rows of numbers are expected")
    title = next((title for title, raw in tables.items() if _is_table(raw)), None)
    title = title or max(
        tables, key=lambda title: sum(is_numeral(cell) for cells in tables[title].columns for cell in cells)
    )
    others = [other for other, records in sheets.items() if other != title and records]
    left_out = (f"other sheets left out: {', '.join(others)}",) if others else ()
    raw = tables[title]
    return replace(raw, remarks=(f"Excel, sheet '{title}'", *raw.remarks), left_out=(*raw.left_out, *left_out))


def _sheets(path: Path) -> dict[str, list[Record]]:
    try:
        import openpyxl
    except ImportError:
        raise DataError(f"reading {path.name} needs openpyxl; run: pip install 'atoll[xlsx]'") from None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # warnings about extensions, which do not matter here
            book = openpyxl.load_workbook(path, read_only=True, data_only=True)
            try:
                return {sheet.title: [*_records(sheet)] for sheet in book.worksheets}
            finally:
                book.close()
    except OSError:
        raise
    except Exception as error:  # damaged files raise many kinds of errors
        raise DataError(f"{path.name} cannot be read as an Excel workbook; save the file again, or as CSV") from error


def _records(sheet: Any) -> Iterator[Record]:
    """Yield the rows from the first that is not empty to the last."""
    waiting: list[Record] = []
    for line, row in enumerate(sheet.iter_rows(values_only=True), start=1):
        waiting.append((line, [cell_of(value) for value in row]))
        if any(waiting[-1][1]):
            yield from waiting if len(waiting) < line else waiting[-1:]
            waiting = []


def table_of_rows(file: str, records: Sequence[Record]) -> RawTable:
    """Return the cells of a sheet without empty columns at both sides and without notes above the table.

    `records` are its rows, at least one of them not empty; `file` is for messages. Rows above the header with only the
    first cell filled are notes. Raises DataError.
    """
    used = [place for _, cells in records for place, cell in enumerate(cells) if cell]
    first, last = min(used), max(used) + 1
    cut = [(line, [*cells[first:last], *[""] * (last - max(len(cells), first))]) for line, cells in records]
    preamble = find_preamble([(line, cells) for line, cells in cut if any(cells)])
    if preamble is not None:
        rows = [record for record in cut if record[0] >= preamble.header and record[0] not in preamble.below]
        remarks = preamble.remarks
    else:
        above = len([*takewhile(lambda record: not any(record[1][1:]), cut)])
        above = 0 if above == len(cut) else above
        rows, notes = cut[above:], sum(bool(cells[0]) for _, cells in cut[:above])
        remarks = (f"{notes} {'row' if notes == 1 else 'rows'} of notes left out",) if notes else ()
    header, below = take_header(rows)
    raw = header.applied(table_of_records(file, header.names, below))
    return replace(raw, remarks=(*remarks, *raw.remarks))


def _is_table(raw: RawTable) -> bool:
    """Tell whether a sheet has enough rows for a search, and two columns with only numbers or dates."""
    filled = [[cell for cell in column if not is_missing(cell)] for column in raw.columns]
    columns = [cells for cells in filled if cells and all(is_numeral(cell) or is_date(cell) for cell in cells)]
    return len(raw.lines) >= SETTINGS.common.fewest_rows and len(columns) > 1


# --------------------------------------------------------------------------------------------------------------- JSON


def read_records(path: Path) -> RawTable:
    """Read a JSON file; raises DataError."""
    text, _ = decode(path.name, path.read_bytes())
    if not text.strip():
        raise DataError(f"{path.name} is empty; {_EXPECTED}")
    return table_of_document(path.name, *_parsed(path.name, text))


def _parsed(name: str, text: str) -> tuple[Any, str]:
    try:
        return json.loads(text), "JSON"
    except (ValueError, RecursionError) as error:
        whole = error
    lines = [(number, line) for number, line in enumerate(text.splitlines(), start=1) if line.strip()]
    if len(lines) < 2 or not lines[0][1].strip().endswith("}"):
        where = ""
        if isinstance(whole, json.JSONDecodeError):
            where = f" from line {whole.lineno}, column {whole.colno} on"
        raise DataError(f"{name} is not valid JSON{where}; {_EXPECTED}") from whole
    records = []
    for number, line in lines:
        try:
            records.append(json.loads(line))
        except (ValueError, RecursionError) as error:
            raise DataError(f"line {number} of {name} is not valid JSON; one record per line is expected") from error
    return records, "JSON lines"


def table_of_document(name: str, document: object, remark: str) -> RawTable:
    """Return the table of records, or of columns by name; `name` is for messages. Raises DataError."""
    headers, columns = _columns(name, document)
    for header, column in zip(headers, columns, strict=True):
        if any(isinstance(value, (list, dict)) for value in column):
            raise DataError(f"column '{header}' of {name} holds lists or objects; write one number into each cell")
    return with_breaks(headers, [[*map(cell_of, column)] for column in columns], (remark,))


def _columns(name: str, document: Any) -> tuple[list[str], list[Sequence[Any]]]:
    if isinstance(document, Mapping) and {"columns", "data"} <= set(document):  # pandas: orient="split"
        document = [dict(zip(document["columns"], row, strict=False)) for row in document["data"]]
    elif isinstance(document, Mapping) and {"schema", "data"} <= set(document):  # pandas: orient="table"
        document = document["data"]
    if isinstance(document, Mapping):
        columns: list[Sequence[Any]] = [
            [*values.values()] if isinstance(values, Mapping) else values for values in document.values()
        ]
        lengths = {len(column) if isinstance(column, list) else 0 for column in columns}
        if len(lengths) != 1 or lengths == {0}:
            raise DataError(f"{name} holds an object whose values are not columns of equal length; {_EXPECTED}")
        return [str(key) for key in document], columns
    if not isinstance(document, list) or not document or not all(isinstance(record, Mapping) for record in document):
        raise DataError(f"{name} holds no records; {_EXPECTED}")
    headers = list(dict.fromkeys(str(key) for record in document for key in record))
    return headers, [[record.get(header) for record in document] for header in headers]


# ------------------------------------------------------------------------------------------------------------ Parquet


def read_parquet(path: Path) -> RawTable:
    """Read a Parquet file; raises DataError."""
    try:
        import polars
    except ImportError:
        raise DataError(f"reading {path.name} needs polars; run: pip install 'atoll[parquet]'") from None
    try:
        frame = polars.read_parquet(path)
    except (polars.exceptions.PolarsError, polars.exceptions.PanicException) as error:
        raise DataError(f"{path.name} cannot be read as a Parquet file; save the file again, or as CSV") from error
    columns, units = [], []
    for series in frame.get_columns():
        if series.dtype.is_nested():
            raise DataError(
                f"column '{series.name}' of {path.name} holds lists or structures; write one number into each cell"
            )
        columns.append([cell_of(value) for value in _plain_series(series)])
        units.append("s" if isinstance(series.dtype, polars.Duration) else "")
    return with_breaks(frame.columns, columns, ("Parquet",), units)


def _plain_series(series: "polars.Series") -> "polars.Series":
    """Return numbers as floats, durations in seconds, and dates and everything else as texts."""
    import polars

    kind = series.dtype
    if isinstance(kind, polars.Duration):
        return series.dt.total_nanoseconds() / 1e9
    if isinstance(kind, polars.Datetime) and kind.time_zone is not None:
        return series.dt.convert_time_zone("UTC").dt.to_string("%F %T%.fZ")
    if isinstance(kind, polars.Datetime):
        return series.dt.to_string("%F %T%.f")
    is_number = kind.is_numeric() or isinstance(kind, polars.Boolean)
    return series.cast(polars.Float64) if is_number else series.cast(polars.String, strict=False)
