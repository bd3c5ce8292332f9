"""Columns as a data frame of polars, which Atoll comes with, or of pandas where it is installed."""

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

    Raises UsageError where the library is no such one, or is not installed.
    """
    if library not in _LIBRARIES:
        raise UsageError(f"frames are those of {' or '.join(_LIBRARIES)}, but {shown(library)} was given")
    if library == "polars":
        import polars

        return polars.DataFrame(dict(columns))
    try:
        import pandas
    except ImportError:
        hint = "pandas is not installed; run: pip install pandas, or call to_frame() for a frame of polars"
        raise UsageError(hint) from None
    return pandas.DataFrame(dict(columns))
