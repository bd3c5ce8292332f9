"""HDF5 files -> `RawTable`, by h5py, an extra: ``pip install 'atoll[hdf5]'``.

Every dataset is an array of its own, or, where it is a table, one for each of its fields; an attribute ``units`` gives
the unit. Files of netCDF 4 are such files.
"""

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
    arrays, units = read_arrays(path)
    if not arrays:
        raise DataError(f"{path.name} holds no numeric datasets; one for each column is expected")
    times = [name for name in arrays if name.rpartition(".")[2] in TIME_NAMES]
    if len(times) > 1 and config.time is None and config.states is None:
        advice = "write each group into a file of its own, or choose columns with --time and --states"
        raise DataError(f"{path.name} holds {len(times)} times, {', '.join(times)}; {advice}")
    return table_of_arrays(path.name, arrays, config, ("HDF5",), units)


def read_arrays(path: Path, is_matlab: bool = False) -> _Arrays:
    """Return arrays and units by name; matrices as MATLAB means them, whose order of numbers is the other one.

    Raises DataError where h5py is not installed, or the file is none that it reads, or one of pandas.
    """
    try:
        import h5py
    except ImportError:
        raise DataError(f"reading {path.name} needs h5py; run: pip install 'atoll[hdf5]'") from None
    try:
        with h5py.File(path, "r") as file:
            return _collected(path.name, file, h5py, is_matlab)
    except DataError:
        raise
    except Exception as error:  # of many kinds, for whatever is broken in there
        raise DataError(f"{path.name} is not an HDF5 file that can be read; write it anew, or as CSV") from error


def _collected(name: str, file: Any, h5py: Any, is_matlab: bool) -> _Arrays:
    arrays: dict[str, AnyArray] = {}
    units: dict[str, str] = {}

    def take(path: str, item: Any) -> None:
        if "pandas_type" in item.attrs:
            raise DataError(f"{name} was written by pandas.to_hdf; write it with to_csv or to_parquet")
        if not isinstance(item, h5py.Dataset) or _is_hidden(path, item, is_matlab):
            return
        if item.external or item.is_virtual:  # anybody's file, named by whoever wrote this one
            raise DataError(f"dataset '{path}' of {name} is kept in another file; write its numbers into {name}")
        values = _with_missing(item, item[()])
        parts = {field: values[field] for field in values.dtype.names} if values.dtype.names else {"": values}
        for field, part in parts.items():
            places = [*path.split("/"), *([field] if field else [])]
            called = places[-1] if places[-1] not in arrays else ".".join(places)
            arrays[called] = part.T if is_matlab else part
            if not field and (unit := _text(item.attrs.get("units"))):
                units[called] = unit

    file.visititems(take)
    return arrays, units


def _is_hidden(path: str, item: Any, is_matlab: bool) -> bool:
    """Tell whether a dataset holds no numbers, or what only the format needs."""
    kind = _text(item.attrs.get("MATLAB_class"))
    if path.startswith("#") or (is_matlab and kind in ("char", "cell", "struct", "function_handle", "table")):
        return True
    if _text(item.attrs.get("NAME")).startswith("This is a netCDF dimension but not"):
        return True
    return item.dtype.kind not in "biufcSV" or item.ndim > 2 or item.size == 0


def _with_missing(item: Any, values: AnyArray) -> AnyArray:
    """Return values with NaN for what the file calls missing."""
    fill = item.attrs.get("_FillValue", item.attrs.get("missing_value"))
    if fill is None or values.dtype.kind not in "iuf":
        return values
    return np.where(values == np.ravel(fill)[0], np.nan, values)


def _text(value: object) -> str:
    text = value.decode("utf-8", "replace") if isinstance(value, bytes) else value
    return str(text) if isinstance(text, str) else ""
