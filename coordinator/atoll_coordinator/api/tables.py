"""Tables from what Python users hold: files, frames of pandas or polars, arrays by name, lists of these."""

from collections.abc import Mapping, Sequence
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np

from atoll.config import DataConfig
from atoll.data.dataset import FloatArray
from atoll.data.table import Table
from atoll.errors import DataError
from atoll_coordinator.data.reading.files import read_table
from atoll_coordinator.data.roles.options import find_trajectory_column, named_columns, split_unit

NAME = "data"
"""What messages call a table that was not read from a file."""


def table_of(data: Any, config: DataConfig) -> Table:
    """Return the table of files, of columns by name, or of a list of these, one for each trajectory.

    Raises:
        DataError: it is none of these, or its columns do not fit together.
    """
    if isinstance(data, Table):
        return data
    parts = [*data] if isinstance(data, (list, tuple)) else [data]
    if parts and all(isinstance(part, (str, Path)) for part in parts):
        return read_table([Path(part) for part in parts], config)
    if not parts or not all(_has_columns(part) for part in parts):
        raise DataError(
            "data must be a file, a frame of pandas or polars, arrays by column name, or a list of these; "
            f"found {type(data).__name__}"
        )
    return _joined([_columns_of(part, config) for part in parts])


def _has_columns(part: Any) -> bool:
    return isinstance(part, Mapping) or (hasattr(part, "columns") and hasattr(part, "__getitem__"))


def _columns_of(part: Any, config: DataConfig) -> dict[str, FloatArray]:
    """Return the columns of numbers (N,) by name.

    As in files, the trajectory column alone may hold text, which is numbered by first appearance; other columns that
    hold nothing else are left out unless options name them.
    """
    names = [*part] if isinstance(part, Mapping) else [*part.columns]
    plain = [split_unit(str(name))[0] for name in names]
    trajectory, needed = find_trajectory_column(plain, config), named_columns(config)
    found = {}
    for name, its in zip(names, plain, strict=True):
        values = np.asarray(part[name])
        if values.ndim != 1:
            raise DataError(f"column '{name}' has the shape {values.shape}; one number for each row is expected")
        numbers = numbers_of(values, f"column '{name}'")
        if numbers is not None:
            found[str(name)] = numbers
        elif its == trajectory:
            found[str(name)] = _numbered(values)
        elif its in needed:
            raise DataError(f"column '{name}' holds text; numbers are expected")
    if names and not found:
        raise DataError("all columns hold text; numbers are expected")
    lengths = {len(values) for values in found.values()}
    if len(lengths) != 1 or lengths == {0}:
        raise DataError(f"columns have {sorted(lengths)} rows; one number of rows, above 0, is expected")
    return found


def numbers_of(values: Any, name: str) -> FloatArray | None:
    """Return an array as numbers, None where it holds text alone; `name` is for messages.

    Raises:
        DataError: it holds dates, complex numbers, or text among numbers.
    """
    values = np.asarray(values)
    if values.dtype.kind in "mM":
        raise DataError(f"{name} holds dates or times; convert it to numbers first")
    if values.dtype.kind == "c":
        raise DataError(f"{name} holds complex numbers; real ones are expected")
    try:
        return np.ascontiguousarray(values, dtype=np.float64).reshape(values.shape)
    except (TypeError, ValueError):
        cells = values.ravel().tolist()
    text = [not _is_number(cell) for cell in cells]
    if all(text) and all(isinstance(cell, str) for cell in cells):
        return None
    row = text.index(True) if True in text else 0
    raise DataError(f"{name} holds {str(cells[row])!r} in row {row + 1}, which is no number; correct it")


def _is_number(cell: Any) -> bool:
    try:
        float(cell)
    except (TypeError, ValueError):
        return False
    return True


def _numbered(values: Any) -> FloatArray:
    kinds: dict[str, float] = {}
    return np.array([kinds.setdefault(str(value), float(len(kinds) + 1)) for value in values.tolist()])


def _joined(parts: Sequence[Mapping[str, FloatArray]]) -> Table:
    first = tuple(parts[0])
    for part in parts:
        if set(part) != set(first):
            different = ", ".join(sorted(set(part) ^ set(first)))
            raise DataError(f"trajectories differ in the columns {different}; all need the same ones")
    columns = np.ascontiguousarray([np.concatenate([part[name] for part in parts]) for name in first])
    lengths = [len(part[first[0]]) for part in parts]
    starts = (0, *accumulate(lengths[:-1]))
    units = [split_unit(name) for name in first]
    rows = columns.shape[1]
    nowhere = np.zeros(rows, dtype=np.int64)
    names = tuple(name for name, _ in units)
    return Table(names, tuple(unit for _, unit in units), columns, starts, (NAME,), nowhere, nowhere.copy())
