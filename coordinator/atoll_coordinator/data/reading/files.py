"""Reads measurement files into a `Table`, on the client's side: by format, then all alike, then joined.

The ending of a file's name says its format; whatever has no other is text. Blank rows and the ends of files separate
trajectories.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import accumulate
from pathlib import Path
from typing import Final

import numpy as np

from atoll_coordinator.data.reading.arrays import read_npy, read_npz
from atoll_coordinator.data.reading.columns import Columns, columns_of
from atoll_coordinator.data.reading.dates import Dates, origin_of, times_of
from atoll_coordinator.data.reading.empty_columns import without_empty
from atoll_coordinator.data.reading.even_times import with_times
from atoll_coordinator.data.reading.hdf5 import read_hdf5
from atoll_coordinator.data.reading.layout import read_text
from atoll_coordinator.data.reading.matlab import read_matlab
from atoll_coordinator.data.reading.parquet import read_parquet
from atoll_coordinator.data.reading.raw_table import RawTable
from atoll_coordinator.data.reading.records import read_records
from atoll_coordinator.data.reading.workbooks import ENDINGS as WORKBOOKS
from atoll_coordinator.data.reading.workbooks import read_workbook
from atoll_coordinator.data.roles.column_options import strip_units
from atoll_core.config import DataConfig
from atoll_core.data.dataset import FloatArray
from atoll_core.data.table import Origin, Table
from atoll_core.errors import DataError

_REFUSED: Final = {
    ".xls": "an Excel workbook of the old format; save it as .xlsx or CSV",
    ".ods": "an OpenDocument spreadsheet; save it as .xlsx or CSV",
    ".pkl": "a pickle, which may hold programs; write CSV or Parquet",
}


def read_table(paths: Sequence[Path], config: DataConfig, time_units: Mapping[str, str] | None = None) -> Table:
    """Read `paths` in order as one table; raises DataError, with one sentence about what cannot be read.

    `time_units` says by column in which unit dates are counted, as units of `config` do; else they tell it themselves.
    """
    if not paths:
        raise DataError("no data file was given; name at least one, such as a CSV file")
    return table_of_parts([_read_file(path, config) for path in paths], config, time_units)


def table_of_parts(parts: Sequence[Columns], config: DataConfig, time_units: Mapping[str, str] | None = None) -> Table:
    """Return what was read of files, or of what a program holds, as one table; raises DataError.

    `time_units` are as of `read_table`.
    """
    group = strip_units(config, parts[0].values).group
    table = joined(parts, {**config.units, **(time_units or {})}, group)
    return with_times(without_empty(table, config), config)


def _read_file(path: Path, config: DataConfig) -> Columns:
    if not path.exists():
        raise DataError(f"there is no file {path}; check its name and the folder you are in")
    if path.is_dir():
        raise DataError(f"{path} is a folder; name the files in it that hold the measurements")
    try:
        return columns_of(path.name, _raw_table(path, config), config)
    except OSError as error:
        raise DataError(f"{path} cannot be read: {error.strerror or error}") from error


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


def joined(files: Sequence[Columns], time_units: Mapping[str, str], group: str | None = None) -> Table:
    """Put the rows of several files below each other; raises DataError when their columns differ.

    The column `group` has to hold texts in all files or in none.
    """
    first = files[0]
    for other in files[1:]:
        _check_alike(first, other)
    files, labels = _with_common_labels(files, group)
    first = files[0]
    counts = [len(file.lines) for file in files]
    before = [0, *accumulate(counts[:-1])]
    starts = tuple(start + rows for file, rows in zip(files, before, strict=True) for start in file.starts)
    columns: list[FloatArray] = []
    origins: dict[str, Origin] = {}
    units, remarks = dict(first.units), []
    for name in first.values:
        parts = [file.values[name] for file in files]
        dates = [part for part in parts if isinstance(part, Dates)]
        if dates:
            values, units[name], remark = times_of(dates, starts, time_units.get(name))
            origins[name] = origin_of(dates, units[name])
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
        "; ".join([_read_as(files), *remarks]),
        labels,
        origins,
        tuple(dict.fromkeys(phrase for file in files for phrase in file.left_out)),
    )


def _with_common_labels(
    files: Sequence[Columns], group: str | None
) -> tuple[Sequence[Columns], dict[str, tuple[str, ...]]]:
    """Return files in which the numbers of a column of names stand for the same texts, and these texts."""
    labels: dict[str, tuple[str, ...]] = {}
    for name in sorted({name for file in files for name in file.labels}):
        missing = next((file.file for file in files if name not in file.labels), None)
        if missing is not None and name != group:
            continue  # trajectories end with their files, whatever they are called
        if missing is not None:
            raise DataError(f"column '{name}' holds numbers in {missing} and text in another file; write both alike")
        texts = tuple(dict.fromkeys(label for file in files for label in file.labels[name]))
        labels[name] = texts
        files = [replace(file, values={**file.values, name: _renumbered(file, name, texts)}) for file in files]
    return files, labels


def _renumbered(file: Columns, name: str, texts: Sequence[str]) -> FloatArray:
    places = np.array([texts.index(label) + 1.0 for label in file.labels[name]])
    numbers = file.values[name]
    assert not isinstance(numbers, Dates)
    return np.asarray(places[numbers.astype(np.int64) - 1], dtype=np.float64)


def _read_as(files: Sequence[Columns]) -> str:
    """Say how files were read: all alike, or each by its name."""
    if all(file.remarks == files[0].remarks for file in files):
        return "; ".join(files[0].remarks)
    return "; ".join(f"{file.file}: {', '.join(file.remarks)}" for file in files)


def _check_alike(first: Columns, other: Columns) -> None:
    """Raise DataError when two files do not have the same columns in the same units."""
    pair = f"{first.file} and {other.file}"
    if set(other.values) != set(first.values):
        different = ", ".join(sorted(set(other.values) ^ set(first.values)))
        raise DataError(f"{pair} differ in the columns {different}; files read together need the same columns")
    if other.units != first.units:
        raise DataError(f"{pair} differ in the units of their columns; convert one of them")
    for name, values in first.values.items():
        # None for numbers; dates and clock times differ, too
        if getattr(values, "has_date", None) != getattr(other.values[name], "has_date", None):
            raise DataError(f"{pair} differ in column '{name}', which holds dates in one of them; write both alike")
