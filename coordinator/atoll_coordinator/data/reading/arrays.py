"""Files of named arrays -> `RawTable`: NPZ, NPY, HDF5 and MATLAB.

HDF5, of which netCDF 4 is a kind, needs h5py (``pip install 'atoll[hdf5]'``): each dataset is an array, or, where it
is a table, each of its fields; an attribute ``units`` gives the unit. scipy reads MATLAB files of versions 5 to 7, in a
process of its own (`matlab_child`); files of version 7.3 are HDF5 and read by h5py.
Letters: N rows, K columns of one array.
"""

import io
import json
import subprocess
import sys
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import accumulate
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from atoll_coordinator.data.reading.cells import NumberCell, cell_of
from atoll_coordinator.data.reading.matlab_child import parts_of
from atoll_coordinator.data.reading.raw_table import RawTable, named_by_place, with_breaks
from atoll_coordinator.data.roles.columns import TIME_NAMES, named_columns, split_unit
from atoll_core.config import DataConfig
from atoll_core.data.dataset import AnyArray
from atoll_core.errors import DataError

_MAGIC: Final = b"\x89HDF\r\n\x1a\n"
_USER_BLOCK: Final = 512
"""Bytes of text with which MATLAB begins an HDF5 file."""
_DEEPEST: Final = 8
"""Levels of structures and cells within each other; a file may lead back to where it came from."""
_MOST: Final = 1_000_000
"""Values in a MATLAB 7.3 file, of which one may be reached by many references."""
_NOTHING: Final = ""
"""Stands for what holds no numbers: texts, functions, tables, arrays without elements."""

# ------------------------------------------------------------------------------------------------------ arrays -> table


def table_of_arrays(
    file: str,
    arrays: Mapping[str, npt.ArrayLike],
    config: DataConfig,
    remarks: tuple[str, ...],
    units: Mapping[str, str] | None = None,
    first: int = 0,
) -> RawTable:
    """Return the columns of arrays of one length: vectors (N,), and columns of matrices (N, K), counted from `first`.

    Where there is a time, N is its length, and arrays of another length are left out. Single numbers always are. Raises
    DataError where the arrays do not fit together, or an array that options name is left out.
    """
    given = {name: np.asarray(array) for name, array in arrays.items()}
    squeezed = {name: array if array.ndim == 1 else np.squeeze(array) for name, array in given.items()}
    vectors = {name: array for name, array in squeezed.items() if array.ndim}
    count = _row_count(file, vectors, config)
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
    shapes = {name: given[name].shape for name in left_out if given[name].ndim and given[name].size}
    named = named_columns(config)
    missed = next((name for name in shapes if split_unit(name)[0] in named), None)
    if missed is None and all(split_unit(header)[0] in (config.time, *TIME_NAMES) for header in headers):
        missed = next(iter(shapes), None)  # nothing is left besides the time
    if missed is not None:
        shape, rows = "x".join(map(str, shapes[missed])), f"{count} row{'' if count == 1 else 's'}"
        found = f"'{missed}' of {file} has {shape} values, but the time has {rows}"
        raise DataError(f"{found}; give one value for each row")
    raw = with_breaks(headers, columns, remarks, column_units)
    return replace(raw, left_out=(*raw.left_out, *((f"left out: {', '.join(left_out)}",) if left_out else ())))


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


def _row_count(file: str, vectors: Mapping[str, AnyArray], config: DataConfig) -> int:
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
    if values.dtype.kind == "M":
        return ["" if text == "NaT" else text for text in np.datetime_as_string(values).tolist()], ""
    unit = "s" if values.dtype.kind == "m" else ""
    if values.dtype.kind in "mbf":
        numbers = (
            values / np.timedelta64(1, "s")
            if unit
            else values.astype(np.float64)
            if values.dtype.kind == "b"
            else values
        )
        return [NumberCell(number) for number in numbers.tolist()], unit
    cells = values.tolist()
    if any(isinstance(cell, complex) for cell in cells):
        raise DataError(f"array '{name}' of {file} holds complex numbers; real ones are expected")
    return [*map(cell_of, cells)], ""


# -------------------------------------------------------------------------------------------------------------- NumPy


def read_npz(path: Path, config: DataConfig) -> RawTable:
    """Read an NPZ file; raises DataError."""
    try:
        zipfile.ZipFile(path).close()  # fails if the file is not an archive; np.load would leave it open
        with np.load(path, allow_pickle=False) as archive:
            arrays: dict[str, AnyArray] = {}
            for key in archive.files:
                for field, part in fields_of("", np.asarray(archive[key])).items():
                    arrays[(field if field not in arrays else f"{key}.{field}") or key] = part
    except OSError:
        raise
    except Exception as error:  # of many kinds, depending on the damage
        raise DataError(f"{path.name} is not an NPZ file of plain arrays; write one with numpy.savez") from error
    return table_of_arrays(path.name, arrays, config, ("NPZ",))


def read_npy(path: Path, config: DataConfig) -> RawTable:
    """Read an array of NumPy: a structured one, or the columns of a matrix without names; raises DataError."""
    try:
        array = np.load(path, allow_pickle=False)
    except OSError:
        raise
    except Exception as error:  # of many kinds, depending on the damage
        raise DataError(f"{path.name} cannot be read as a NumPy array of numbers; save the file again") from error
    if not isinstance(array, np.ndarray):  # an archive with another ending
        raise DataError(f"{path.name} holds several arrays; give it the ending .npz")
    if array.dtype.names is None:
        return table_of_matrix(path.name, array, config, ("NumPy array",))
    return table_of_arrays(path.name, fields_of("", array), config, ("NumPy array",))


# --------------------------------------------------------------------------------------------------------------- HDF5


def read_hdf5(path: Path, config: DataConfig) -> RawTable:
    """Read an HDF5 file; raises DataError."""
    arrays: dict[str, AnyArray] = {}
    units: dict[str, str] = {}
    with _opened(path) as (file, h5py):

        def take(place: str, item: Any) -> None:
            if "pandas_type" in item.attrs:
                raise DataError(f"{path.name} was written by pandas.to_hdf; write it with to_csv or to_parquet")
            if not isinstance(item, h5py.Dataset) or _is_hidden(item):
                return
            _refuse_elsewhere(path.name, place, item)
            values = item[()]
            fill = item.attrs.get("_FillValue", item.attrs.get("missing_value"))
            if fill is not None and values.dtype.kind in "iuf":
                values = np.where(values == np.ravel(fill)[0], np.nan, values)
            for field, part in ({name: values[name] for name in values.dtype.names or ()} or {"": values}).items():
                names = [*place.split("/"), *([field] if field else [])]
                name = names[-1] if names[-1] not in arrays else ".".join(names)
                arrays[name] = part
                if not field and (unit := _text_of(item.attrs.get("units"))):
                    units[name] = unit

        file.visititems(take)
    if not arrays:
        raise DataError(f"{path.name} holds no numeric datasets; one for each column is expected")
    times = [name for name in arrays if name.rpartition(".")[2] in TIME_NAMES]
    if len(times) > 1 and config.time is None and config.states is None:
        advice = "write each group into a file of its own, or choose columns with --time and --states"
        raise DataError(f"{path.name} holds {len(times)} times, {', '.join(times)}; {advice}")
    return table_of_arrays(path.name, arrays, config, ("HDF5",), units)


@contextmanager
def _opened(path: Path) -> Iterator[tuple[Any, Any]]:
    """Open an HDF5 file; yields it, and h5py. Raises DataError without h5py, and for any error in the file."""
    try:
        import h5py
    except ImportError:
        raise DataError(f"reading {path.name} needs h5py; run: pip install 'atoll[hdf5]'") from None
    try:
        with h5py.File(path, "r") as file:
            yield file, h5py
    except DataError:
        raise
    except Exception as error:  # of many kinds, depending on the damage
        raise DataError(f"{path.name} cannot be read as an HDF5 file; save the file again, or as CSV") from error


def _refuse_elsewhere(name: str, path: str, item: Any) -> None:
    """Raise DataError where the numbers of a dataset are in another file, which can be any file of the reader's."""
    if item.external or item.is_virtual:
        raise DataError(f"dataset '{path}' of {name} is kept in another file; write its numbers into {name}")


def _is_hidden(item: Any) -> bool:
    """Tell whether a dataset has no numbers, or only numbers that the format needs."""
    if _text_of(item.attrs.get("NAME")).startswith("This is a netCDF dimension but not"):
        return True
    return item.dtype.kind not in "biufcSV" or item.ndim > 2 or item.size == 0


def _text_of(value: object) -> str:
    text = value.decode("utf-8", "replace") if isinstance(value, bytes) else value
    return str(text) if isinstance(text, str) else ""


# ------------------------------------------------------------------------------------------------------------- MATLAB


def read_matlab(path: Path, config: DataConfig) -> RawTable:
    """Read a MATLAB file; raises DataError.

    Columns of matrices are counted from 1; fields of structures are treated as arrays; elements of a structure array or
    of cells are trajectories, below each other.
    """
    with path.open("rb") as file:
        beginning = file.read(_USER_BLOCK + len(_MAGIC))
    if beginning[:8] == _MAGIC or beginning[_USER_BLOCK:] == _MAGIC:
        with _opened(path) as (hdf5, h5py):
            reader = _MatlabReader(path.name, hdf5, h5py)
            values = {name: reader.value(hdf5[name], 0) for name in hdf5 if not name.startswith("#")}
        (arrays, *runs), version = parts_of(values), "MATLAB 7.3"
    else:
        (arrays, *runs), version = _read_by_child(path, beginning), "MATLAB"
    if not runs:
        if not any(np.ndim(array) for array in arrays.values()):
            raise DataError(f"{path.name} holds no numeric arrays; save vectors or matrices, tables with table2struct")
        return table_of_arrays(path.name, arrays, config, (version,), first=1)
    raws = [
        table_of_arrays(f"run {place} of {path.name}", run, config, (), first=1)
        for place, run in enumerate(runs, start=1)
    ]
    headers = raws[0].headers
    for place, raw in enumerate(raws, start=1):
        if set(raw.headers) != set(headers):
            different = ", ".join(sorted(set(raw.headers) ^ set(headers)))
            raise DataError(f"runs 1 and {place} of {path.name} differ in {different}; give all runs the same fields")
    before = [0, *accumulate(len(raw.lines) for raw in raws[:-1])]
    left_out = [*arrays, *dict.fromkeys(phrase.partition(": ")[2] for raw in raws for phrase in raw.left_out)]
    whole = replace(
        raws[0],
        columns=[[cell for raw in raws for cell in raw.columns[raw.headers.index(header)]] for header in headers],
        lines=[0] * sum(len(raw.lines) for raw in raws),
        starts=[start + rows for raw, rows in zip(raws, before, strict=True) for start in raw.starts],
        remarks=(f"{version}, {len(runs)} runs",),
        left_out=(f"left out: {', '.join(left_out)}",) if left_out else (),
    )
    is_matrix = all(len(run) == 1 and np.ndim(next(iter(run.values()))) == 2 for run in runs)
    return named_by_place(whole) if is_matrix else whole


def _read_by_child(path: Path, beginning: bytes) -> Sequence[dict[str, AnyArray]]:
    """Return the arrays of a file, then the arrays of each run in it, read by a process of its own."""
    refusal = DataError(f"{path.name} cannot be read as a MATLAB file; save the file again, or as CSV")
    if not beginning.startswith(b"MATLAB"):
        raise refusal
    command = [sys.executable, "-P", "-m", "atoll_coordinator.data.reading.matlab_child", str(path)]
    child = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, check=False)
    if child.returncode:
        raise refusal
    with np.load(io.BytesIO(child.stdout), allow_pickle=False) as packed:
        names = json.loads(str(packed["names"]))
        parts: list[dict[str, AnyArray]] = [{} for _ in range(1 + max((run for run, _ in names), default=0))]
        for number, (run, name) in enumerate(names):
            parts[run][name] = packed[str(number)]
        return parts


class _MatlabReader:
    """Reads the values of one open file of version 7.3 as scipy returns the values of earlier versions.

    A structure is a group with its fields; cells are a dataset of references, and so is each field of a structure
    array. References lead to ``#refs#``. Matrices are transposed.
    """

    def __init__(self, name: str, file: Any, h5py: Any) -> None:
        self._name, self._file, self._h5py = name, file, h5py
        self._count = 0

    def value(self, item: Any, depth: int) -> object:
        """Return the value of a group or a dataset, `depth` levels below the file; raises DataError."""
        self._count += 1
        if depth > _DEEPEST or self._count > _MOST:
            found = f"{_DEEPEST} levels of structures and cells" if depth > _DEEPEST else f"{_MOST:,} values"
            advice = "save the columns as vectors or matrices"
            raise DataError(f"{self._name} holds more than {found} within each other; {advice}")
        if isinstance(item, self._h5py.Group):
            return self._structure(item, depth)
        _refuse_elsewhere(self._name, item.name.strip("/"), item)
        if item.attrs.get("MATLAB_empty"):  # its numbers are counts of rows and columns
            return _NOTHING
        if self._is_references(item):
            return [self._referred(reference, depth) for reference in np.ravel(item[()])]
        if _text_of(item.attrs.get("MATLAB_class")) in ("char", "function_handle", "table"):
            return _NOTHING
        values = item[()]
        if getattr(values, "dtype", np.dtype("O")).names == ("real", "imag"):
            values = values["real"] + 1j * values["imag"]
        return np.squeeze(np.transpose(values)) if np.asarray(values).dtype.kind in "biufc" else _NOTHING

    def _structure(self, group: Any, depth: int) -> object:
        """Return the fields of a structure, or the list of the elements of an array of structures."""
        fields = {name: group[name] for name in group}
        arrays = {
            name: np.ravel(field[()])
            for name, field in fields.items()
            if self._is_references(field) and not _text_of(field.attrs.get("MATLAB_class"))
        }
        if not arrays or len(arrays) < len(fields) or len({len(array) for array in arrays.values()}) > 1:
            return {name: self.value(field, depth + 1) for name, field in fields.items()}
        return [
            {name: self._referred(reference, depth) for name, reference in zip(arrays, references, strict=True)}
            for references in zip(*arrays.values(), strict=True)
        ]

    def _is_references(self, item: Any) -> bool:
        is_dataset = isinstance(item, self._h5py.Dataset)
        return is_dataset and self._h5py.check_ref_dtype(item.dtype) is self._h5py.Reference

    def _referred(self, reference: Any, depth: int) -> object:
        return self.value(self._file[reference], depth + 1) if reference else _NOTHING
