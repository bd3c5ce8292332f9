"""Tables from what Python users hold: files, frames of pandas or polars, data sets of xarray, arrays by name, lists."""

import datetime
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import accumulate
from pathlib import Path
from typing import Protocol, SupportsFloat, TypeGuard, cast

import numpy as np

from atoll_coordinator.data.reading.arrays import fields_of, table_of_arrays
from atoll_coordinator.data.reading.columns import TIME, columns_of
from atoll_coordinator.data.reading.dates import Dates, dates_of_array, times_of
from atoll_coordinator.data.reading.empty_columns import without_empty
from atoll_coordinator.data.reading.files import read_table
from atoll_coordinator.data.reading.long_tables import may_be_long, widened
from atoll_coordinator.data.roles.column_options import named_columns, split_unit
from atoll_coordinator.data.roles.time_column import TIME_NAMES
from atoll_coordinator.data.roles.trajectory_column import find_trajectory_column
from atoll_core.config import DataConfig
from atoll_core.data.dataset import AnyArray, FloatArray
from atoll_core.data.masked import plain_array
from atoll_core.data.table import Table
from atoll_core.errors import DataError

NAME = "data"
"""What messages call a table that was not read from a file."""


class _Frame(Protocol):
    """Columns by name, as pandas and polars have them."""

    @property
    def columns(self) -> Iterable[str]: ...

    def __getitem__(self, name: str) -> object: ...


_Columns = Mapping[str, object] | _Frame


def table_of(data: object, config: DataConfig) -> Table:
    """Return the table of files, of columns by name, or of a list of these, one for each trajectory.

    Raises DataError where it is none of these, or its columns do not fit together.
    """
    if isinstance(data, Table):
        return data
    given: list[object] = [*data] if isinstance(data, (list, tuple)) else [data]
    files = files_of(data)
    if files and len(files) == len(given):
        return read_table(files, config)
    parts = [part for part in given if _has_columns(part)]
    if not given or len(parts) < len(given):
        raise DataError(
            "data must be a file, a frame of pandas or polars, a data set of xarray, arrays by column name, an array "
            f"with named fields, or a list; found {type(data).__name__}"
        )
    labels: dict[str, dict[str, float]] = {}
    table = _joined([_columns_of(part, config, labels) for part in parts])
    return without_empty(replace(table, labels={name: tuple(texts) for name, texts in labels.items()}), config)


def files_of(data: object) -> list[Path]:
    """Return the files among what was given."""
    given: list[object] = [*data] if isinstance(data, (list, tuple)) else [data]
    return [Path(part) for part in given if isinstance(part, (str, Path))]


def _has_columns(part: object) -> TypeGuard[_Columns]:
    if isinstance(part, np.ndarray):
        return part.dtype.names is not None
    return isinstance(part, Mapping) or (hasattr(part, "columns") and hasattr(part, "__getitem__"))


def _columns_of(
    part: _Columns, config: DataConfig, labels: dict[str, dict[str, float]]
) -> dict[str, FloatArray | Dates]:
    """Return the columns of numbers (N,) by name.

    As in files, the columns of trajectories and of groups alone may hold text, which is numbered by first appearance
    over all parts, its texts being kept in `labels`; other columns that hold nothing else are left out unless options
    name them. Dates are the time, and so is an index of a pandas frame that has a name or holds dates.
    """
    named = _named_arrays(part)
    wide = _wide_columns(named, config, labels) if may_be_long(named) else None
    if wide is not None:
        return wide
    plain = [split_unit(name)[0] for name in named]
    trajectory, needed = find_trajectory_column(plain, config), named_columns(config)
    columns: dict[str, FloatArray | Dates] = {}
    for (name, values), plain_name in zip(named.items(), plain, strict=True):
        if values.ndim != 1:
            raise DataError(f"column '{name}' has the shape {values.shape}; one number for each row is expected")
        dates = _dates_of(values)
        numbers = None if dates is not None else numbers_of(values, f"column '{name}'")
        if dates is not None:
            columns[_time_name(plain_name, plain, config)] = dates
        elif numbers is not None:
            columns[f"{name} [s]" if values.dtype.kind == "m" and plain_name == name else name] = numbers
        elif plain_name in (trajectory, config.group):
            columns[name] = _numbered(values, labels.setdefault(plain_name, {}))
        elif plain_name in needed:
            raise DataError(f"column '{name}' holds text; numbers are expected")
    if named and not columns:
        raise DataError("all columns hold text; numbers are expected")
    lengths = {_length(values) for values in columns.values()}
    if len(lengths) != 1 or lengths == {0}:
        raise DataError(f"columns have {sorted(lengths)} rows; one number of rows, above 0, is expected")
    return columns


def _wide_columns(
    named: Mapping[str, AnyArray], config: DataConfig, labels: dict[str, dict[str, float]]
) -> dict[str, FloatArray | Dates] | None:
    """Return the columns of a long table, with one for each observable, as of a file; None where it is none."""
    if any(values.ndim != 1 for values in named.values()) or len({*map(len, named.values())}) != 1:
        return None
    raw = table_of_arrays(NAME, named, config, ())
    if widened(NAME, raw, config) is raw:
        return None
    columns = columns_of(NAME, raw, config)
    found = dict(columns.values)
    for name, texts in columns.labels.items():
        numbers = found[name]
        assert not isinstance(numbers, Dates)
        kinds = labels.setdefault(name, {})
        found[name] = _numbered(np.array([texts[int(number) - 1] for number in numbers.tolist()]), kinds)
    return {
        f"{name} [{columns.units[name]}]" if columns.units[name] and not isinstance(values, Dates) else name: values
        for name, values in found.items()
    }


def _named_arrays(part: _Columns) -> dict[str, AnyArray]:
    """Return the columns of a mapping, a frame or an xarray data set, and the index of a pandas frame if it says more
    than which row it is."""
    kinds = [getattr(part, kind, None) for kind in ("coords", "data_vars")]
    variables = [kind for kind in kinds if isinstance(kind, Mapping)]
    if isinstance(part, np.ndarray):
        sources: Mapping[object, object] = dict(fields_of("", part).items())
    elif len(variables) == len(kinds):  # xarray
        sources = {name: values for named in variables for name, values in named.items()}
    else:
        sources = {name: part[name] for name in ([*part] if isinstance(part, Mapping) else part.columns)}
    named = {str(name): _array(values, str(name)) for name, values in sources.items()}
    index = getattr(part, "index", None)
    if index is None or callable(index):
        return named
    values, name = _array(index, "index"), getattr(index, "name", None)
    says_when = values.dtype.kind == "m" or _dates_of(values) is not None
    if (name is not None or says_when) and str(name or TIME) not in named:
        return {str(name or TIME): values, **named}
    return named


def _array(values: object, name: str) -> AnyArray:
    try:
        return plain_array(values)
    except ValueError:
        raise DataError(f"column '{name}' holds rows of different lengths; one number for each is expected") from None


def _dates_of(values: AnyArray) -> Dates | None:
    """Return dates (N,) in nanoseconds; None where there are none."""
    if values.dtype.kind == "M":
        return dates_of_array(values)
    cells = values.tolist() if values.dtype.kind == "O" else []
    if not all(cell is None or isinstance(cell, datetime.datetime) for cell in cells) or not any(cells):
        return None
    return Dates(tuple(_nanoseconds(cell) for cell in cells), "dates", has_date=True)


def _nanoseconds(cell: datetime.datetime | None) -> int | None:
    """Return the nanoseconds since 1970, which are ``value`` of pandas' own time stamps; None for no date."""
    if cell is None or cell != cell:  # NaT of pandas
        return None
    value = getattr(cell, "value", None)
    if isinstance(value, int):
        return value
    since = cell - datetime.datetime(1970, 1, 1, tzinfo=None if cell.tzinfo is None else datetime.UTC)
    return (since // datetime.timedelta(microseconds=1)) * 1000


def _time_name(name: str, names: Sequence[str], config: DataConfig) -> str:
    """Return what a column of dates is called: as it is where that makes it the time, else ``time``.

    Raises DataError where there is another time.
    """
    if name == config.time or (config.time is None and name in TIME_NAMES):
        return name
    other = config.time or next((known for known in TIME_NAMES if known in names), None)
    if other is not None:
        raise DataError(f"column '{name}' holds dates or times beside the time '{other}'; leave out one of them")
    return TIME


def _length(values: FloatArray | Dates) -> int:
    return len(values.nanoseconds if isinstance(values, Dates) else values)


def numbers_of(given: object, name: str) -> FloatArray | None:
    """Return an array as numbers, durations in seconds, NaN where it is masked or None; None where it holds text alone.

    `name` is for messages. Raises DataError where it holds dates, complex numbers, or text among numbers.
    """
    values = plain_array(given)
    if values.dtype.kind == "m":
        return np.asarray(values / np.timedelta64(1, "s"), dtype=np.float64)
    if values.dtype.kind == "M":
        raise DataError(f"{name} holds dates or times; convert it to numbers first")
    if values.dtype.kind == "c":
        raise DataError(f"{name} holds complex numbers; real ones are expected")
    try:
        return np.ascontiguousarray(values, dtype=np.float64).reshape(values.shape)
    except (TypeError, ValueError):
        cells = values.ravel().tolist()
    text = [cell is not None and not _is_number(cell) for cell in cells]
    if not any(_is_number(cell) for cell in cells) and all(cell is None or isinstance(cell, str) for cell in cells):
        return None
    row = text.index(True) if True in text else 0
    raise DataError(f"{name} holds {str(cells[row])!r} in row {row + 1}, which is no number; correct it")


def _is_number(cell: object) -> bool:
    try:
        float(cast(SupportsFloat, cell))
    except (TypeError, ValueError):
        return False
    return True


def _numbered(values: AnyArray, kinds: dict[str, float]) -> FloatArray:
    """Number texts by first appearance, going on with the `kinds` there are."""
    return np.array([kinds.setdefault(str(value), float(len(kinds) + 1)) for value in values.tolist()])


def _joined(parts: Sequence[Mapping[str, FloatArray | Dates]]) -> Table:
    first = tuple(parts[0])
    for part in parts:
        if set(part) != set(first):
            different = ", ".join(sorted(set(part) ^ set(first)))
            raise DataError(f"trajectories differ in the columns {different}; all need the same ones")
    starts = (0, *accumulate(_length(part[first[0]]) for part in parts[:-1]))
    read = [_column([part[name] for part in parts], name, starts) for name in first]
    units = [(split_unit(name)[0], unit or split_unit(name)[1]) for name, (_, unit, _) in zip(first, read, strict=True)]
    columns = np.ascontiguousarray([values for values, *_ in read])
    nowhere = np.zeros(columns.shape[1], dtype=np.int64)
    names = tuple(name for name, _ in units)
    remarks = "; ".join(f"{name}: {remark}" for name, (*_, remark) in zip(names, read, strict=True) if remark)
    return Table(
        names, tuple(unit for _, unit in units), columns, starts, (NAME,), nowhere, nowhere.copy(), read_as=remarks
    )


def _column(parts: Sequence[FloatArray | Dates], name: str, starts: Sequence[int]) -> tuple[FloatArray, str, str]:
    """Return one column of all trajectories, and of dates the unit and since when."""
    dates = [part for part in parts if isinstance(part, Dates)]
    if dates and len(dates) < len(parts):
        raise DataError(f"column '{name}' holds dates in some trajectories only; write all alike")
    if dates:
        return times_of(dates, starts, None)
    return np.concatenate([part for part in parts if not isinstance(part, Dates)]), "", ""
