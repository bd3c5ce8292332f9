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
from atoll_coordinator.data.roles.options import split_unit

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
    return _joined([_columns_of(part) for part in parts])


def _has_columns(part: Any) -> bool:
    return isinstance(part, Mapping) or (hasattr(part, "columns") and hasattr(part, "__getitem__"))


def _columns_of(part: Any) -> dict[str, FloatArray]:
    """Return the columns of numbers (N,) by name; those of text are numbered by first appearance."""
    names = [*part] if isinstance(part, Mapping) else [*part.columns]
    found = {}
    for name in names:
        values = np.asarray(part[name])
        if values.ndim != 1:
            raise DataError(f"column '{name}' has the shape {values.shape}; one number for each row is expected")
        try:
            found[str(name)] = np.ascontiguousarray(values, dtype=np.float64)
        except (TypeError, ValueError):
            kinds: dict[str, float] = {}
            numbers = [kinds.setdefault(str(value), float(len(kinds) + 1)) for value in values.tolist()]
            found[str(name)] = np.array(numbers)
    lengths = {len(values) for values in found.values()}
    if len(lengths) != 1 or lengths == {0}:
        raise DataError(f"columns have {sorted(lengths)} rows; one number of rows, above 0, is expected")
    return found


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
