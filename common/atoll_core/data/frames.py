"""Columns as a data frame of polars or pandas, neither of which Atoll needs otherwise."""

import importlib
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final, Literal, get_args

from atoll_core.errors import UsageError
from atoll_core.quoting import shown

if TYPE_CHECKING:
    import polars

FrameLibrary = Literal["polars", "pandas"]
_LIBRARIES: Final[tuple[str, ...]] = get_args(FrameLibrary)


def frame_of(columns: Mapping[str, object], library: FrameLibrary = "polars") -> "polars.DataFrame | Any":
    """Return columns of one length by name, arrays (N,) or lists, as a frame of a library.

    Raises UsageError where the library is neither of them, or is not installed.
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
