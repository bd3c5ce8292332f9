"""Times that several columns tell, such as year and quarter, or year, month, day and hour, as one column. Pure.

Quarters and months are counted in years, 2020.25 and so on, since they are even in these; days and hours are dates.
"""

import datetime
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

from atoll_coordinator.data.reading.cells import NumberCell, is_missing, on_one_line
from atoll_coordinator.data.reading.dates import MONTHS
from atoll_coordinator.data.reading.raw_table import RawTable
from atoll_coordinator.data.roles.column_options import named_columns, split_unit, strip_units
from atoll_coordinator.data.roles.time_column import TIME_NAMES
from atoll_core.config import DataConfig

TIME: Final = "time"
_CALLED: Final = {
    name: part
    for part, names in {
        "year": "year yr yyyy",
        "quarter": "quarter qtr",
        "month": "month mon",
        "yearday": "doy yday dayofyear day_of_year julian_day",
        "day": "day",
        "hour": "hour hr",
        "minute": "minute",
        "second": "second",
    }.items()
    for name in names.split()
}
_KINDS: Final = (
    ("year", "quarter"),
    ("year", "month", "day", "hour", "minute", "second"),
    ("year", "month", "day", "hour", "minute"),
    ("year", "month", "day", "hour"),
    ("year", "month", "day"),
    ("year", "yearday", "hour", "minute"),
    ("year", "yearday", "hour"),
    ("year", "yearday"),
    ("year", "month"),
)
"""Parts that are a time together; the first that are all there are taken."""
_FINER: Final = ("day", "hour", "minute", "second")
"""Parts without which a time that has them is another."""
_YEAR: Final = re.compile(r"1\d{3}|2[01]\d\d")
_QUARTER: Final = re.compile(r"(?P<year>1\d{3}|2[01]\d\d)[ -]?Q(?P<n>[1-4])|Q(?P<m>[1-4])[ -/](?P<at>1\d{3}|2[01]\d\d)")


def year_of(cells: Sequence[str]) -> bool:
    """Tell whether all cells are years."""
    return bool(cells) and all(_YEAR.fullmatch(cell.strip().removesuffix(".0")) for cell in cells)


def with_calendar(raw: RawTable, config: DataConfig) -> RawTable:
    """Return a table in which columns that tell the time together are one; any other as it is.

    It is called as options call the time, else ``time``. Where there is such a column already, or options name one of
    the parts for something else, nothing changes.
    """
    names = [split_unit(on_one_line(header))[0] for header in raw.headers]
    config = strip_units(config, filter(None, names))
    is_given = config.target is not None or config.derivatives is not None
    if is_given or not raw.lines or any(name in TIME_NAMES for name in names):
        return raw
    quarters = [place for place, cells in enumerate(raw.columns) if _quarters(cells) is not None]
    if len(quarters) == 1 and config.time in (None, names[quarters[0]]):
        return _replaced(
            raw, quarters, _quarters(raw.columns[quarters[0]]) or [], "[year]", config, "quarters of a year"
        )
    places: dict[str, int] = {}
    for place, name in enumerate(names):
        places.setdefault(_CALLED.get(name.lower(), ""), place)
    taken = named_columns(config) - {config.time}
    for parts in _KINDS:
        used = [places[part] for part in parts if part in places]
        if len(used) < len(parts) or {names[place] for place in used} & taken:
            continue
        if config.time not in (None, names[places["year"]]):
            return raw
        cells = _times({part: raw.columns[places[part]] for part in parts})
        if cells is None or any(part in places and part not in parts for part in _FINER):
            return raw  # without a part of it the time would be another
        unit = "[year]" if parts[-1] in ("quarter", "month") else ""
        return _replaced(raw, used, cells, unit, config, f"the columns {', '.join(names[place] for place in used)}")
    return raw


def _replaced(
    raw: RawTable, used: Sequence[int], cells: list[str], unit: str, config: DataConfig, told: str
) -> RawTable:
    """Return the table with one column of times in place of those that were `used`."""
    kept = [place for place in range(len(raw.headers)) if place not in used]
    name = f"{config.time or TIME} {unit}".strip()
    return replace(
        raw,
        headers=(name, *(raw.headers[place] for place in kept)),
        columns=[cells, *(raw.columns[place] for place in kept)],
        units=("", *(raw.units[place] for place in kept)) if raw.units else (),
        remarks=(*raw.remarks, f"time from {told}"),
    )


def _quarters(cells: Sequence[str]) -> list[str] | None:
    """Return ``2020Q1`` and the like in years; None where a cell is none."""
    if _QUARTER.fullmatch(next((cell for cell in cells if not is_missing(cell)), "").strip().upper()) is None:
        return None
    matches = [None if is_missing(cell) else _QUARTER.fullmatch(cell.strip().upper()) for cell in cells]
    if any(match is None and not is_missing(cell) for cell, match in zip(cells, matches, strict=True)):
        return None
    return [
        "" if match is None else _in_years(int(match["year"] or match["at"]), int(match["n"] or match["m"]), 4)
        for match in matches
    ]


def _times(parts: Mapping[str, Sequence[str]]) -> list[str] | None:
    """Return the times of rows; None where a part of one is not what its name says."""
    times: list[str] = []
    for cells in zip(*parts.values(), strict=True):
        values = [_value(part, cell.strip()) for part, cell in zip(parts, cells, strict=True)]
        if any(value is None for value in values):
            return None
        known = dict(zip(parts, (value or 0 for value in values), strict=True))
        try:
            times.append(_time(known))
        except (ValueError, OverflowError):
            return None
    return times


def _value(part: str, cell: str) -> int | None:
    """Return the number in a cell: of a year, of a quarter (3, Q3), of a month (3, March), and so on."""
    text = cell.lower().removesuffix(".0")
    if part == "month" and text.strip(".") in MONTHS:
        return MONTHS[text.strip(".")]
    text = text.removeprefix("q") if part == "quarter" else text
    if not text.isdecimal() or (part == "year" and not _YEAR.fullmatch(text)):
        return None
    most = {"quarter": 4, "month": 12, "yearday": 366, "day": 31, "hour": 24, "minute": 59, "second": 60}
    return int(text) if int(text) <= most.get(part, int(text)) else None


def _time(parts: Mapping[str, int]) -> str:
    """Return the time that parts tell, in years or as a date; raises ValueError where there is no such date."""
    if "quarter" in parts:
        return _in_years(parts["year"], _counted(parts["quarter"]), 4)
    if "month" in parts and "day" not in parts:
        return _in_years(parts["year"], _counted(parts["month"]), 12)
    day = datetime.datetime(parts["year"], parts.get("month", 1), parts.get("day", 1))
    day += datetime.timedelta(days=_counted(parts.get("yearday", 1)) - 1, hours=parts.get("hour", 0),
                              minutes=parts.get("minute", 0), seconds=parts.get("second", 0))  # fmt: skip
    return day.isoformat() if "hour" in parts else day.date().isoformat()


def _in_years(year: int, number: int, parts: int) -> NumberCell:
    """Return the beginning of a part of a year, counted from 1, in years: 2020.25 of the second of four."""
    return NumberCell(year + (number - 1) / parts)


def _counted(number: int) -> int:
    if not number:
        raise ValueError("there is no such number 0")
    return number
