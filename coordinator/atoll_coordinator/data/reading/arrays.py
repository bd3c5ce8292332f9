"""Files of named arrays -> `RawTable`: NPZ, NPY, HDF5 and MATLAB.

HDF5 (netCDF 4 is also HDF5) needs h5py (``pip install 'atoll[hdf5]'``). Each dataset is one array; if the dataset is a
table, each of its fields is one array. An attribute ``units`` gives the unit. scipy reads MATLAB files of versions 5 to
7, in a separate process (`matlab_child`); files of version 7.3 are HDF5 and are read by h5py. Letters: N rows, K
columns of one array.
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
from atoll_coordinator.data.reading.raw_table import RawTable, named_by_place, with_breaks
from atoll_coordinator.data.roles.names_and_options import TIME_NAMES, named_columns, split_unit
from atoll_core.config import DataConfig
from atoll_core.data.dataset import AnyArray
from atoll_core.errors import DataError

_MAGIC: Final = b"\x89HDF\r\n\x1a\n"
_USER_BLOCK: Final = 512
"""Number of bytes of text at the beginning of an HDF5 file by MATLAB."""

# ------------------------------------------------------------------------------------------------------ arrays -> table


def table_of_arrays(
    file: str,
    arrays: Mapping[str, npt.ArrayLike],
    config: DataConfig,
    remarks: tuple[str, ...],
    units: Mapping[str, str] | None = None,
    first: int = 0,
) -> RawTable:
    """Return the columns of arrays of one length N.

    The columns are vectors (N,), and the columns of matrices (N, K), numbered from `first`. If there is a time, N is
    its length, and arrays of another length are left out. Single numbers are always left out. Raises DataError if the
    arrays do not fit together, or if an array that options name would be left out.
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
        missed = next(iter(shapes), None)  # nothing is left except the time
    if missed is not None:
        shape, rows = "x".join(map(str, shapes[missed])), f"{count} row{'' if count == 1 else 's'}"
        found = f"'{missed}' of {file} has {shape} values, but the time has {rows}"
        raise DataError(f"{found}; give one value for each row")
    raw = with_breaks(headers, columns, remarks, column_units)
    return replace(raw, left_out=(*raw.left_out, *((f"left out: {', '.join(left_out)}",) if left_out else ())))


def table_of_matrix(file: str, array: AnyArray, config: DataConfig, remarks: tuple[str, ...]) -> RawTable:
    """Return the unnamed columns (N,) of a matrix (N, K), or of a vector (N,); raises DataError."""
    if array.ndim not in (1, 2) or not array.size:
        raise DataError(f"{file} holds an array of the shape {array.shape}; rows by columns of numbers are expected")
    columns = {str(place): column for place, column in enumerate(np.atleast_2d(array.T))}
    return named_by_place(table_of_arrays(file, columns, config, remarks))


def fields_of(name: str, array: AnyArray) -> dict[str, AnyArray]:
    """Return the fields of a structured array by name, any other array by its `name`.

    A nested field is called ``field.part``.
    """
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
        raise DataError(f"{file} holds arrays of shapes {shapes}; one-dimensional arrays of one length are expected")
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
        raise DataError(f"array '{name}' of {file} holds complex numbers; real numbers are expected")
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
    except Exception as error:  # damaged files raise many kinds of errors
        raise DataError(f"{path.name} is not an NPZ file of plain arrays; write one with numpy.savez") from error
    return table_of_arrays(path.name, arrays, config, ("NPZ",))


def read_npy(path: Path, config: DataConfig) -> RawTable:
    """Read a NumPy array: the fields of a structured array, or the unnamed columns of a matrix; raises DataError."""
    try:
        array = np.load(path, allow_pickle=False)
    except OSError:
        raise
    except Exception as error:  # damaged files raise many kinds of errors
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
    """Open an HDF5 file; yields the file and the module h5py.

    Raises DataError without h5py, and for any error in the file.
    """
    try:
        import h5py
    except ImportError:
        raise DataError(f"reading {path.name} needs h5py; run: pip install 'atoll[hdf5]'") from None
    try:
        with h5py.File(path, "r") as file:
            yield file, h5py
    except DataError:
        raise
    except Exception as error:  # damaged files raise many kinds of errors
        raise DataError(f"{path.name} cannot be read as an HDF5 file; save the file again, or as CSV") from error


def _refuse_elsewhere(name: str, path: str, item: Any) -> None:
    """Raise DataError if a dataset keeps its numbers in another file: it could name any file that the user may read."""
    if item.external or item.is_virtual:
        raise DataError(f"dataset '{path}' of {name} is kept in another file; write its numbers into {name}")


def _is_hidden(item: Any) -> bool:
    """Tell whether a dataset has no numbers, or only numbers that the file format itself needs."""
    if _text_of(item.attrs.get("NAME")).startswith("This is a netCDF dimension but not"):
        return True
    return item.dtype.kind not in "biufcSV" or item.ndim > 2 or item.size == 0


def _text_of(value: object) -> str:
    text = value.decode("utf-8", "replace") if isinstance(value, bytes) else value
    return str(text) if isinstance(text, str) else ""


# ------------------------------------------------------------------------------------------------------------- MATLAB


def read_matlab(path: Path, config: DataConfig) -> RawTable:
    """Read a MATLAB file; raises DataError.

    Columns of matrices are numbered from 1. Fields of structures are treated as arrays. In files of versions 5 to 7,
    the elements of a structure array or of a cell array are trajectories.
    """
    with path.open("rb") as file:
        beginning = file.read(_USER_BLOCK + len(_MAGIC))
    if beginning[:8] == _MAGIC or beginning[_USER_BLOCK:] == _MAGIC:
        (arrays, *runs), version = [_read_version_7_3(path)], "MATLAB 7.3"
    else:
        (arrays, *runs), version = _read_by_child(path, beginning), "MATLAB"
    if not runs:
        if not any(np.ndim(array) for array in arrays.values()):
            raise DataError(
                f"{path.name} holds no numeric arrays; save vectors or matrices, tables with table2struct and -v7"
            )
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
    """Return the arrays of a file, then the arrays of each run in it; a separate process reads them."""
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


def _read_version_7_3(path: Path) -> dict[str, AnyArray]:
    """Return the arrays of a file of version 7.3, matrices transposed.

    An array without numbers becomes a single empty text. In these files cells and structure arrays are references; they
    are not followed.
    """
    arrays: dict[str, AnyArray] = {}
    with _opened(path) as (file, h5py):

        def take(place: str, item: Any) -> None:
            if place.startswith("#") or not isinstance(item, h5py.Dataset):
                return
            _refuse_elsewhere(path.name, place, item)
            values = np.asarray(item[()])
            if values.dtype.names == ("real", "imag"):
                values = values["real"] + 1j * values["imag"]
            is_other = _text_of(item.attrs.get("MATLAB_class")) in ("char", "function_handle", "table")
            if is_other or item.attrs.get("MATLAB_empty") or values.dtype.kind not in "biufc":
                values = np.array("")  # the stored numbers of an empty array are its shape
            name = place.rpartition("/")[2]
            arrays[name if name not in arrays else place.replace("/", ".")] = np.squeeze(np.transpose(values))

        file.visititems(take)
    return arrays
