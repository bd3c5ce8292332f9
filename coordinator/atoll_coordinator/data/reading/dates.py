"""Dates and clock times -> whole nanoseconds -> times in one unit; decides which text columns are dates. Pure.

A date is counted from 1970-01-01, a clock time from midnight, both without leap seconds. ISO dates, dates with names of
months and local dates are read. Whether ``03/04/2020`` begins with the day follows from the other dates of its column.
Nanoseconds are Python integers, because NumPy's dates of this precision end in 2262.
"""

import datetime
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final, Literal, NamedTuple

import numpy as np

from atoll_coordinator.data.reading.cells import is_missing, is_numeral, number, on_one_line, place
from atoll_coordinator.data.roles.names_and_options import TIME_NAMES, named_columns
from atoll_core.config import DataConfig
from atoll_core.data.dataset import FloatArray
from atoll_core.data.table import MIDNIGHT, Origin
from atoll_core.errors import DataError

NANOSECONDS: Final = {"d": 86_400_000_000_000, "h": 3_600_000_000_000, "min": 60_000_000_000, "s": 1_000_000_000}
"""Units of time in which dates are counted, the longest first."""
STAMPS: Final = "nanoseconds since 1970"

_UNIT_OF_NAME: Final = {
    name: unit
    for unit, names in {
        "d": "d day days",
        "h": "h hr hrs hour hours",
        "min": "min mins minute minutes",
        "s": "s sec secs second seconds",
    }.items()
    for name in names.split()
}
_SINCE: Final = re.compile(r"\s*(?P<unit>\w+)\s+since\s+(?P<origin>\S.*)", re.IGNORECASE)
_FINER: Final = {"milliseconds": "ms", "microseconds": "us", "nanoseconds": "ns"}
_EPOCH: Final = datetime.date(1970, 1, 1).toordinal()
_NAMES: Final = "january february march april may june july august september october november december"
MONTHS: Final = {
    name: number for number, month in enumerate(_NAMES.split(), start=1) for name in (month, month[:3], month[:4])
}
"""The number of a month by its name in lower case, or by the first three or four letters of its name."""
_CLOCK: Final = (
    r"(?:(?P<days>\d+) days?,? )?(?P<hour>\d{1,4}):(?P<minute>\d\d)(?::(?P<second>\d\d))?(?:[.,](?P<part>\d+))?"
    r"(?: ?(?P<half>[AaPp])\.?[Mm]\.?)?"
)
_ZONE: Final = r"(?: ?(?P<zone>Z|UTC|GMT|[+-]\d\d(?::?\d\d)?))?"
_DATES: Final = (
    ("year-month-day", r"(?P<year>\d{4})[-/.](?P<month>\d{1,2})(?:[-/.](?P<day>\d{1,2}))?"),
    ("", r"(?P<one>\d{1,2})(?P<mark>[-/.])(?P<two>\d{1,2})(?P=mark)(?P<year>\d{4}|\d\d)"),
    ("day month year", r"(?P<day>\d{1,2})\.?[ -]?(?P<name>[A-Za-z]{3,9})\.?,?[ -](?P<year>\d{4}|\d\d)"),
    ("month day year", r"(?P<name>[A-Za-z]{3,9})\.? (?P<day>\d{1,2}),? (?P<year>\d{4})"),
)
"""Forms of dates; for numbers only, the order of day and month follows from the whole column."""
_CLOCK_FORM: Final = re.compile(_CLOCK)
_FORMS: Final = (
    ("clock time", _CLOCK_FORM),
    *((form, re.compile(rf"{date}(?:(?:[T ]|, ?)\s*{_CLOCK}{_ZONE})?")) for form, date in _DATES),
)
_COMPACT: Final = re.compile(r"(1[89]\d\d|2[01]\d\d)(0[1-9]|1[0-2])(0[1-9]|[12]\d|3[01])")
_STAMP: Final = re.compile(r"[1-8]\d{18}")
"""Nanoseconds since 1970, from 2001 to 2255. They have 19 digits; other times are no whole numbers of this length,
since a float cannot hold them."""
_Match = re.Match[str]
_Kind = Literal["clock", "date", "both"]


@dataclass(frozen=True)
class Dates:
    """Dates or clock times of the rows of a column, in nanoseconds, None where missing.

    `form` is how the dates are written; `has_date` is true for dates, counted from 1970-01-01, and false for clock
    times, counted from midnight. `has_clock` tells whether any date has a clock time. `is_utc` tells whether the dates
    had time zones; their offsets have been subtracted.
    """

    nanoseconds: tuple[int | None, ...]
    form: str
    has_date: bool
    has_clock: bool = True
    is_utc: bool = False


class DateColumns(NamedTuple):
    """Columns of dates and clock times by their name in the file.

    `renamed` has the new name of a column that was recognised as the time without an option. `absorbed` is a column of
    dates, or of clock times, that was merged into another column.
    """

    values: Mapping[str, Dates]
    renamed: Mapping[str, str]
    absorbed: str | None


def split_origin(unit: str) -> tuple[str, str]:
    """Split ``hours since 2020-01-01``, as netCDF writes the units of times, into unit and origin ("" for none)."""
    match = _SINCE.fullmatch(unit)
    known = None if match is None else (_UNIT_OF_NAME | _FINER).get(match["unit"].lower())
    return (unit, "") if match is None or known is None else (known, match["origin"].strip())


def is_date(cell: str) -> bool:
    """Tell whether `cell` has the form of a date or a clock time."""
    return _form(on_one_line(cell)) is not None


def is_datum(cell: str) -> bool:
    """Tell whether `cell` holds a number, a date or a clock time."""
    return is_numeral(cell) or is_date(cell)


def ascends(cells: Sequence[str], starts: Sequence[int]) -> bool:
    """Tell whether cells hold dates, or numbers that always increase between two of the `starts`, as times do."""
    if is_date(cells[0]):
        return True
    numbers = [number(cell.replace(",", ".")) for cell in cells]
    pairs = [pair for row, pair in enumerate(pairwise(numbers), start=1) if row not in starts]
    return bool(pairs) and all(one is not None and other is not None and one < other for one, other in pairs)


def _form(text: str) -> tuple[str, re.Pattern[str]] | None:
    for form, pattern in _FORMS:
        match = pattern.fullmatch(text)
        if match is not None and match.groupdict().get("name", "may").lower() in MONTHS:
            return form, pattern
    return None


# ---------------------------------------------------------------------------------------------- which columns are dates


def read_date_columns(
    file: str,
    texts: Mapping[str, Sequence[str]],
    names: Sequence[str],
    starts: Sequence[int],
    lines: Sequence[int],
    config: DataConfig,
) -> DateColumns:
    """Return the columns of dates and clock times that options name, or that may be the time.

    `texts` are the cells of the text columns, without the names of trajectories; `names` are all columns; `starts` are
    the rows at which trajectories begin; `file` and the line numbers `lines` are for messages. Raises DataError if a
    date cannot be read, or can be read in two ways.
    """
    kinds = {name: kind for name, cells in texts.items() if (kind := _kind(cells)) is not None}
    needed = named_columns(config)
    free = [name for name in kinds if name not in needed]
    time_column = config.time if config.time in kinds else _unnamed_time(kinds, free, names, texts, config)
    absorbed = None
    if time_column is not None and kinds[time_column] != "both":  # one column of dates and one of clock times
        lacking = "date" if kinds[time_column] == "clock" else "clock"
        fitting = [name for name in free if kinds[name] == lacking]
        absorbed = fitting[0] if len(fitting) == 1 else None
    values = {
        name: read_dates(f"column '{name}' of {file}", texts[name], starts, lines)
        for name in kinds
        if name in needed or name in (time_column, absorbed)
    }
    if time_column is not None and absorbed is not None:
        parts = {kinds[time_column]: values[time_column], kinds[absorbed]: values.pop(absorbed)}
        values[time_column] = with_clock(parts["date"], parts["clock"])
    new = next((name for name in ("time", "t") if name not in names), None)
    is_called_so = time_column is None or time_column in (config.time, *TIME_NAMES) or new is None
    return DateColumns(values, {} if is_called_so else {str(time_column): str(new)}, absorbed)


def _kind(cells: Sequence[str]) -> _Kind | None:
    first = on_one_line(next((cell for cell in cells if not is_missing(cell)), ""))
    if _form(first) is None:
        return None
    if _CLOCK_FORM.fullmatch(first):
        return "clock"
    return "both" if ":" in first else "date"


def _unnamed_time(
    kinds: Mapping[str, _Kind],
    free: Sequence[str],
    names: Sequence[str],
    texts: Mapping[str, object],
    config: DataConfig,
) -> str | None:
    """Return the column of dates that is the time although no option names it; None if this is not clear."""
    is_given = config.time is not None or config.target is not None or config.derivatives is not None
    if is_given or any(name in names and name not in texts for name in TIME_NAMES):
        return None
    called = [name for name in free if name in TIME_NAMES]
    if called or len(free) == 1:
        return (called or free)[0]
    is_pair = {kinds[name] for name in free} == {"clock", "date"} and len(free) == 2
    return next(name for name in free if kinds[name] == "clock") if is_pair else None


def compact_dates(columns: Mapping[str, Sequence[str]], config: DataConfig) -> dict[str, list[str]]:
    """Return dates such as ``20210331`` as year-month-day: in columns called `date`, or in the time column."""
    return {
        name: [_COMPACT.sub(r"\1-\2-\3", cell.strip()) for cell in cells]
        for name, cells in columns.items()
        if (name in (config.time, *TIME_NAMES) or name.lower() == "date") and _all_match(_COMPACT, cells)
    }


def time_stamps(
    columns: Mapping[str, Sequence[str]], units: Mapping[str, str], config: DataConfig
) -> dict[str, list[str]]:
    """Return whole nanoseconds since 1970, as robots and databases write them, as dates.

    Columns with `units`, and columns to which options give another role than the time, stay numbers.
    """
    others = named_columns(config) - {config.time} | {*config.units}
    return {
        name: [
            cell if is_missing(cell) else f"{_moment(int(cell[:-9]))}.{cell[-9:]}Z" for cell in map(str.strip, cells)
        ]
        for name, cells in columns.items()
        if name not in others and not units.get(name) and _all_match(_STAMP, cells)
    }


def _moment(seconds: int) -> datetime.datetime:
    return datetime.datetime(1970, 1, 1) + datetime.timedelta(seconds=seconds)


def _all_match(pattern: re.Pattern[str], cells: Sequence[str]) -> bool:
    known = [cell.strip() for cell in cells if not is_missing(cell)]
    return bool(known) and all(map(pattern.fullmatch, known))


# ------------------------------------------------------------------------------------------------ one column of dates


def read_dates(column: str, cells: Sequence[str], starts: Sequence[int], lines: Sequence[int]) -> Dates:
    """Return the dates of a column whose first cell that is not missing has the form of a date or clock time.

    `starts` are the rows at which trajectories begin; messages call the column ``column 't' of a.csv`` and name the
    lines of cells. Raises DataError if a cell has another form or holds no date, or if day and month cannot be
    distinguished.
    """
    texts = ["" if is_missing(cell) else on_one_line(cell) for cell in cells]
    first = next(text for text in texts if text)
    known_form = _form(first)
    assert known_form is not None
    form, pattern = known_form
    is_clock = pattern is _CLOCK_FORM
    matches = [pattern.fullmatch(text) if text else None for text in texts]
    for row, (text, match) in enumerate(zip(texts, matches, strict=True)):
        if text and match is None:
            raise DataError(f"{column} holds '{text}' in {place(lines, row)}, which is not written as '{first}' is")
        if match is not None and is_clock and match["second"] is None and (match["part"] or int(match["hour"]) > 24):
            raise DataError(f"{column} holds '{text}', which may be minutes and seconds; write hours:minutes:seconds")
    present = [match for match in matches if match is not None]
    zones = {not is_clock and match["zone"] is not None for match in present}
    if len(zones) > 1:
        raise DataError(f"{column} gives a time zone in some rows only; give it in all or in none")
    form = form or _day_month_order(column, matches, starts)
    values: list[int | None] = []
    for row, match in enumerate(matches):
        try:
            values.append(match and (_clock(match) if is_clock else _date(match, form)))
        except ValueError:
            raise DataError(
                f"{column} holds '{texts[row]}' in {place(lines, row)}, which is not a date or time"
            ) from None
    if is_clock:
        return Dates(_add_days_after_midnight(values, starts), "clock times", has_date=False)
    has_clock = any(match["hour"] is not None for match in present)
    return Dates(tuple(values), f"dates {form}", has_date=True, has_clock=has_clock, is_utc=zones == {True})


def _clock(match: _Match) -> int:
    hour, minute, second = (int(match[part] or 0) for part in ("hour", "minute", "second"))
    if match["half"]:
        if not 1 <= hour <= 12:
            raise ValueError(match[0])
        hour = hour % 12 + (12 if match["half"] in "pP" else 0)
    if minute > 59 or second > 60 or (match["part"] and match["second"] is None):
        raise ValueError(match[0])
    whole = ((int(match["days"] or 0) * 24 + hour) * 60 + minute) * 60 + second
    return whole * NANOSECONDS["s"] + int((match["part"] or "0").ljust(9, "0")[:9])


def _date(match: _Match, form: str) -> int:
    """Return the nanoseconds since 1970-01-01; raises ValueError."""
    parts = match.groupdict()
    day, month = parts.get("day") or "1", parts.get("month")
    if "one" in parts:
        day, month = (parts["one"], parts["two"]) if form.startswith("day") else (parts["two"], parts["one"])
    month_number = int(month) if month is not None else MONTHS.get(match["name"].lower(), 0)  # no date has a month 0
    year = int(match["year"])
    if len(match["year"]) == 2:  # by the POSIX rule: years from 1969 to 2068
        year += 1900 if year >= 69 else 2000
    midnight = (datetime.date(year, month_number, int(day)).toordinal() - _EPOCH) * NANOSECONDS["d"]
    if match["hour"] is None:
        return midnight
    if match["half"] is None and int(match["hour"]) > 24:
        raise ValueError(match[0])
    ahead, zone = 0, match["zone"] or ""
    if zone[:1] in ("+", "-"):
        digits = zone[1:].replace(":", "").ljust(4, "0")
        ahead = int(f"{zone[0]}1") * (int(digits[:2]) * 60 + int(digits[2:])) * NANOSECONDS["min"]
    return midnight + _clock(match) - ahead


def _day_month_order(column: str, matches: Sequence[_Match | None], starts: Sequence[int]) -> str:
    """Return whether day or month comes first; dots, numbers above 12 and ascending dates decide, in this order."""
    present = [match for match in matches if match is not None]
    mark = present[0]["mark"]
    forms = [mark.join(parts) for parts in (("day", "month", "year"), ("month", "day", "year"))]
    if mark == "." or any(int(match["one"]) > 12 for match in present):
        return forms[0]
    if any(int(match["two"]) > 12 for match in present):
        return forms[1]
    readings = [[match and _date(match, form) for match in matches] for form in forms]
    ascending = [
        form for form, values in zip(forms, readings, strict=True) if all(step > 0 for step in _steps(values, starts))
    ]
    if len(ascending) == 1:
        return ascending[0]
    pairs = zip(*readings, strict=True)
    if len({one - other for one, other in pairs if one is not None and other is not None}) == 1:
        return f"{forms[0]} (or {forms[1]}: all are of one day)"
    raise DataError(
        f"{column} holds '{present[0][0]}', which may be {forms[0]} or {forms[1]}, and its other rows do not decide; "
        "write dates as year-month-day"
    )


def _steps(values: Sequence[int | None], starts: Sequence[int]) -> Iterator[int]:
    """Yield the steps from each value that is not missing to the next one, along each trajectory."""
    for first, last in zip(starts, (*starts[1:], len(values)), strict=True):
        for one, other in pairwise(value for value in values[first:last] if value is not None):
            yield other - one


def _add_days_after_midnight(values: Sequence[int | None], starts: Sequence[int]) -> tuple[int | None, ...]:
    """Where a clock time falls by more than half a day, add a day to this row and the rest of its trajectory."""
    day, added, last = NANOSECONDS["d"], 0, None
    counted: list[int | None] = []
    begins = set(starts)
    for row, value in enumerate(values):
        if row in begins:
            added, last = 0, None
        if value is not None:
            added += day if last is not None and 2 * (last - value) > day else 0
            last = value
        counted.append(None if value is None else value + added)
    return tuple(counted)


def with_clock(dates: Dates, clocks: Dates) -> Dates:
    """Return a column of dates and a column of clock times as one column."""
    pairs = zip(dates.nanoseconds, clocks.nanoseconds, strict=True)
    values = tuple(None if date is None or clock is None else date + clock % NANOSECONDS["d"] for date, clock in pairs)
    return replace(dates, nanoseconds=values, has_clock=True, form=f"{dates.form} and clock times")


def times_of(columns: Sequence[Dates], starts: Sequence[int], unit: str | None) -> tuple[FloatArray, str, str, Origin]:
    """Return the times (N,) of one column over all files read together, their unit, a remark, their origin.

    `columns` are the dates in each file, of one kind; `starts` the rows at which trajectories begin, counted over all
    files. Without a `unit`, the unit is the longest of days, hours, minutes and seconds that does not exceed the median
    step between rows. Raises DataError if no date is known, or if `unit` is no unit of dates.
    """
    if unit is not None and unit not in _UNIT_OF_NAME:
        raise DataError(f"dates are counted in {', '.join(NANOSECONDS)}, but '{unit}' is wanted; choose one of these")
    values = [value for column in columns for value in column.nanoseconds]
    first = next((value for value in values if value is not None), None)
    if first is None:
        raise DataError("a column of dates holds no date; correct it")
    if unit is None:
        steps = sorted(abs(step) for step in _steps(values, starts) if step)
        median = steps[len(steps) // 2] if steps else 0
        unit = next((name for name, length in NANOSECONDS.items() if length <= median), "s")
    length = NANOSECONDS[_UNIT_OF_NAME[unit]]
    since, zero = (_written(first, columns[0]), first) if columns[0].has_date else (MIDNIGHT, 0)
    times = [math.nan if value is None else (value - zero) / length for value in values]
    remark = f"{columns[0].form}, in {unit} since {since}"
    return np.array(times, dtype=np.float64), unit, remark, Origin(since, length / NANOSECONDS["s"])


def _written(origin: int, column: Dates) -> str:
    seconds, part = divmod(origin, NANOSECONDS["s"])
    moment = _moment(seconds)
    if not column.has_clock:
        return moment.date().isoformat()
    fraction = f".{part:09}".rstrip("0") if part else ""
    return f"{moment.isoformat(' ')}{fraction}{' UTC' if column.is_utc else ''}"
