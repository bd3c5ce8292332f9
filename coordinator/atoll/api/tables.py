"""Tables from Python objects: files, frames of pandas or polars, data sets of xarray, arrays by name, records.

All objects except files become a `RawTable`. Its cells are read like the cells of files, with the same rules for
decimal commas, dates, names of trajectories, long tables, and columns that are left out.
"""

import contextlib
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final, Protocol, TypeGuard

import numpy as np

from atoll_coordinator.data.reading.arrays import fields_of, table_of_arrays, table_of_matrix
from atoll_coordinator.data.reading.cells import cell_of, parse_numbers
from atoll_coordinator.data.reading.dates import is_date
from atoll_coordinator.data.reading.files import convert_columns, read_table, table_of_parts
from atoll_coordinator.data.reading.raw_table import RawTable
from atoll_coordinator.data.reading.reshaping import TIME
from atoll_coordinator.data.reading.typed_formats import table_of_document, table_of_rows
from atoll_coordinator.data.roles.names_and_options import TIME_NAMES, split_unit
from atoll_core.config import DataConfig
from atoll_core.data.dataset import AnyArray, FloatArray
from atoll_core.data.frames import plain_array
from atoll_core.data.table import Table
from atoll_core.errors import AtollError, DataError, Field

_TLS: Final = re.compile(r"--tls-(ca|cert|key)(?: \(ATOLL_TLS_\w+\))?")
_WITH_NUMBER: Final = re.compile(r"--([a-z][a-z-]*)[ =](\d+)\b")
_COLUMN_OPTIONS: Final = "angle|group|hold|inputs|missing|states|target|time|trajectory|weights"
_WITH_COLUMN: Final = re.compile(rf"--({_COLUMN_OPTIONS}) (COLUMN\b|\w+(?:,\w+)*(?=[;,.)]|$| keeps))")
_QUOTED: Final = re.compile(rf"--({_COLUMN_OPTIONS}) '([^']+)'")
_OPTION: Final = re.compile(r"--([a-z][a-z-]*)")


def in_python(sentence: str) -> str:
    """Return a sentence with options replaced by keyword arguments: ``--max-size`` becomes max_size."""
    sentence = sentence.replace("--tls-...", "tls").replace("--missing drop", "missing='drop'")
    sentence = _TLS.sub(r"tls['\1']", sentence)
    sentence = _WITH_NUMBER.sub(lambda match: Field(match[1].replace("-", "_"), int(match[2])).in_python, sentence)
    for pattern in (_QUOTED, _WITH_COLUMN):
        sentence = pattern.sub(lambda match: Field(match[1], match[2]).in_python, sentence)
    return _OPTION.sub(lambda match: match[1].replace("-", "_"), sentence)


@contextlib.contextmanager
def python_words() -> Iterator[None]:
    """Raise the errors of a block with the names of Python arguments instead of options."""
    try:
        yield
    except AtollError as error:
        sentence = in_python(str(error))
        if sentence == str(error):
            raise
        reworded = type(error)(sentence)
        reworded.on_command_line = error.on_command_line
        raise reworded from error


_UNNAMED: Final = re.compile(r"Unnamed: \d+")
"""The name of a column without a name in pandas."""
NAME = "data"
"""The name of a table without a file, for messages."""


class _Frame(Protocol):
    """A frame of pandas or polars: columns by name."""

    @property
    def columns(self) -> Iterable[object]: ...

    def __getitem__(self, name: object) -> object: ...


_Columns = Mapping[str, object] | _Frame


def table_of(data: object, config: DataConfig) -> Table:
    """Return the table of files, of columns by name, of records, or of a list of these, one for each trajectory.

    Raises DataError if `data` has another type, or its columns have different lengths.
    """
    if isinstance(data, Table):
        return data
    given: list[object] = [*data] if isinstance(data, (list, tuple)) else [data]
    files = files_of(data)
    if files and len(files) == len(given):
        return read_table(files, config)
    if given and isinstance(data, (list, tuple)) and all(map(_is_record, given)):
        raws = [table_of_document(NAME, given, "records")]
    else:
        parts = [part for part in given if _has_columns(part)]
        if not given or len(parts) < len(given):
            raise DataError(
                "data must be a file, a frame of pandas or polars, a data set of xarray, arrays by column name, an "
                f"array of rows by columns, a list of these, or records; found {type(data).__name__}"
            )
        raws = [_cells_of(part, config) for part in parts]
    names = [NAME] if len(raws) == 1 else [f"{NAME}[{place}]" for place in range(len(raws))]
    columns = [convert_columns(name, raw, config) for name, raw in zip(names, raws, strict=True)]
    table = table_of_parts(columns, config)
    return replace(table, files=(NAME,), file_of_row=np.zeros_like(table.file_of_row))


def files_of(data: object) -> list[Path]:
    """Return the files among the given data."""
    given: list[object] = [*data] if isinstance(data, (list, tuple)) else [data]
    return [Path(part) for part in given if isinstance(part, (str, Path))]


def _is_record(part: object) -> bool:
    """Return whether `part` is a row of a table: single values by name."""
    return isinstance(part, Mapping) and bool(part) and all(np.ndim(value) == 0 for value in part.values())


def _has_columns(part: object) -> TypeGuard[_Columns]:
    if isinstance(part, np.ndarray):
        return part.dtype.names is not None or part.ndim == 2
    return isinstance(part, Mapping) or _is_frame(part)


def _cells_of(part: _Columns, config: DataConfig) -> RawTable:
    """Return the columns of a part as cells; an index that is not only a row number comes first."""
    if isinstance(part, np.ndarray) and part.dtype.names is None:
        return table_of_matrix(NAME, _array(part, "the array"), config, (_kind(part),))
    if isinstance(part, Mapping) and any(_is_frame(value) for value in part.values()):
        named = ", ".join(map(str, part))
        raise DataError(
            f"{NAME} is a dict of frames ({named}); give the frame with the measurements, or a list of frames"
        )
    columns = _named_arrays(part)
    if _has_header_among_rows(columns):
        return _with_header_of_rows(columns, _kind(part))
    index = {name: values for name, values in _index(part).items() if name not in columns}
    raw = table_of_arrays(NAME, {**index, **columns}, config, (_kind(part),))
    return replace(raw, headers=tuple(map(_plain, raw.headers)))


def _plain(header: str) -> str:
    """Return the name of a column without a comment sign: time for ``%time``, t for ``# t``."""
    name = header.lstrip("#% ").strip()
    return name if split_unit(name)[0] in TIME_NAMES else header.strip()


def _has_header_among_rows(columns: Mapping[str, AnyArray]) -> bool:
    """Return whether pandas has numbered the columns and they hold texts, so that the header is in a later row."""
    unnamed = [values for name, values in columns.items() if _UNNAMED.fullmatch(name)]
    filled = [next((cell for cell in values.tolist() if cell_of(cell)), None) for values in unnamed]
    return any(isinstance(cell, str) for cell in filled)


def _with_header_of_rows(columns: Mapping[str, AnyArray], kind: str) -> RawTable:
    """Return the table without the rows above its header, such as a title, which pandas has used as the header."""
    first = ["" if _UNNAMED.fullmatch(name) else name for name in columns]
    cells = [[*map(cell_of, values.tolist())] for values in columns.values()]
    rows = [first, *map(list, zip(*cells, strict=True))]
    raw = table_of_rows(NAME, [*enumerate(rows, start=1)])
    return replace(raw, remarks=(kind, *raw.remarks))


def _is_frame(value: object) -> bool:
    return hasattr(value, "columns") and hasattr(value, "__getitem__")


def _kind(part: _Columns) -> str:
    """Return the kind of a part, for the sentence on how data were read."""
    if isinstance(part, np.ndarray):
        return "a NumPy array"
    if isinstance(part, Mapping) and type(part).__module__ == "builtins":
        return "arrays by name"
    return f"{type(part).__name__} of {type(part).__module__.partition('.')[0]}"


def _named_arrays(part: _Columns) -> dict[str, AnyArray]:
    """Return the columns of a mapping, a frame, a structured array or an xarray data set; raises DataError."""
    kinds = [getattr(part, kind, None) for kind in ("coords", "data_vars")]
    variables = [kind for kind in kinds if isinstance(kind, Mapping)]
    if isinstance(part, np.ndarray):
        sources: list[tuple[object, object]] = [*fields_of("", part).items()]
    elif len(variables) == len(kinds):  # xarray
        sources = [pair for named in variables for pair in named.items()]
    else:
        sources = [*part.items()] if isinstance(part, Mapping) else [(name, part[name]) for name in part.columns]
    names = _names([name for name, _ in sources])
    repeated = next((name for name, count in Counter(names).items() if count > 1), None)
    if repeated is not None:
        raise DataError(f"{NAME} has {names.count(repeated)} columns named '{repeated}'; give each column its own name")
    return {name: _array(values, f"column '{name}'") for name, (_, values) in zip(names, sources, strict=True)}


def _names(labels: Sequence[object]) -> list[str]:
    """Return column labels as names: the last of several levels, or all levels if the last one is not unique."""
    levels = [[str(level) for level in label if str(level)] if isinstance(label, tuple) else [str(label)]
              for label in labels]  # fmt: skip
    counts = Counter(parts[-1] for parts in levels if parts)
    return [" ".join(parts if parts and counts[parts[-1]] > 1 else parts[-1:]) for parts in levels]


def _index(part: _Columns) -> dict[str, AnyArray]:
    """Return the index levels of a pandas frame that have a name, or hold values other than whole numbers.

    A level without a name is the time if it holds dates or durations; otherwise it gets a blank name and is ignored.
    """
    index = getattr(part, "index", None)
    if index is None or callable(index):
        return {}
    count = getattr(index, "nlevels", 1)
    levels = [index.get_level_values(level) for level in range(count)] if count > 1 else [index]
    named: dict[str, AnyArray] = {}
    for place, level in enumerate(levels):
        values, name = _array(level, "the index"), getattr(level, "name", None)
        if name is not None:
            named[str(name)] = values
        elif TIME not in named and (values.dtype.kind in "mM" or any(is_date(cell_of(cell)) for cell in values[:1])):
            named[TIME] = values
        elif values.dtype.kind not in "iu":
            named[" " * place] = values
    return named


def _array(values: object, name: str) -> AnyArray:
    """Return an array without a mask; raises DataError if rows have different lengths."""
    try:
        array = plain_array(values)
    except ValueError:
        array = None
    if array is None or (
        array.dtype.kind == "O" and any(isinstance(cell, (list, tuple, np.ndarray)) for cell in array.ravel())
    ):
        raise DataError(f"{name} holds rows of different lengths; rows of equal length are expected")
    return array


def numbers_of(given: object, name: str) -> FloatArray:
    """Return an array as numbers; durations become seconds, masked values and None become NaN.

    Texts are read like the cells of files, with one format for each column. `name` is for messages. Raises DataError
    for dates, complex numbers, or text that is not a number.
    """
    values = _array(given, name)
    if values.dtype.kind == "m":
        return np.asarray(values / np.timedelta64(1, "s"), dtype=np.float64)
    if values.dtype.kind == "M":
        raise DataError(f"{name} holds dates or times; convert it to numbers first")
    if values.dtype.kind == "c":
        raise DataError(f"{name} holds complex numbers; real numbers are expected")
    if values.dtype.kind in "biuf":
        return np.ascontiguousarray(values, dtype=np.float64)
    columns = values.reshape(len(values), -1).T if values.ndim else values.reshape(1, 1)
    cells = {str(place): [*map(cell_of, column.tolist())] for place, column in enumerate(columns, start=1)}
    numbers, _ = parse_numbers(name, cells, [0] * columns.shape[1], "")
    return np.ascontiguousarray(np.array([*numbers.values()]).T).reshape(values.shape)
