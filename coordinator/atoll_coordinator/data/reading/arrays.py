"""Named arrays, as NPZ, NPY, MATLAB and HDF5 files hold them -> `RawTable`. Pure, apart from reading NumPy's files.

Letters: N rows, K columns of one array.
"""

import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt

from atoll_coordinator.data.reading.raw_table import RawTable, with_breaks
from atoll_coordinator.data.roles.time_column import TIME_NAMES
from atoll_core.config import DataConfig
from atoll_core.data.dataset import AnyArray
from atoll_core.errors import DataError


def read_npz(path: Path, config: DataConfig) -> RawTable:
    """Read an NPZ file; raises DataError."""
    try:
        zipfile.ZipFile(path).close()  # whatever is none is found out here: np.load would leave it open
        with np.load(path, allow_pickle=False) as archive:
            arrays: dict[str, AnyArray] = {}
            for key in archive.files:
                for field, part in fields_of("", np.asarray(archive[key])).items():
                    arrays[(field if field not in arrays else f"{key}.{field}") or key] = part
    except OSError:
        raise
    except Exception as error:  # of many kinds, for whatever is broken in there
        raise DataError(f"{path.name} is not an NPZ file of plain arrays; write one with numpy.savez") from error
    return table_of_arrays(path.name, arrays, config, ("NPZ",))


def read_npy(path: Path, config: DataConfig) -> RawTable:
    """Read an array of NumPy whose columns have names, a structured one; raises DataError."""
    try:
        array = np.load(path, allow_pickle=False)
    except OSError:
        raise
    except Exception as error:  # of many kinds, for whatever is broken in there
        raise DataError(f"{path.name} is not a NumPy array of numbers that can be read; write it anew") from error
    if not isinstance(array, np.ndarray):  # an archive with another ending
        raise DataError(f"{path.name} holds several arrays; give it the ending .npz")
    if array.dtype.names is None:
        advice = "save them by name with numpy.savez, or as CSV"
        raise DataError(f"{path.name} is a NumPy array without names of columns; {advice}")
    return table_of_arrays(path.name, fields_of("", array), config, ("NumPy array",))


def fields_of(name: str, array: AnyArray) -> dict[str, AnyArray]:
    """Return the fields of a structured array, ``field.part`` of a structured field; another array by its `name`."""
    if array.dtype.names is None:
        return {name: array}
    named: dict[str, AnyArray] = {}
    for field in array.dtype.names:
        named |= fields_of(f"{name}.{field}" if name else field, array[field])
    return named


def table_of_arrays(
    file: str,
    arrays: Mapping[str, npt.ArrayLike],
    config: DataConfig,
    remarks: tuple[str, ...],
    units: Mapping[str, str] | None = None,
    first: int = 0,
) -> RawTable:
    """Return the columns of arrays of one length: vectors (N,), and those of matrices (N, K), counted from `first`.

    Where there is a time, its length is N, and arrays of another length are left out. Single numbers always are. Raises
    DataError where the arrays do not fit together.
    """
    vectors = {name: squeezed for name, array in arrays.items() if (squeezed := np.squeeze(np.asarray(array))).ndim}
    count = _length(file, vectors, config)
    headers: list[str] = []
    columns: list[list[str]] = []
    column_units: list[str] = []
    left_out = [name for name in arrays if name not in vectors]
    for name, array in vectors.items():
        if array.ndim > 2 or count not in array.shape:
            left_out.append(name)
            continue
        parts = [array] if array.ndim == 1 else [*(array.T if array.shape[0] == count else array)]
        for number, part in enumerate(parts):
            cells, unit = _cells(file, name, part)
            headers.append(name if len(parts) == 1 else f"{name}{number + first}")
            columns.append(cells)
            column_units.append((units or {}).get(name, unit))
    others = (f"left out: {', '.join(left_out)}",) if left_out else ()
    return with_breaks(headers, columns, (*remarks, *others), column_units)


def _length(file: str, vectors: Mapping[str, AnyArray], config: DataConfig) -> int:
    """Return the number of rows."""
    for name in (config.time or "", *TIME_NAMES):
        if name in vectors and vectors[name].ndim == 1:
            return len(vectors[name])
    lengths = {max(array.shape) if array.ndim == 2 else len(array) for array in vectors.values()}
    if len(lengths) != 1 or any(array.ndim > 2 for array in vectors.values()):
        shapes = sorted({array.shape for array in vectors.values()})
        raise DataError(f"{file} holds arrays of shapes {shapes}; one-dimensional ones of one length fit")
    return lengths.pop()


def _cells(file: str, name: str, values: AnyArray) -> tuple[list[str], str]:
    """Return values as cells, and the unit of durations."""
    if values.dtype.kind == "c":
        raise DataError(f"array '{name}' of {file} holds complex numbers; real ones are expected")
    if values.dtype.kind == "m":
        return _texts(values / np.timedelta64(1, "s")), "s"
    if values.dtype.kind == "M":
        return ["" if text == "NaT" else text for text in np.datetime_as_string(values).tolist()], ""
    if values.dtype.kind == "b":
        return _texts(values.astype(np.float64)), ""
    if values.dtype.kind == "S":
        return [text.decode("utf-8", "replace") for text in values.tolist()], ""
    return _texts(values), ""


def _texts(values: AnyArray) -> list[str]:
    return [str(value) for value in values.tolist()]
