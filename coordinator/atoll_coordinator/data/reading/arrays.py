"""Named arrays, as NPZ, NPY, MATLAB and HDF5 files hold them -> `RawTable`. Pure, apart from reading NumPy's files.

Letters: N rows, K columns of one array.
"""

import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from atoll_coordinator.data.reading.cells import NumberCell, cell_of
from atoll_coordinator.data.reading.header import named_by_place
from atoll_coordinator.data.reading.raw_table import RawTable, with_breaks
from atoll_coordinator.data.roles.column_options import named_columns, split_unit
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
    """Read an array of NumPy: a structured one, or the columns of a matrix without names; raises DataError."""
    try:
        array = np.load(path, allow_pickle=False)
    except OSError:
        raise
    except Exception as error:  # of many kinds, for whatever is broken in there
        raise DataError(f"{path.name} is not a NumPy array of numbers that can be read; write it anew") from error
    if not isinstance(array, np.ndarray):  # an archive with another ending
        raise DataError(f"{path.name} holds several arrays; give it the ending .npz")
    if array.dtype.names is None:
        return table_of_matrix(path.name, array, config, ("NumPy array",))
    return table_of_arrays(path.name, fields_of("", array), config, ("NumPy array",))


def table_of_matrix(file: str, array: AnyArray, config: DataConfig, remarks: tuple[str, ...]) -> RawTable:
    """Return the columns (N,) of a matrix (N, K), or of a vector (N,), which have no names; raises DataError."""
    if array.ndim not in (1, 2) or not array.size:
        raise DataError(f"{file} holds an array of the shape {array.shape}; rows by columns of numbers are expected")
    columns = {str(place): column for place, column in enumerate(np.atleast_2d(array.T))}
    return named_by_place(table_of_arrays(file, columns, config, remarks))


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
    DataError where the arrays do not fit together, or one that options name is left out.
    """
    given = {name: np.asarray(array) for name, array in arrays.items()}
    vectors = {name: part for name, array in given.items() if (part := _squeezed(array)).ndim}
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
    _check_left_out(file, {name: given[name] for name in left_out}, headers, count, config)
    others = (f"left out: {', '.join(left_out)}",) if left_out else ()
    raw = with_breaks(headers, columns, remarks, column_units)
    return replace(raw, left_out=(*raw.left_out, *others))


def _squeezed(array: AnyArray) -> AnyArray:
    """Return an array without axes of length 1, but for that of a single row."""
    return array if array.ndim == 1 else np.squeeze(array)


def _check_left_out(
    file: str, left_out: Mapping[str, AnyArray], headers: Sequence[str], count: int, config: DataConfig
) -> None:
    """Raise DataError where options name an array that does not fit, or nothing is left beside the time."""
    named = named_columns(config)
    shapes = {name: array.shape for name, array in left_out.items() if array.ndim and array.size}
    missed = next((name for name in shapes if split_unit(name)[0] in named), None)
    is_nothing_left = all(split_unit(header)[0] in (config.time, *TIME_NAMES) for header in headers)
    if missed is None and shapes and is_nothing_left:
        missed = next(iter(shapes))
    if missed is not None:
        shape = "x".join(map(str, shapes[missed]))
        rows = f"{count} row{'' if count == 1 else 's'}"
        raise DataError(
            f"'{missed}' of {file} has {shape} values, but the time has {rows}; give one value for each row"
        )


def _length(file: str, vectors: Mapping[str, AnyArray], config: DataConfig) -> int:
    """Return the number of rows."""
    plain = {split_unit(name)[0]: array for name, array in vectors.items()}
    for name in (split_unit(config.time or "")[0], *TIME_NAMES):
        if name in plain and plain[name].ndim == 1:
            return len(plain[name])
    if not vectors:
        raise DataError(f"{file} holds single values only; one array for each column is expected")
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
    if values.dtype.kind == "f":
        return _texts(values), ""
    cells = values.tolist()
    if any(isinstance(cell, complex) for cell in cells):
        raise DataError(f"array '{name}' of {file} holds complex numbers; real ones are expected")
    return [*map(cell_of, cells)], ""


def _texts(values: AnyArray) -> list[str]:
    return [NumberCell(value) for value in values.tolist()]
