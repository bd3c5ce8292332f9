"""Arrays from the data that Python users pass in, with missing entries marked; polars or pandas frames and CSV for
output."""

import csv
import importlib
import io
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, Final, Literal, get_args

import numpy as np

from atoll_core.data.dataset import AnyArray
from atoll_core.errors import UsageError
from atoll_core.quoting import shown

if TYPE_CHECKING:
    import polars


_MISSING: Final[dict[str, object]] = {**dict.fromkeys("mM", "NaT"), **dict.fromkeys("biufc", np.nan)}
"""Values that mark a missing entry, by the kind of an array; other kinds use None."""


def plain_array(values: object) -> AnyArray:
    """Return `values` as an array without a mask: masked entries become NaN, NaT (dates and durations) or None (other
    types).

    A number under a mask, such as -9999, is not a measurement. Missing values of pandas (``NA``) are None as well.
    Raises ValueError where rows have different lengths.
    """
    array = np.asarray(values)
    if isinstance(values, np.ma.MaskedArray) and array.dtype.names is None:
        kind, mask = array.dtype.kind, np.ma.getmaskarray(values)
        if not mask.any():
            return array
        array = array.astype(np.float64 if kind in "biu" else array.dtype if kind in _MISSING else object)
        array[mask] = _MISSING.get(kind)
    elif array.dtype.kind == "O":
        mask = np.array([_is_na(cell) for cell in array.ravel().tolist()], dtype=bool).reshape(array.shape)
        if mask.any():
            array = array.copy()
            array[mask] = None
    return array


def _is_na(cell: object) -> bool:
    """Tell whether a cell is pandas' NA, whose comparisons are neither true nor false."""
    return type(cell).__name__ == "NAType"


FrameLibrary = Literal["polars", "pandas"]
_LIBRARIES: Final[tuple[str, ...]] = get_args(FrameLibrary)


def frame_of(columns: Mapping[str, object], library: FrameLibrary = "polars") -> "polars.DataFrame | Any":
    """Return columns of one length by name, arrays (N,) or lists, as a frame of a library.

    Raises UsageError if the library is neither polars nor pandas, or is not installed.
    """
    if library not in _LIBRARIES:
        raise UsageError(f"a frame is of {' or '.join(_LIBRARIES)}, but {shown(library)} was given")
    try:
        frames: Any = importlib.import_module(library)
    except ImportError:
        other = next(name for name in _LIBRARIES if name != library)
        install = {"polars": "'atoll[parquet]'", "pandas": "pandas"}[library]
        message = f'{library} is not installed; run: pip install {install}, or call to_frame("{other}")'
        raise UsageError(message) from None
    return frames.DataFrame(dict(columns))


def csv_of(columns: Mapping[str, Iterable[object]]) -> str:
    """Return columns (N,) of one length by name as CSV with a header; numbers have all digits."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*columns.values(), strict=True))
    return stream.getvalue()
