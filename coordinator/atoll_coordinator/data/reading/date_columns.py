"""Which columns of text are read as dates and clock times: those that are named, and what can be the time. Pure."""

import datetime
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Final, Literal, NamedTuple

from atoll_coordinator.data.reading.cells import is_missing
from atoll_coordinator.data.reading.dates import NANOSECONDS, Dates, is_clock, is_date, read_dates, with_clock
from atoll_coordinator.data.roles.column_options import named_columns
from atoll_coordinator.data.roles.time_column import TIME_NAMES
from atoll_core.config import DataConfig

_NEW_NAMES: Final = ("time", "t")
_COMPACT: Final = re.compile(r"(1[89]\d\d|2[01]\d\d)(0[1-9]|1[0-2])(0[1-9]|[12]\d|3[01])")
_STAMP: Final = re.compile(r"[1-8]\d{18}")
"""Nanoseconds since 1970, from 2001 to 2255: no other times are whole numbers of 19 digits, which no float holds."""
STAMPS: Final = "nanoseconds since 1970"
_Kind = Literal["clock", "date", "both"]


class DateColumns(NamedTuple):
    """Columns of dates and clock times by their name in the file.

    `renamed` has the one that nobody has named, and what it is called so that it is found to be the time; `absorbed` is
    a column of dates, or of clock times, that has become part of another one.
    """

    values: Mapping[str, Dates]
    renamed: Mapping[str, str]
    absorbed: str | None


def read_date_columns(
    file: str,
    texts: Mapping[str, Sequence[str]],
    names: Sequence[str],
    starts: Sequence[int],
    config: DataConfig,
    where: Callable[[int], str],
) -> DateColumns:
    """Return the columns of dates and clock times among the columns of text of one file.

    `texts` are the cells of columns that hold text alone and are not the trajectories' names, `names` those of all
    columns; `starts` are rows at which trajectories begin; `file` and `where`, which says where a row stands, are for
    messages. Raises DataError where a date cannot be read, or may be two.
    """
    kinds: dict[str, _Kind] = {name: kind for name, cells in texts.items() if (kind := _kind(cells)) is not None}
    needed = named_columns(config)
    free = [name for name in kinds if name not in needed]
    time_column = config.time if config.time in kinds else _candidate(kinds, free, names, texts, config)
    wanted = [name for name in kinds if name in needed or name == time_column]
    other = None if time_column is None else _other_half(time_column, kinds, free)
    values = {
        name: read_dates(f"column '{name}' of {file}", texts[name], starts, where)
        for name in (*wanted, *([] if other is None else [other]))
    }
    if time_column is not None and other is not None:
        halves = values.pop(other), values[time_column]
        values[time_column] = with_clock(*(halves if kinds[other] == "date" else halves[::-1]))
    new = next((name for name in _NEW_NAMES if name not in names), None)
    if time_column is None or time_column in (config.time, *TIME_NAMES) or new is None:
        return DateColumns(values, {}, other)
    return DateColumns(values, {time_column: new}, other)


def compact_dates(columns: Mapping[str, Sequence[str]], config: DataConfig) -> dict[str, list[str]]:
    """Return dates without marks, as ``20210331``, as year-month-day: of columns called so, or that are the time."""
    return {
        name: [_COMPACT.sub(r"\1-\2-\3", cell.strip()) for cell in cells]
        for name, cells in columns.items()
        if (name in (config.time, *TIME_NAMES) or name.lower() == "date")
        and not all(map(is_missing, cells))
        and all(is_missing(cell) or _COMPACT.fullmatch(cell.strip()) for cell in cells)
    }


def time_stamps(
    columns: Mapping[str, Sequence[str]], units: Mapping[str, str], config: DataConfig
) -> dict[str, list[str]]:
    """Return whole nanoseconds since 1970, as robots and data bases write them, as dates.

    Those of columns with `units`, or that options name for anything else than the time, stay numbers.
    """
    named = named_columns(config) - {config.time}
    return {
        name: [_date_of_stamp(cell.strip()) for cell in cells]
        for name, cells in columns.items()
        if name not in named and not units.get(name) and name not in config.units
        if not all(map(is_missing, cells))
        if all(is_missing(cell) or _STAMP.fullmatch(cell.strip()) for cell in cells)
    }


def _date_of_stamp(cell: str) -> str:
    if is_missing(cell):
        return cell
    seconds, nanoseconds = divmod(int(cell), NANOSECONDS["s"])
    moment = datetime.datetime(1970, 1, 1) + datetime.timedelta(seconds=seconds)
    return f"{moment:%Y-%m-%dT%H:%M:%S}.{nanoseconds:09}Z"


def _kind(cells: Sequence[str]) -> _Kind | None:
    """Return what the first cell that is there has the form of."""
    first = next((cell for cell in cells if not is_missing(cell)), "")
    if not is_date(first):
        return None
    if is_clock(first):
        return "clock"
    return "both" if ":" in first else "date"


def _candidate(
    kinds: Mapping[str, _Kind],
    free: Sequence[str],
    names: Sequence[str],
    texts: Mapping[str, object],
    config: DataConfig,
) -> str | None:
    """Return the column of dates that is the time though nobody has said so; None where that is not clear."""
    is_given = config.time is not None or config.target is not None or config.derivatives is not None
    if is_given or any(name in names and name not in texts for name in TIME_NAMES):
        return None
    called = [name for name in free if name in TIME_NAMES]
    if called or len(free) == 1:
        return (called or free)[0]
    is_pair = {kinds[name] for name in free} == {"clock", "date"} and len(free) == 2
    return next(name for name in free if kinds[name] == "clock") if is_pair else None


def _other_half(time_column: str, kinds: Mapping[str, _Kind], free: Sequence[str]) -> str | None:
    """Return the only column of dates that goes with clock times, or the reverse."""
    lacking = {"clock": "date", "date": "clock", "both": None}[kinds[time_column]]
    fitting = [name for name in free if kinds[name] == lacking]
    return fitting[0] if len(fitting) == 1 else None
