"""Reads measurement files into a `Table`, on the client's side. Nothing is interpreted beyond numbers and breaks.

CSV and TSV are read here, line by line, because messages name lines; Parquet by polars; NPZ by numpy. A header cell
``name [unit]`` gives name and unit. Blank rows and the ends of files separate trajectories.
"""

import csv
import math
import re
import textwrap
import zipfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np

from atoll.config import DataConfig
from atoll.data.dataset import FloatArray
from atoll.data.table import Table
from atoll.errors import DataError
from atoll_coordinator.data.roles.options import find_trajectory_column, named_columns, split_unit, strip_units

MISSING: Final = frozenset({"", "na", "n/a", "#n/a", "nan", "-nan", "+nan", "null", "none"})
"""Cells, in lower case, that stand for a missing number."""

_LINE: Final = re.compile(r"[^\r\n]*(?:\r\n|\r|\n)|[^\r\n]+")
_DECIMAL_COMMA = re.compile(r"^(\s*[+-]?\d*),(\d+(?:[eE][+-]?\d+)?\s*)$")


@dataclass(frozen=True)
class _Rows:
    """Cells of one file as text: `columns[i]` are the cells under `headers[i]`; `lines` their line numbers, or 0."""

    headers: tuple[str, ...]
    columns: list[list[str]]
    lines: list[int]
    starts: list[int]


def read_table(paths: Sequence[Path], config: DataConfig) -> Table:
    """Read `paths` in order as one table; raises DataError with one sentence about what cannot be read.

    A column that holds text in every cell is set aside; text among numbers is refused, and so is text in a column that
    `config` names. The trajectory column alone may hold names, which are then numbered.
    """
    if not paths:
        raise DataError("no data file was given; name at least one CSV, TSV or Parquet file")
    return _joined([_read_file(path, config) for path in paths])


def _read_file(path: Path, config: DataConfig) -> Table:
    if not path.exists():
        raise DataError(f"there is no file {path}; check its name and the folder you are in")
    if path.is_dir():
        raise DataError(f"{path} is a folder; name the files in it that hold the measurements")
    try:
        if path.suffix.lower() in {".parquet", ".pq"}:
            return _table_of(path.name, _parquet_rows(path), config)
        if path.suffix.lower() == ".npz":
            return _table_of(path.name, _npz_rows(path), config)
        return _table_of(path.name, _text_rows(path), config)
    except OSError as error:
        raise DataError(f"{path} cannot be read: {error.strerror or error}") from error


def _text_rows(path: Path) -> _Rows:
    """Split a CSV or TSV file into cells; blank rows become starts of trajectories."""
    text = _decoded(path)
    if not text.strip():
        raise DataError(f"{path.name} is empty; a header line and rows of numbers are expected")
    records = _records(path.name, text)
    _, headers = next(records)
    headers = [_on_one_line(header) for header in headers]
    _check_header(path.name, headers)
    columns: list[list[str]] = [[] for _ in headers]
    lines: list[int] = []
    starts = [0]
    for line, record in records:
        if not any(cell.strip() for cell in record):
            starts.append(len(lines))
            continue
        if len(record) != len(headers):
            found = f"{len(record)} {'cell' if len(record) == 1 else 'cells'}"
            raise DataError(f"line {line} of {path.name} has {found} where the header has {len(headers)}; correct it")
        for column, cell in zip(columns, record, strict=True):
            column.append(cell)
        lines.append(line)
    return _Rows(tuple(headers), columns, lines, sorted({start for start in starts if start < max(len(lines), 1)}))


def _decoded(path: Path) -> str:
    data = path.read_bytes()
    encoding = "utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
    try:
        return data.decode(encoding)
    except UnicodeDecodeError as error:
        place = f"byte {error.start + 1}"
        raise DataError(f"{path.name} is not UTF-8 text ({place}); save it as CSV in UTF-8, or as Parquet") from error


def _records(name: str, text: str) -> Iterator[tuple[int, list[str]]]:
    """Yield line number and cells of each record, blank lines included, from the header on.

    Where commas do not separate cells they may be decimal ones.
    """
    lead = len(text) - len(text.lstrip("\r\n"))
    skipped = text[:lead].replace("\r\n", "\n").count("\n")
    delimiter = _delimiter(text[lead:])
    # a StringIO would take four bytes for each character
    lines = (line[0] for line in _LINE.finditer(text, lead))
    reader = csv.reader(lines, delimiter=delimiter, skipinitialspace=True)
    before = 0
    try:
        for record in reader:
            cells = record if delimiter == "," else [_DECIMAL_COMMA.sub(r"\1.\2", cell) for cell in record]
            yield skipped + before + 1, cells
            before = reader.line_num
    except csv.Error as error:
        raise DataError(f"line {reader.line_num} of {name} cannot be split into cells: {error}") from error


def _delimiter(text: str) -> str:
    """Return tab, semicolon or comma, whichever the header uses outside of quotes and units."""
    header = re.sub(r'"[^"]*"|\[[^\]]*\]', "", text.split("\n", 1)[0])
    return next((each for each in "\t;," if each in header), ",")


def _check_header(name: str, headers: Sequence[str]) -> None:
    if all(header and _number(header) is not None for header in headers):
        raise DataError(f"the first line of {name} holds numbers only; a header with column names is expected there")
    if len(headers) == 1 and len(headers[0].split()) > 1:
        raise DataError(f"{name} has one column, '{headers[0]}'; separate columns with commas, semicolons or tabs")


def _parquet_rows(path: Path) -> _Rows:
    import polars  # slow to load and rarely needed

    try:
        frame = polars.read_parquet(path)
    except polars.exceptions.PolarsError as error:
        raise DataError(f"{path.name} is not a Parquet file that can be read: {error}") from error
    columns = []
    for series in frame.get_columns():
        if series.dtype.is_temporal():
            raise DataError(f"column '{series.name}' of {path.name} holds dates or times; convert it to numbers first")
        if series.dtype.is_nested():
            raise DataError(f"column '{series.name}' of {path.name} holds lists or structures; write one number a cell")
        plain = series.cast(polars.Float64) if series.dtype.is_numeric() else series.cast(polars.String, strict=False)
        columns.append(["" if value is None else str(value) for value in plain.to_list()])
    return _with_breaks(tuple(frame.columns), columns)


def _npz_rows(path: Path) -> _Rows:
    try:
        zipfile.ZipFile(path).close()  # whatever is none is found out here: np.load would leave it open
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: np.asarray(archive[name]) for name in archive.files}
    except (ValueError, EOFError, zipfile.BadZipFile) as error:
        raise DataError(f"{path.name} is not an NPZ file of plain arrays; write one with numpy.savez") from error
    lengths = {array.shape for array in arrays.values()}
    if len(lengths) != 1 or len(next(iter(lengths))) != 1:
        raise DataError(f"{path.name} holds arrays of shapes {sorted(lengths)}; one-dimensional ones of one length fit")
    return _with_breaks(tuple(arrays), [[str(value) for value in array.tolist()] for array in arrays.values()])


def _with_breaks(headers: tuple[str, ...], columns: list[list[str]]) -> _Rows:
    """Take out the rows of a file without lines that are missing in every column: they separate trajectories."""
    rows = len(columns[0]) if columns else 0
    blank = [all(cell.strip().lower() in MISSING for cell in row) for row in zip(*columns, strict=True)]
    kept = [row for row in range(rows) if not blank[row]]
    starts = [0] + [place for place, (row, after) in enumerate(pairwise(kept), start=1) if after != row + 1]
    return _Rows(headers, [[column[row] for row in kept] for column in columns], [0] * len(kept), starts)


def _table_of(file: str, rows: _Rows, config: DataConfig) -> Table:
    """Turn cells into numbers; a column without a name (such as a table's row numbers) is set aside, by its place."""
    named = [
        (split_unit(_on_one_line(header)), cells)
        for header, cells in zip(rows.headers, rows.columns, strict=True)
        if header
    ]
    names = [name for (name, _), _ in named]
    for name in names:
        if names.count(name) > 1:
            raise DataError(f"{file} has {names.count(name)} columns named '{name}'; give each column its own name")
    if not rows.lines:
        raise DataError(f"{file} has a header but no rows; rows of numbers are expected below it")
    config = strip_units(config, names)
    needed, trajectory = named_columns(config), find_trajectory_column(names, config)
    kept: list[tuple[str, str, FloatArray]] = []
    places = enumerate(zip(rows.headers, rows.columns, strict=True), start=1)
    skipped = [f"column {place}" for place, (header, cells) in places if not header and any(map(str.strip, cells))]
    for (name, unit), cells in named:
        if _is_text(cells) and name != trajectory and name not in needed:
            skipped.append(name)
            continue
        names_runs = name == trajectory and _is_text(cells)
        numbers = _numbered(cells) if names_runs else _numbers(file, name, cells, rows.lines)
        kept.append((name, unit, np.array(numbers, dtype=np.float64)))
    count = len(rows.lines)
    columns = np.array([numbers for _, _, numbers in kept], dtype=np.float64).reshape(len(kept), count)
    return Table(
        tuple(name for name, _, _ in kept),
        tuple(unit for _, unit, _ in kept),
        columns,
        tuple(rows.starts),
        (file,),
        np.zeros(count, dtype=np.int64),
        np.array(rows.lines, dtype=np.int64),
        tuple(skipped),
    )


def _on_one_line(text: str) -> str:
    return " ".join(text.split())


def _number(cell: str) -> float | None:
    """Return the number in `cell` (NaN when missing), or None for text."""
    if cell.strip().lower() in MISSING:
        return math.nan
    try:
        return float(cell)
    except ValueError:
        return None


def _is_text(cells: Sequence[str]) -> bool:
    """Say whether no cell holds a number and at least one holds text."""
    present = [cell for cell in cells if cell.strip().lower() not in MISSING]
    return bool(present) and all(_number(cell) is None for cell in present)


def _numbers(file: str, name: str, cells: Sequence[str], lines: Sequence[int]) -> list[float]:
    """Convert the cells of a column; raises DataError naming the first cell that is no number."""
    try:
        return [float(cell) for cell in cells]
    except ValueError:
        pass
    numbers = []
    for cell, line, row in zip(cells, lines, range(1, len(cells) + 1), strict=True):
        number = _number(cell)
        if number is None:
            place = f"line {line}" if line else f"row {row}"
            found = textwrap.shorten(_on_one_line(cell), 40, placeholder="…")
            raise DataError(f"column '{name}' of {file} holds '{found}' in {place} where a number is expected")
        numbers.append(number)
    return numbers


def _numbered(cells: Sequence[str]) -> list[float]:
    """Number the different texts of a trajectory column by first appearance."""
    numbers: dict[str, float] = {}
    return [numbers.setdefault(cell.strip(), float(len(numbers) + 1)) for cell in cells]


def _joined(tables: Sequence[Table]) -> Table:
    """Put the rows of several files below each other; raises DataError when their columns differ."""
    first = tables[0]
    if len(tables) == 1:
        return first
    ordered = [_in_order(table, first) for table in tables]
    starts: list[int] = []
    before = 0
    for table in ordered:
        starts += [before + start for start in table.starts]
        before += table.rows
    return replace(
        first,
        columns=np.ascontiguousarray(np.concatenate([table.columns for table in ordered], axis=1)),
        starts=tuple(starts),
        files=tuple(table.files[0] for table in ordered),
        file_of_row=np.repeat(np.arange(len(ordered), dtype=np.int64), [table.rows for table in ordered]),
        line_of_row=np.concatenate([table.line_of_row for table in ordered]),
    )


def _in_order(table: Table, first: Table) -> Table:
    """Return `table` with its columns in the order of `first`."""
    if set(table.names) != set(first.names):
        different = ", ".join(sorted(set(table.names) ^ set(first.names)))
        pair = f"{first.files[0]} and {table.files[0]}"
        raise DataError(f"{pair} differ in the columns {different}; files read together need the same columns")
    order = [table.names.index(name) for name in first.names]
    units = tuple(table.units[index] for index in order)
    if units != first.units:
        pair = f"{first.files[0]} and {table.files[0]}"
        raise DataError(f"{pair} differ in the units of their columns; convert one of them")
    return replace(table, names=first.names, units=units, columns=np.ascontiguousarray(table.columns[order]))
