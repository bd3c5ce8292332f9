"""Parquet files -> `RawTable`, by polars, an extra: ``pip install 'atoll[parquet]'``."""

from pathlib import Path
from typing import TYPE_CHECKING

from atoll_coordinator.data.reading.cells import cell_of
from atoll_coordinator.data.reading.raw_table import RawTable, with_breaks
from atoll_core.errors import DataError

if TYPE_CHECKING:
    import polars


def read_parquet(path: Path) -> RawTable:
    """Read a Parquet file; raises DataError."""
    try:
        import polars
    except ImportError:
        raise DataError(f"reading {path.name} needs polars; run: pip install 'atoll[parquet]'") from None
    try:
        frame = polars.read_parquet(path)
    except (polars.exceptions.PolarsError, polars.exceptions.PanicException) as error:
        raise DataError(f"{path.name} is not a Parquet file that can be read; write it anew, or as CSV") from error
    read = [_cells(path.name, series) for series in frame.get_columns()]
    return with_breaks(frame.columns, [cells for cells, _ in read], ("Parquet",), [unit for _, unit in read])


def _cells(file: str, series: "polars.Series") -> tuple[list[str], str]:
    """Return the cells of a column, and the unit of durations."""
    import polars

    kind = series.dtype
    if kind.is_nested():
        raise DataError(f"column '{series.name}' of {file} holds lists or structures; write one number a cell")
    if isinstance(kind, polars.Duration):
        return _texts(series.dt.total_nanoseconds() / 1e9), "s"
    if isinstance(kind, polars.Datetime) and kind.time_zone is not None:
        return _texts(series.dt.convert_time_zone("UTC").dt.to_string("%F %T%.fZ")), ""
    if isinstance(kind, polars.Datetime):
        return _texts(series.dt.to_string("%F %T%.f")), ""
    if kind.is_numeric() or isinstance(kind, polars.Boolean):
        return _texts(series.cast(polars.Float64)), ""
    return _texts(series.cast(polars.String, strict=False)), ""


def _texts(series: "polars.Series") -> list[str]:
    return [cell_of(value) for value in series.to_list()]
