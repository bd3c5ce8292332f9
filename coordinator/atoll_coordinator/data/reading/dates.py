"""Dates and clock times -> whole nanoseconds; these -> times in one unit. Pure.

A date is counted from 1970-01-01, a clock time from midnight, both without leap seconds. ISO dates, dates with names of
months, and local ones are read; whether ``03/04/2020`` begins with the day is told by the other dates of the column.
"""

import datetime
import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt

from atoll_coordinator.data.reading.cells import is_missing, is_numeral, number, on_one_line
from atoll_core.data.dataset import FloatArray
from atoll_core.data.table import MIDNIGHT, Origin
from atoll_core.errors import DataError

NANOSECONDS: Final = {"d": 86_400_000_000_000, "h": 3_600_000_000_000, "min": 60_000_000_000, "s": 1_000_000_000}
"""Units of time that dates are counted in, the longest first."""

_CALLED: Final = {
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
"""The number of a month by its name, in lower case, or the first three or four letters of it."""
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
"""Forms of dates; the one without a name is resolved by the column."""
_CLOCK_FORM: Final = re.compile(_CLOCK)
_FORMS: Final = (
    ("clock time", _CLOCK_FORM),
    *((form, re.compile(rf"{date}(?:(?:[T ]|, ?)\s*{_CLOCK}{_ZONE})?")) for form, date in _DATES),
)
_Match = re.Match[str]


@dataclass(frozen=True)
class Dates:
    """Dates or clock times of the rows of a column, in nanoseconds, None where missing.

    `form` is how they are written; `has_date` says whether they are counted from 1970-01-01, else from midnight;
    `has_clock` whether any of them has a clock time; `is_utc` whether zones were given, and taken off.
    """

    nanoseconds: tuple[int | None, ...]
    form: str
    has_date: bool
    has_clock: bool = True
    is_utc: bool = False


def split_origin(unit: str) -> tuple[str, str]:
    """Split ``hours since 2020-01-01``, as netCDF writes the units of times, into unit and origin, "" for none."""
    match = _SINCE.fullmatch(unit)
    known = None if match is None else (_CALLED | _FINER).get(match["unit"].lower())
    return (unit, "") if match is None or known is None else (known, match["origin"].strip())


def is_date(cell: str) -> bool:
    """Tell whether `cell` has the form of a date or a clock time."""
    return _form(on_one_line(cell)) is not None


def is_datum(cell: str) -> bool:
    """Tell whether `cell` holds a number, a date or a clock time."""
    return is_numeral(cell) or is_date(cell)


def ascends(cells: Sequence[str], starts: Sequence[int]) -> bool:
    """Tell whether cells hold dates, or numbers that only grow from one of `starts` to the next, as times do."""
    if is_date(cells[0]):
        return True
    numbers = [number(cell.replace(",", ".")) for cell in cells]
    pairs = [pair for place, pair in enumerate(pairwise(numbers), start=1) if place not in starts]
    return bool(pairs) and all(one is not None and other is not None and one < other for one, other in pairs)


def is_clock(cell: str) -> bool:
    """Tell whether `cell` has the form of a clock time alone."""
    return _CLOCK_FORM.fullmatch(on_one_line(cell)) is not None


def _form(text: str) -> tuple[str, re.Pattern[str]] | None:
    for form, pattern in _FORMS:
        match = pattern.fullmatch(text)
        if match is not None and match.groupdict().get("name", "may").lower() in MONTHS:
            return form, pattern
    return None


def read_dates(column: str, cells: Sequence[str], starts: Sequence[int], where: Callable[[int], str]) -> Dates:
    """Return the dates in the cells of a column, whose first cell that is there has the form of a date or clock time.

    `starts` are the rows at which trajectories begin; messages call the column ``column 't' of a.csv``, and `where`
    says where a row stands. Raises DataError where a cell has another form or holds no such date, or day and month
    cannot be told apart.
    """
    texts = ["" if is_missing(cell) else on_one_line(cell) for cell in cells]
    first = next(text for text in texts if text)
    first_form = _form(first)
    assert first_form is not None
    form, pattern = first_form
    matches = [pattern.fullmatch(text) if text else None for text in texts]
    for row, (text, match) in enumerate(zip(texts, matches, strict=True)):
        if text and match is None:
            raise DataError(f"{column} holds '{text}' in {where(row)}, which is not written as '{first}' is")
    if pattern is _CLOCK_FORM:
        _check_hours(column, matches)
        return Dates(
            _past_midnight(_read_matches(matches, _clock, column, where), starts), "clock times", has_date=False
        )
    zones = {match["zone"] is not None for match in matches if match is not None}
    if len(zones) > 1:
        raise DataError(f"{column} gives a time zone in some rows only; give it in all or in none")
    if not form:
        form = _order(column, matches, starts)
    values = _read_matches(matches, lambda match: _date(match, form), column, where)
    has_clock = any(match is not None and match["hour"] is not None for match in matches)
    return Dates(tuple(values), f"dates {form}", has_date=True, has_clock=has_clock, is_utc=zones == {True})


def _read_matches(
    matches: Sequence[_Match | None], read: Callable[[_Match], int], column: str, where: Callable[[int], str]
) -> list[int | None]:
    values: list[int | None] = []
    for row, match in enumerate(matches):
        try:
            values.append(match and read(match))
        except ValueError:
            raise DataError(
                f"{column} holds '{match and match[0]}' in {where(row)}, which is no date or time"
            ) from None
    return values


def _check_hours(column: str, matches: Sequence[_Match | None]) -> None:
    """Refuse ``45:10`` and ``05:10.5``, which may be minutes and seconds."""
    for match in matches:
        if match is not None and match["second"] is None and (match["part"] or int(match["hour"]) > 24):
            raise DataError(
                f"{column} holds '{match[0]}', which may be minutes and seconds; write hours:minutes:seconds"
            )


def _clock(match: _Match) -> int:
    """Return the nanoseconds since midnight, or of a duration; raises ValueError."""
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
    if "one" in parts:
        day, month = (match["one"], match["two"]) if form.startswith("day") else (match["two"], match["one"])
    else:
        day, month = match["day"] or "1", parts.get("month")
    # no month is number 0, for which there is no date
    number = int(month) if month is not None else MONTHS.get(match["name"].lower(), 0)
    year = int(match["year"])
    if len(match["year"]) == 2:  # by the rule of POSIX from 1969 to 2068
        year += 1900 if year >= 69 else 2000
    days = datetime.date(year, number, int(day)).toordinal() - _EPOCH
    if match["hour"] is None:
        return days * NANOSECONDS["d"]
    if match["half"] is None and int(match["hour"]) > 24:
        raise ValueError(match[0])
    return days * NANOSECONDS["d"] + _clock(match) - _offset(match["zone"])


def _offset(zone: str | None) -> int:
    """Return how far a zone is ahead of UTC."""
    if zone is None or zone[0] not in "+-":
        return 0
    digits = zone[1:].replace(":", "").ljust(4, "0")
    minutes = int(digits[:2]) * 60 + int(digits[2:])
    return (-minutes if zone[0] == "-" else minutes) * NANOSECONDS["min"]


def _order(column: str, matches: Sequence[_Match | None], starts: Sequence[int]) -> str:
    """Return whether day or month comes first: by dots, by numbers above 12, by which of both orders ascends."""
    present = [match for match in matches if match is not None]
    mark = present[0]["mark"]
    forms = [mark.join(parts) for parts in (("day", "month", "year"), ("month", "day", "year"))]
    if mark == ".":
        return forms[0]
    if any(int(match["one"]) > 12 for match in present):
        return forms[0]
    if any(int(match["two"]) > 12 for match in present):
        return forms[1]
    dates_by_form = [[match and _date(match, form) for match in matches] for form in forms]
    ascending = [
        form
        for form, values in zip(forms, dates_by_form, strict=True)
        if all(step > 0 for step in _steps(values, starts))
    ]
    if len(ascending) == 1:
        return ascending[0]
    pairs = zip(*dates_by_form, strict=True)
    if len({one - other for one, other in pairs if one is not None and other is not None}) == 1:
        return f"{forms[0]} (or {forms[1]}: all are of one day)"
    raise DataError(
        f"{column} holds '{present[0][0]}', which may be {forms[0]} or {forms[1]}, and its other rows do not tell; "
        "write dates as year-month-day"
    )


def _steps(values: Sequence[int | None], starts: Sequence[int]) -> Iterator[int]:
    """Yield the steps from one value to the next that is there, along each trajectory."""
    for first, last in zip(starts, (*starts[1:], len(values)), strict=True):
        for one, other in pairwise(value for value in values[first:last] if value is not None):
            yield other - one


def _past_midnight(values: Sequence[int | None], starts: Sequence[int]) -> tuple[int | None, ...]:
    """Go on counting where a clock falls back by more than half a day within a trajectory."""
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
    """Return a column of dates and one of clock times as one."""
    pairs = zip(dates.nanoseconds, clocks.nanoseconds, strict=True)
    values = tuple(None if date is None or clock is None else date + clock % NANOSECONDS["d"] for date, clock in pairs)
    return replace(dates, nanoseconds=values, has_clock=True, form=f"{dates.form} and clock times")


def dates_of_array(values: npt.NDArray[np.datetime64]) -> Dates:
    """Return the dates of an array (N,)."""
    days = values.astype("M8[D]")
    rest = (values - days).astype("m8[ns]").astype(np.int64).tolist()
    parts = zip(days.astype(np.int64).tolist(), rest, np.isnat(values).tolist(), strict=True)
    nanoseconds = tuple(None if is_nat else date * NANOSECONDS["d"] + part for date, part, is_nat in parts)
    return Dates(nanoseconds, "dates", has_date=True, has_clock=any(rest))


def times_of(columns: Sequence[Dates], starts: Sequence[int], unit: str | None) -> tuple[FloatArray, str, str]:
    """Return the times (N,) of one column in the files that are read together, their unit, and a remark.

    `columns` are the dates in each file, of one kind; `starts` the rows at which trajectories begin, counted over all
    files. Without a `unit` it is the longest of days, hours, minutes and seconds of which a usual step between rows has
    at least one. Raises DataError where there is not one date, or `unit` is none in which dates are counted.
    """
    if unit is not None and unit not in _CALLED:
        raise DataError(f"dates are counted in {', '.join(NANOSECONDS)}, but '{unit}' is wanted; choose one of these")
    values = [value for column in columns for value in column.nanoseconds]
    present = [value for value in values if value is not None]
    if not present:
        raise DataError("a column of dates holds none; correct it")
    first = columns[0]
    origin = present[0] if first.has_date else 0
    time_unit = _unit(values, starts) if unit is None else unit
    length = NANOSECONDS[_CALLED[time_unit]]
    times = [math.nan if value is None else (value - origin) / length for value in values]
    remark = f"{first.form}, in {time_unit} since {origin_of(columns, time_unit).since}"
    return np.array(times, dtype=np.float64), time_unit, remark


def origin_of(columns: Sequence[Dates], unit: str) -> Origin:
    """Return the origin of what `times_of` returns in `unit`."""
    first = next(value for column in columns for value in column.nanoseconds if value is not None)
    since = _written(first, columns[0]) if columns[0].has_date else MIDNIGHT
    return Origin(since, NANOSECONDS[_CALLED[unit]] / NANOSECONDS["s"])


def _unit(values: Sequence[int | None], starts: Sequence[int]) -> str:
    steps = sorted(abs(step) for step in _steps(values, starts) if step)
    usual = steps[len(steps) // 2] if steps else 0
    return next((unit for unit, length in NANOSECONDS.items() if length <= usual), "s")


def _written(origin: int, column: Dates) -> str:
    days, rest = divmod(origin, NANOSECONDS["d"])
    date = datetime.date.fromordinal(days + _EPOCH).isoformat()
    if not column.has_clock:
        return date
    seconds, part = divmod(rest, NANOSECONDS["s"])
    clock = f"{seconds // 3600:02}:{seconds // 60 % 60:02}:{seconds % 60:02}"
    fraction = f".{part:09}".rstrip("0") if part else ""
    return f"{date} {clock}{fraction}{' UTC' if column.is_utc else ''}"
