"""Measurement files -> `Table`, on the client's side: read by format, turned into columns, then joined.

1. The ending of a file's name gives its format; a file with an unknown ending is read as text. -> `RawTable` of text
   cells.
2. `convert_columns` converts cells into numbers and dates, and leaves out text columns. -> `FileColumns`.
3. `table_of_parts` puts the rows of all files below each other, without empty columns, with the times of ``--step``.

Blank rows and the ends of files separate trajectories. `Table.read_as` says how everything was read.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import accumulate
from pathlib import Path
from typing import Final, cast

import numpy as np

from atoll_coordinator.data.reading.arrays import read_hdf5, read_matlab, read_npy, read_npz
from atoll_coordinator.data.reading.cells import (
    is_missing,
    is_text,
    on_one_line,
    parse_numbers,
    place,
    shortened,
    visible,
)
from atoll_coordinator.data.reading.dates import (
    STAMPS,
    Dates,
    compact_dates,
    is_date,
    read_date_columns,
    split_origin,
    time_stamps,
    times_of,
)
from atoll_coordinator.data.reading.raw_table import RawTable
from atoll_coordinator.data.reading.reshaping import TIME, reshaped
from atoll_coordinator.data.reading.text import read_text
from atoll_coordinator.data.reading.typed_formats import WORKBOOKS, read_parquet, read_records, read_workbook
from atoll_coordinator.data.roles.names_and_options import (
    TIME_NAMES,
    find_time_column,
    find_trajectory_column,
    named_columns,
    split_unit,
    strip_units,
)
from atoll_coordinator.data.roles.roles import assign_roles_by_name
from atoll_core.config import DataConfig
from atoll_core.data.dataset import FloatArray
from atoll_core.data.table import MANY, Origin, Table
from atoll_core.errors import DataError, Field, UsageError

_REFUSED: Final = {
    ".xls": "an Excel workbook of the old format; save it as .xlsx or CSV",
    ".ods": "an OpenDocument spreadsheet; save it as .xlsx or CSV",
    ".pkl": "a pickle, which may hold programs; write CSV or Parquet",
}


@dataclass(frozen=True)
class FileColumns:
    """The columns of one file by name, each with its unit.

    `skipped` are the text columns, `remarks` say how the file was read. `labels` are the texts of a column of
    trajectories or groups; the column has the number of each text, from 1. `left_out` names other parts of the file
    that were not read.
    """

    file: str
    values: Mapping[str, FloatArray | Dates]
    units: Mapping[str, str]
    lines: Sequence[int]
    starts: Sequence[int]
    skipped: tuple[str, ...]
    remarks: tuple[str, ...]
    labels: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()


def read_table(paths: Sequence[Path], config: DataConfig, time_units: Mapping[str, str] | None = None) -> Table:
    """Read `paths` in order as one table; raises DataError with one sentence about the part that cannot be read.

    `time_units` and the units of `config` give the unit in which the dates of a column are counted. Without a unit, the
    steps between dates decide.
    """
    if not paths:
        raise DataError("no data file was given; name at least one, such as a CSV file")
    parts = []
    for path in paths:
        if not path.exists():
            raise DataError(f"there is no file {path}; check its name and the folder you are in")
        if path.is_dir():
            raise DataError(f"{path} is a folder; name the files in it that hold the measurements")
        try:
            parts.append(convert_columns(path.name, _raw_table(path, config), config))
        except OSError as error:
            raise DataError(f"{path} cannot be read: {error.strerror or error}") from error
    return table_of_parts(parts, config, time_units)


def _raw_table(path: Path, config: DataConfig) -> RawTable:
    match path.suffix.lower():
        case ".parquet" | ".pq":
            return read_parquet(path)
        case ".npz":
            return read_npz(path, config)
        case ".npy":
            return read_npy(path, config)
        case ".mat":
            return read_matlab(path, config)
        case ".h5" | ".hdf5" | ".hdf" | ".nc":
            return read_hdf5(path, config)
        case suffix if suffix in WORKBOOKS:
            return read_workbook(path, config.sheet)
        case ".json" | ".jsonl" | ".ndjson":
            return read_records(path)
        case suffix if suffix in _REFUSED:
            raise DataError(f"{path.name} is {_REFUSED[suffix]}")
        case _:
            return read_text(path.name, path.read_bytes())


# ------------------------------------------------------------------------------------------- the columns of one file


def convert_columns(file: str, raw: RawTable, config: DataConfig) -> FileColumns:
    """Convert cells into numbers and dates; raises DataError if columns share a name, or if a cell cannot be read.

    A column with text in every cell is left out unless `config` names it. Only the columns of trajectories and of
    groups may hold names, which are then numbered. `read_date_columns` decides which columns hold dates. A column
    without a name (such as row numbers) is also left out; messages call it by its position.
    """
    raw = reshaped(file, _with_named_index(raw), config)
    stated, cells = _units_and_cells(file, raw)
    split = {name: split_origin(unit) for name, unit in stated.items()}
    units = {name: unit for name, (unit, _) in split.items()}
    since = tuple(f"{name}: in {unit} since {origin}" for name, (unit, origin) in split.items() if origin)
    names = [*cells]
    config = strip_units(config, names)
    needed, trajectory = named_columns(config), find_trajectory_column(names, config)
    texts = {name: column for name, column in cells.items() if is_text(column)}
    labels: dict[str, tuple[str, ...]] = {}
    runs: dict[str, FloatArray] = {}
    for name in dict.fromkeys((trajectory, config.group)):
        if name in texts:
            labelled = [visible(cell.strip()) for cell in texts.pop(name)]
            labels[name] = tuple(dict.fromkeys(labelled))
            numbers = {label: float(number) for number, label in enumerate(labels[name], start=1)}
            runs[name] = np.array([numbers[label] for label in labelled], dtype=np.float64)
    unlabelled = {name: column for name, column in cells.items() if name not in (trajectory, *labels)}
    stamps = time_stamps(unlabelled, units, config)
    texts |= compact_dates(unlabelled, config) | stamps
    dates = read_date_columns(file, texts, names, raw.starts, raw.lines, config)
    read_dates = {
        name: replace(column, form=STAMPS) if name in stamps else column for name, column in dates.values.items()
    }
    plain = {
        name: column
        for name, column in cells.items()
        if name not in runs and name not in dates.values and (name not in texts or name in needed)
    }
    kept = {*runs, *dates.values, *plain}
    new_names = {name: dates.renamed.get(name, name) for name in names if name in kept}
    if texts and not assign_roles_by_name([*new_names.values()], config, trajectory).equations:
        raise _no_numbers_error(file, {name: cells[name] for name in texts if name not in dates.values}, raw.lines)
    read_columns, remarks = parse_numbers(file, plain, raw.lines, raw.separator)
    read = cast(dict[str, FloatArray | Dates], {**runs, **read_dates, **read_columns})
    columns = enumerate(zip(raw.headers, raw.columns, strict=True), start=1)
    unnamed = [f"column {number}" for number, (header, column) in columns if not header and any(map(str.strip, column))]
    skipped = (*unnamed, *(name for name in texts if name not in read and name != dates.absorbed))
    renamed = (f"column '{old}' is the {new}" for old, new in dates.renamed.items())
    left_out = (f"text left out: {', '.join(skipped)}",) if skipped else ()
    return FileColumns(
        file,
        {new: read[name] for name, new in new_names.items()},
        {new: units[name] for name, new in new_names.items()},
        raw.lines,
        raw.starts,
        skipped,
        (*raw.remarks, *remarks, *renamed, *since, *raw.left_out, *left_out),
        labels,
        raw.left_out,
    )


def _with_named_index(raw: RawTable) -> RawTable:
    """Give a name to an unnamed first column of dates, such as an index of pandas, so that it can be the time."""
    if raw.headers[:1] != ("",) or TIME in raw.headers or not raw.lines:
        return raw
    first = next((cell for cell in raw.columns[0] if not is_missing(cell)), "")
    return replace(raw, headers=(TIME, *raw.headers[1:])) if is_date(first) else raw


def _units_and_cells(file: str, raw: RawTable) -> tuple[dict[str, str], dict[str, list[str]]]:
    units: dict[str, str] = {}
    named: dict[str, list[str]] = {}
    counts = Counter(split_unit(on_one_line(header))[0] for header in raw.headers if header)
    units_below = raw.units or ("",) * len(raw.headers)
    for header, unit_below, cells in zip(raw.headers, units_below, raw.columns, strict=True):
        if header:
            name, unit = split_unit(on_one_line(header))
            if counts[name] > 1:
                raise DataError(f"{file} has {counts[name]} columns named '{name}'; give each column its own name")
            units[name], named[name] = unit or unit_below, cells
    if not raw.lines:
        raise DataError(f"{file} has a header but no rows; rows of numbers are expected below it")
    return units, named


def _no_numbers_error(file: str, texts: Mapping[str, Sequence[str]], lines: Sequence[int]) -> DataError:
    examples = []
    for name, cells in [*texts.items()][:MANY]:
        row = next(row for row, cell in enumerate(cells) if not is_missing(cell))
        examples.append(f"'{name}' holds '{shortened(cells[row], 40)}' in {place(lines, row)}")
    more = ", …" if len(texts) > MANY else ""
    advice = "write only numbers into cells, and their unit into the header, as x [%]"
    return DataError(f"no column of numbers is left in {file}: {', '.join(examples)}{more}; {advice}")


# ------------------------------------------------------------------------------------------------- all files, joined


def table_of_parts(
    parts: Sequence[FileColumns], config: DataConfig, time_units: Mapping[str, str] | None = None
) -> Table:
    """Return the columns of files, or of Python objects, as one table; raises DataError.

    `time_units` is as in `read_table`.
    """
    group = strip_units(config, parts[0].values).group
    table = _joined(parts, {**config.units, **(time_units or {})}, group)
    config = strip_units(config, table.names)
    return _with_even_times(_without_empty(table, config), config)


def _joined(files: Sequence[FileColumns], time_units: Mapping[str, str], group: str | None) -> Table:
    """Append the rows of all files; raises DataError if their columns differ.

    The column `group` must hold texts in all files or in no file.
    """
    for other in files[1:]:
        _check_alike(files[0], other)
    files, labels = _with_common_labels(files, group)
    first = files[0]
    counts = [len(file.lines) for file in files]
    before = [0, *accumulate(counts[:-1])]
    starts = tuple(start + rows for file, rows in zip(files, before, strict=True) for start in file.starts)
    columns: list[FloatArray] = []
    origins: dict[str, Origin] = {}
    units = dict(first.units)
    remarks = ["; ".join(first.remarks)]
    if any(file.remarks != first.remarks for file in files):
        remarks = [f"{file.file}: {', '.join(file.remarks)}" for file in files]
    for name in first.values:
        parts = [file.values[name] for file in files]
        dates = [part for part in parts if isinstance(part, Dates)]
        if dates:
            values, units[name], remark, origins[name] = times_of(dates, starts, time_units.get(name))
            remarks.append(f"{name}: {remark}")
        else:
            values = np.concatenate([part for part in parts if not isinstance(part, Dates)])
        columns.append(values)
    return Table(
        tuple(first.values),
        tuple(units[name] for name in first.values),
        np.array(columns, dtype=np.float64).reshape(len(columns), sum(counts)),
        starts,
        tuple(file.file for file in files),
        np.repeat(np.arange(len(files), dtype=np.int64), counts),
        np.concatenate([np.array(file.lines, dtype=np.int64) for file in files]),
        first.skipped,
        "; ".join(remarks),
        labels,
        origins,
        tuple(dict.fromkeys(phrase for file in files for phrase in file.left_out)),
    )


def _check_alike(first: FileColumns, other: FileColumns) -> None:
    pair = f"{first.file} and {other.file}"
    if set(other.values) != set(first.values):
        different = ", ".join(sorted(set(other.values) ^ set(first.values)))
        raise DataError(f"{pair} differ in the columns {different}; files read together need the same columns")
    if other.units != first.units:
        raise DataError(f"{pair} differ in the units of their columns; convert one of them")
    for name, values in first.values.items():
        # None for numbers; dates and clock times are also different kinds
        if getattr(values, "has_date", None) != getattr(other.values[name], "has_date", None):
            raise DataError(f"{pair} differ in column '{name}', which holds dates in one of them; write both alike")


def _with_common_labels(
    files: Sequence[FileColumns], group: str | None
) -> tuple[Sequence[FileColumns], dict[str, tuple[str, ...]]]:
    """Renumber texts so that a number in a column means the same text in all files; return files and texts."""
    labels: dict[str, tuple[str, ...]] = {}
    for name in sorted({name for file in files for name in file.labels}):
        missing = next((file.file for file in files if name not in file.labels), None)
        if missing is not None and name != group:
            continue  # trajectories end with their files, regardless of their names
        if missing is not None:
            raise DataError(f"column '{name}' holds numbers in {missing} and text in another file; write both alike")
        texts = tuple(dict.fromkeys(label for file in files for label in file.labels[name]))
        labels[name], renumbered = texts, []
        for file in files:
            numbers = np.array([texts.index(label) + 1.0 for label in file.labels[name]])
            own = cast(FloatArray, file.values[name]).astype(np.int64) - 1
            renumbered.append(replace(file, values={**file.values, name: numbers[own]}))
        files = renumbered
    return files, labels


def _without_empty(table: Table, config: DataConfig) -> Table:
    """Return the table without columns that are empty in all rows, such as columns of disconnected instruments.

    Columns that options name stay, as do columns with the default name of the time or the trajectories. If no column
    would be left to have an equation, all columns stay, and later checks refuse them.
    """
    trajectory = find_trajectory_column(table.names, config)
    needed = {*named_columns(config), *TIME_NAMES, trajectory}
    empty = [name for name in table.names if name not in needed and np.isnan(table.column(name)).all()]
    left = [name for name in table.names if name not in empty]
    if not empty or not assign_roles_by_name(left, config, trajectory).equations:
        return table
    kept = [table.names.index(name) for name in left]
    phrase = f"empty columns left out: {', '.join(empty)}"
    return replace(
        table,
        names=tuple(left),
        units=tuple(table.units[place] for place in kept),
        columns=np.ascontiguousarray(table.columns[kept]),
        read_as="; ".join(filter(None, (table.read_as, phrase))),
        left_out=(*table.left_out, phrase),
    )


def _with_even_times(table: Table, config: DataConfig) -> Table:
    """Return the table with times, from 0 along each trajectory, if options give the `step` between rows.

    Raises UsageError if the table has a time.
    """
    if config.step is None:
        return table
    known = find_time_column(table.names, config)
    if known in table.names:
        message = "%s %s gives the time between rows, but %s has a time column, '%s'; leave the option out"
        raise UsageError(message, Field("step"), f"{config.step:g}", table.files[0], known)
    name = known or next(name for name in TIME_NAMES if name not in table.names)
    trajectory = find_trajectory_column(table.names, config)
    begins = np.zeros(table.rows, dtype=bool)
    begins[[start for start in table.starts if start < table.rows]] = True
    if trajectory in table.names:
        begins[1:] |= np.diff(table.column(trajectory)) != 0.0
    rows = np.arange(table.rows)
    since_begin = rows - np.maximum.accumulate(np.where(begins, rows, 0))
    return replace(
        table,
        names=(name, *table.names),
        units=("", *table.units),
        columns=np.ascontiguousarray(np.vstack([config.step * since_begin, table.columns])),
        read_as="; ".join(filter(None, (table.read_as, f"times '{name}' in steps of {config.step:g}"))),
    )
