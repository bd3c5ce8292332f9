"""HDF5 files -> `RawTable`, by h5py, an extra: ``pip install 'atoll[hdf5]'``.

Every dataset is an array of its own, or, where it is a table, one for each of its fields; an attribute ``units`` gives
the unit. Files of netCDF 4 are such files.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np

from atoll_coordinator.data.reading.arrays import table_of_arrays
from atoll_coordinator.data.reading.raw_table import RawTable
from atoll_coordinator.data.roles.time_column import TIME_NAMES
from atoll_core.config import DataConfig
from atoll_core.data.dataset import AnyArray
from atoll_core.errors import DataError

MAGIC: Final = b"\x89HDF\r\n\x1a\n"
_Arrays = tuple[dict[str, AnyArray], dict[str, str]]


def read_hdf5(path: Path, config: DataConfig) -> RawTable:
    """Read an HDF5 file; raises DataError."""
    with opened(path) as (file, h5py):
        arrays, units = _collected(path.name, file, h5py)
    if not arrays:
        raise DataError(f"{path.name} holds no numeric datasets; one for each column is expected")
    times = [name for name in arrays if name.rpartition(".")[2] in TIME_NAMES]
    if len(times) > 1 and config.time is None and config.states is None:
        advice = "write each group into a file of its own, or choose columns with --time and --states"
        raise DataError(f"{path.name} holds {len(times)} times, {', '.join(times)}; {advice}")
    return table_of_arrays(path.name, arrays, config, ("HDF5",), units)


@contextmanager
def opened(path: Path) -> Iterator[tuple[Any, Any]]:
    """Open a file; gives it, and h5py. Raises DataError without h5py, and for whatever is wrong with the file."""
    try:
        import h5py
    except ImportError:
        raise DataError(f"reading {path.name} needs h5py; run: pip install 'atoll[hdf5]'") from None
    try:
        with h5py.File(path, "r") as file:
            yield file, h5py
    except DataError:
        raise
    except Exception as error:  # of many kinds, for whatever is broken in there
        raise DataError(f"{path.name} is not an HDF5 file that can be read; write it anew, or as CSV") from error


def refuse_elsewhere(name: str, path: str, item: Any) -> None:
    """Raise DataError where a dataset is kept in another file: anybody's, named by whoever wrote this one."""
    if item.external or item.is_virtual:
        raise DataError(f"dataset '{path}' of {name} is kept in another file; write its numbers into {name}")


def _collected(name: str, file: Any, h5py: Any) -> _Arrays:
    arrays: dict[str, AnyArray] = {}
    units: dict[str, str] = {}

    def take(path: str, item: Any) -> None:
        if "pandas_type" in item.attrs:
            raise DataError(f"{name} was written by pandas.to_hdf; write it with to_csv or to_parquet")
        if not isinstance(item, h5py.Dataset) or _is_hidden(item):
            return
        refuse_elsewhere(name, path, item)
        values = _with_missing(item, item[()])
        parts = {field: values[field] for field in values.dtype.names} if values.dtype.names else {"": values}
        for field, part in parts.items():
            places = [*path.split("/"), *([field] if field else [])]
            called = places[-1] if places[-1] not in arrays else ".".join(places)
            arrays[called] = part
            if not field and (unit := text_of(item.attrs.get("units"))):
                units[called] = unit

    file.visititems(take)
    return arrays, units


def _is_hidden(item: Any) -> bool:
    """Tell whether a dataset holds no numbers, or what only the format needs."""
    if text_of(item.attrs.get("NAME")).startswith("This is a netCDF dimension but not"):
        return True
    return item.dtype.kind not in "biufcSV" or item.ndim > 2 or item.size == 0


def _with_missing(item: Any, values: AnyArray) -> AnyArray:
    """Return values with NaN for what the file calls missing."""
    fill = item.attrs.get("_FillValue", item.attrs.get("missing_value"))
    if fill is None or values.dtype.kind not in "iuf":
        return values
    return np.where(values == np.ravel(fill)[0], np.nan, values)


def text_of(value: object) -> str:
    """Return the text of an attribute, "" where it is none."""
    text = value.decode("utf-8", "replace") if isinstance(value, bytes) else value
    return str(text) if isinstance(text, str) else ""
