"""Tables of other shapes -> a row for each time and a column for each quantity. Pure; other tables stay unchanged.

- times as columns: ``species,1990,1991,1992`` of published statistics; ``year,Jan,Feb,…`` of weather stations;
- times in several columns: year and quarter, or year, month, day and hour. Quarters and months become years, such as
  2020.25, since they are evenly spaced in years; days and hours become dates;
- long tables, with one measured value in each row: ``observableId, simulationConditionId, measurement, time`` of PEtab,
  ``variable, value`` of `melt` in pandas, ``name, value`` of tidyr. A long table is recognised by the names of its
  columns, and by times that are repeated or go back.

A table is not reshaped if an option gives one of the columns another role.
"""

import datetime
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import combinations, pairwise, zip_longest
from typing import Final, NamedTuple

import numpy as np

from atoll_coordinator.data.reading.cells import (
    NumberCell,
    is_missing,
    is_numeral,
    is_text,
    number,
    on_one_line,
    parse_numbers,
    place,
)
from atoll_coordinator.data.reading.dates import MONTHS, is_date, is_datum, read_dates
from atoll_coordinator.data.reading.raw_table import RawTable
from atoll_coordinator.data.roles.names_and_options import (
    TIME_NAMES,
    TRAJECTORY_NAME,
    find_time_column,
    named_columns,
    split_unit,
    strip_units,
)
from atoll_coordinator.settings import SETTINGS
from atoll_core.config import DataConfig
from atoll_core.errors import DataError

TIME: Final = "time"
VALUE: Final = "value"
"""Names of the times, and of the values of months, unless options name them."""


def reshaped(file: str, raw: RawTable, config: DataConfig) -> RawTable:
    """Return a table with a row for each time; `file` is for messages.

    Raises DataError if two rows of a table with times as columns have the same name, or if an observable of a long
    table has two values at one time.
    """
    return _widened(file, _with_joined_times(_with_times_as_rows(file, raw, config), config), config)


def _names(headers: Sequence[str]) -> list[str]:
    return [split_unit(on_one_line(header))[0] for header in headers]


def _listed(columns: Sequence[str]) -> tuple[str, ...]:
    return (f"left out: {', '.join(columns)}",) if columns else ()


# --------------------------------------------------------------------------------------------------- times as columns


def has_times(header: Sequence[str], rows: Sequence[Sequence[str]]) -> bool:
    """Tell whether a header has names of columns followed by times, above rows of names and numbers."""
    first = _first_time(header)
    return first is not None and _has_names_and_numbers(first, [*zip_longest(*rows, fillvalue="")])


def _with_times_as_rows(file: str, raw: RawTable, config: DataConfig) -> RawTable:
    names = _names(raw.headers)
    months = {MONTHS[key]: place for place, name in enumerate(names) if (key := name.strip(".").lower()) in MONTHS}
    if len(months) == 12 and not named_columns(config) & {names[place] for place in months.values()}:
        others = {place: raw.columns[place] for place in range(len(names)) if place not in months.values()}
        is_year = {place: bool(cells) and all(_YEAR.fullmatch(cell.strip().removesuffix(".0")) for cell in cells)
                   for place, cells in others.items()}  # fmt: skip
        years = next((place for place, holds in is_year.items() if holds), None)
        if years is not None:
            return _rows_of_months(raw, years, [months[month] for month in sorted(months)])
    first = _first_time(raw.headers)
    if (
        first is None
        or not _has_names_and_numbers(first, raw.columns)
        or named_columns(config) & set(raw.headers[first:])
    ):
        return raw
    return _rows_of_times(file, raw, first, config)


def _first_time(header: Sequence[str]) -> int | None:
    """Return the index of the first column whose name is a time; None if names are not times, or if all are times."""
    names = _names(header)
    count = len(names)
    while count and not names[count - 1]:
        count -= 1
    first = next((place for place in range(count) if all(map(is_datum, names[place:count]))), count)
    times, ids = names[first:count], names[:first]
    if not ids or len(times) < SETTINGS.common.fewest_rows or any(name in TIME_NAMES for name in ids):
        return None
    if not all(map(is_numeral, times)):
        return first if all(map(is_date, times)) else None
    pairs = pairwise(map(number, times))
    return first if all(one is not None and other is not None and one < other for one, other in pairs) else None


def _has_names_and_numbers(first: int, columns: Sequence[Sequence[str]]) -> bool:
    """Tell whether rows have names, and numbers from column `first` on.

    A table with a time and columns called 1, 2, 3 does not pass this test.
    """
    has_names = any(map(_are_names, columns[:first]))
    return has_names and any(is_numeral(cell) for column in columns[first:] for cell in column)


def _are_names(cells: Sequence[str]) -> bool:
    """Tell whether cells hold text that is neither numbers nor dates."""
    return any(not is_missing(cell) for cell in cells) and not any(map(is_datum, cells))


def _rows_of_times(file: str, raw: RawTable, first: int, config: DataConfig) -> RawTable:
    """Return the table with a row for each time, trajectory after trajectory if options name a column for them."""
    headers = _names(raw.headers)
    config = strip_units(config, headers)
    texts = [place for place in range(first) if _are_names(raw.columns[place])]
    run = next((place for place in texts if headers[place] == config.trajectory), None)
    runs = [""] * len(raw.lines) if run is None else raw.columns[run]
    if run is not None and len(texts) == 1:
        return raw  # the rows of a run have no names
    ids, names = _names_of_rows(raw, runs, [place for place in texts if place != run])
    row_of = {pair: row for row, pair in enumerate(zip(runs, names, strict=True))}
    if len(row_of) < len(names):
        twice = next(name for row, name in enumerate(names) if name in names[:row])
        raise DataError(f"{file} has times as columns, and two rows called '{twice}'; give each row its own name")
    times = [place for place in range(first, len(headers)) if headers[place]]
    labels, different_runs = [*dict.fromkeys(names)], [*dict.fromkeys(runs)]
    columns = {config.time or TIME: [headers[place] for _ in different_runs for place in times]}
    if run is not None:
        columns[headers[run]] = [each for each in different_runs for _ in times]
    for label in labels:
        rows = [row_of.get((each, label)) for each in different_runs]
        columns[label] = ["" if row is None else raw.columns[place][row] for row in rows for place in times]
    others = [
        header or f"column {place + 1}"
        for place, header in enumerate(headers)
        if place not in (run, *ids, *times) and (header or any(map(str.strip, raw.columns[place])))
    ]
    return replace(
        raw,
        headers=tuple(columns),
        columns=[*columns.values()],
        lines=[0] * (len(times) * len(different_runs)),
        starts=[len(times) * number for number in range(len(different_runs))],
        units=(),
        remarks=(*raw.remarks, f"a column for each row of a table with times as columns: {', '.join(labels)}"),
        left_out=(*raw.left_out, *_listed(others)),
    )


def _names_of_rows(raw: RawTable, runs: Sequence[str], ids: Sequence[int]) -> tuple[tuple[int, ...], list[str]]:
    """Return the fewest columns that give each row of a run its own name (else all columns), and the names."""
    names: list[str] = []
    for count in range(1, len(ids) + 1):
        for chosen in combinations(ids, count):
            cells = zip(*(raw.columns[place] for place in chosen), strict=True)
            names = [" ".join(filter(None, map(on_one_line, parts))) for parts in cells]
            if all(names) and len({*zip(runs, names, strict=True)}) == len(names):
                return chosen, names
    return tuple(ids), names


def _rows_of_months(raw: RawTable, years: int, months: Sequence[int]) -> RawTable:
    """Return the table with a row for each month, times in years, without empty months at both ends."""
    rows = [(row, month) for row in range(len(raw.lines)) for month in range(len(months))]
    known = [number for number, (row, month) in enumerate(rows) if not is_missing(raw.columns[months[month]][row])]
    rows = rows[known[0] : known[-1] + 1] if known else rows
    others = [place for place in range(len(raw.headers)) if place not in (years, *months)]
    kept = [place for place in others if _are_names(raw.columns[place])]  # annual means are not monthly states
    left_out = [raw.headers[place] or f"column {place + 1}" for place in others if place not in kept]
    columns: list[list[str]] = [
        [NumberCell(float(raw.columns[years][row]) + month / 12.0) for row, month in rows],
        [raw.columns[months[month]][row] for row, month in rows],
        *([raw.columns[place][row] for row, _ in rows] for place in kept),
    ]
    starts = [next((at for at, (row, _) in enumerate(rows) if row >= start), 0) for start in raw.starts]
    return replace(
        raw,
        headers=(f"{TIME} [year]", VALUE, *(raw.headers[place] for place in kept)),
        columns=columns,
        lines=[raw.lines[row] for row, _ in rows],
        starts=sorted(set(starts)),
        units=(),
        remarks=(*raw.remarks, f"a row for each month, whose values are called '{VALUE}'"),
        left_out=(*raw.left_out, *_listed(left_out)),
    )


# ------------------------------------------------------------------------------------------- times in several columns

_PART_OF_NAME: Final = {
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
_KINDS: Final = tuple(
    ("year", *parts.split())
    for parts in ("quarter", "month day hour minute second", "month day hour minute", "month day hour", "month day",
                  "yearday hour minute", "yearday hour", "yearday", "month")
)  # fmt: skip
"""Combinations of parts that together give a time; the first combination whose parts all exist is used."""
_FINER: Final = ("day", "hour", "minute", "second")
"""Parts that must not be ignored if the table has them: without them the time would be wrong."""
_LARGEST: Final = {"quarter": 4, "month": 12, "yearday": 366, "day": 31, "hour": 24, "minute": 59, "second": 60}
_YEAR: Final = re.compile(r"1\d{3}|2[01]\d\d")
_QUARTER: Final = re.compile(r"(?P<year>1\d{3}|2[01]\d\d)[ -]?Q(?P<n>[1-4])|Q(?P<m>[1-4])[ -/](?P<at>1\d{3}|2[01]\d\d)")


def _with_joined_times(raw: RawTable, config: DataConfig) -> RawTable:
    """Return the table with one time column in place of the parts of a time; options may name the new column."""
    names = _names(raw.headers)
    config = strip_units(config, filter(None, names))
    is_given = config.target is not None or config.derivatives is not None
    if is_given or not raw.lines or any(name in TIME_NAMES for name in names):
        return raw
    quarters = {place: times for place, cells in enumerate(raw.columns) if (times := _quarters(cells)) is not None}
    if len(quarters) == 1 and config.time in (None, *(names[place] for place in quarters)):
        ((column, times),) = quarters.items()
        return _with_time(raw, [column], times, "[year]", config, "quarters of a year")
    columns: dict[str, int] = {}
    for column, name in enumerate(names):
        columns.setdefault(_PART_OF_NAME.get(name.lower(), ""), column)
    taken = named_columns(config) - {config.time}
    for parts in _KINDS:
        used = [columns[part] for part in parts if part in columns]
        if len(used) < len(parts) or {names[column] for column in used} & taken:
            continue
        if config.time not in (None, names[columns["year"]]):
            return raw
        joined = _times_of_parts({part: raw.columns[columns[part]] for part in parts})
        if joined is None or any(part in columns and part not in parts for part in _FINER):
            return raw
        unit = "[year]" if parts[-1] in ("quarter", "month") else ""
        return _with_time(raw, used, joined, unit, config, f"the columns {', '.join(names[column] for column in used)}")
    return raw


def _with_time(
    raw: RawTable, used: Sequence[int], times: list[str], unit: str, config: DataConfig, source: str
) -> RawTable:
    kept = [column for column in range(len(raw.headers)) if column not in used]
    return replace(
        raw,
        headers=(f"{config.time or TIME} {unit}".strip(), *(raw.headers[column] for column in kept)),
        columns=[times, *(raw.columns[column] for column in kept)],
        units=("", *(raw.units[column] for column in kept)) if raw.units else (),
        remarks=(*raw.remarks, f"time from {source}"),
    )


def _quarters(cells: Sequence[str]) -> list[str] | None:
    """Return quarters such as ``2020Q1`` as years; None if a cell is not a quarter."""
    times: list[str] = []
    for cell in cells:
        match = _QUARTER.fullmatch(cell.strip().upper())
        if match is None and not is_missing(cell):
            return None
        times.append("" if match is None else _in_years(int(match["year"] or match["at"]), match["n"] or match["m"], 4))
    return times if any(times) else None


def _times_of_parts(columns: Mapping[str, Sequence[str]]) -> list[str] | None:
    """Return the times of rows, in years or as dates; None if a cell does not fit the name of its column."""
    times: list[str] = []
    for cells in zip(*columns.values(), strict=True):
        parts = {part: _part(part, cell.strip()) for part, cell in zip(columns, cells, strict=True)}
        try:
            known = {part: int(value) for part, value in parts.items()}
            if not all(known.get(part, 1) for part in ("quarter", "month", "yearday")):
                return None  # these parts are numbered from 1
            if "day" not in known and ("quarter" in known or "month" in known):
                part, count = ("quarter", 4) if "quarter" in known else ("month", 12)
                times.append(_in_years(known["year"], known[part], count))
                continue
            day = datetime.datetime(known["year"], known.get("month", 1), known.get("day", 1))
            day += datetime.timedelta(days=known.get("yearday", 1) - 1, hours=known.get("hour", 0),
                                      minutes=known.get("minute", 0), seconds=known.get("second", 0))  # fmt: skip
            times.append(day.isoformat() if "hour" in known else day.date().isoformat())
        except (ValueError, OverflowError):
            return None
    return times


def _part(part: str, cell: str) -> str:
    """Return the digits of the year, quarter (3, Q3), month (3, March) or other part in a cell; "" for none."""
    text = cell.lower().removesuffix(".0")
    if part == "month" and text.strip(".") in MONTHS:
        return str(MONTHS[text.strip(".")])
    text = text.removeprefix("q") if part == "quarter" else text
    is_number = text.isdecimal() and (part != "year" or _YEAR.fullmatch(text))
    return text if is_number and int(text) <= _LARGEST.get(part, math.inf) else ""


def _in_years(year: int, number: int | str, count: int) -> NumberCell:
    """Return the beginning of part `number`, from 1, of `count` parts of a year: 2020.25 for the second quarter."""
    return NumberCell(year + (int(number) - 1) / count)


# -------------------------------------------------------------------------------------------------------- long tables

_OBSERVABLES: Final = (
    "observable variable name quantity species analyte signal sensor channel parameter key metric measure field"
)
_VALUES: Final = "value values measurement measured val concentration reading result"
_RUNS: Final = (
    "simulationcondition preequilibrationcondition condition experiment replicate run trajectory subject batch trial "
    "repeat"
)
_UNITS: Final = "unit units"
"""Names of the columns of long tables, in lower case, without marks and without "id" at the end."""


class _LongTable(NamedTuple):
    """Cells by column, and the roles of columns: `runs` distinguish trajectories, `carried` are named by options."""

    file: str
    raw: RawTable
    cells: Mapping[str, Sequence[str]]
    time: str
    observable: str
    value: str
    runs: tuple[str, ...]
    carried: tuple[str, ...]
    unit: str | None


def may_be_long(names: Iterable[str]) -> bool:
    """Tell whether columns have the names of a long table."""
    plain = _names([*names])
    return all(any(_is_called(name, known) for name in plain) for known in (_OBSERVABLES, _VALUES))


def _is_called(name: str, known: str) -> bool:
    """Tell whether the name of a column is a known word, ignoring capitals, marks and "id" at the end."""
    return "".join(filter(str.isalnum, name.lower())).removesuffix("id") in known.split()


def _widened(file: str, raw: RawTable, config: DataConfig) -> RawTable:
    """Return a long table with a column for each observable; the rows of a trajectory are sorted by time."""
    long = _long_table(file, raw, config) if may_be_long(raw.headers) else None
    if long is None:
        return raw
    cells, trajectory = long.cells, config.trajectory or TRAJECTORY_NAME
    runs = [tuple(cells[name][row] for name in long.runs) for row in range(len(raw.lines))]
    times = _times_of_rows(long, runs)
    if _times_ascend(times, raw.starts, cells.get(trajectory)):
        return raw
    rows_by_key = _rows_by_key(long, runs, times)
    keys = sorted(rows_by_key)
    first = [min(rows_by_key[key].values()) for key in keys]
    wide = {long.time: [cells[long.time][row] for row in first]}
    if long.runs:
        wide[trajectory] = ["/".join(filter(None, runs[row])) for row in first]
    for name in long.carried:
        values = [{cells[name][row] for row in rows_by_key[key].values()} for key in keys]
        differing = next((sorted(some)[:2] for some in values if len(some) > 1), None)
        if differing is not None:
            raise DataError(
                f"column '{name}' of {file}, a long table, differs between observables at the same time "
                f"({' and '.join(differing)}); write a table with a column for each observable"
            )
        wide[name] = [next(iter(some)) for some in values]
    observables = [*dict.fromkeys(cells[long.observable])]
    clash = next((name for name in observables if name in wide), None)
    if clash is not None:
        raise DataError(f"{file} has an observable and a column that are both called '{clash}'; rename one of them")
    for name in observables:
        rows = [rows_by_key[key].get(name) for key in keys]
        wide[name] = ["" if row is None else cells[long.value][row] for row in rows]
    used = {long.time, long.observable, long.value, long.unit, *long.carried, *long.runs}
    remarks = [f"a long table, with a column for each '{long.observable}': {', '.join(observables)}"]
    remarks += [f"trajectories by {', '.join(long.runs)}"] if long.runs else []
    breaks = [row for row, (one, other) in enumerate(pairwise(keys), start=1) if one[0] != other[0]]
    return replace(
        raw,
        headers=tuple(wide),
        columns=[*wide.values()],
        lines=[raw.lines[row] for row in first],
        starts=[0, *breaks],
        units=_units(long, [*wide], observables),
        remarks=(*raw.remarks, *remarks),
        left_out=(*raw.left_out, *_listed([name for name in cells if name not in used])),
    )


def _long_table(file: str, raw: RawTable, config: DataConfig) -> _LongTable | None:
    """Return the columns of a long table; None if it is not one, or if options give its columns other roles."""
    headers = _names(raw.headers)
    cells = {name: [cell.strip() for cell in column] for name, column in zip(headers, raw.columns, strict=True) if name}
    if len(cells) < sum(map(bool, headers)):
        return None
    config = strip_units(config, cells)
    time, named = find_time_column([*cells], config), named_columns(config)
    free = [name for name in cells if name != time and name not in named]
    observables = [
        name
        for name in free
        if _is_called(name, _OBSERVABLES) and is_text(cells[name]) and not any(map(is_missing, cells[name]))
        if len(set(cells[name])) > 1
    ]
    values = [name for name in free if _is_called(name, _VALUES) and not is_text(cells[name])]
    if time is None or time not in cells or len(observables) != 1 or len(values) != 1:
        return None
    runs = tuple(name for name in cells if _is_called(name, _RUNS) and not all(map(is_missing, cells[name])))
    if config.trajectory is not None:
        runs = (config.trajectory,) if config.trajectory in cells else ()
    carried = tuple(name for name in cells if name in named and name not in (time, config.trajectory))
    (observable,), (value,) = observables, values
    count = len(set(cells[observable]))
    units = [name for name in free if _is_called(name, _UNITS)]
    unit = next((name for name in units if len({*zip(cells[observable], cells[name], strict=True)}) == count), None)
    return _LongTable(file, raw, cells, time, observable, value, runs, carried, unit)


def _times_of_rows(long: _LongTable, runs: Sequence[tuple[str, ...]]) -> list[float | None]:
    texts, lines = long.cells[long.time], long.raw.lines
    if not is_date(next((text for text in texts if not is_missing(text)), "")):
        numbers, _ = parse_numbers(long.file, {long.time: texts}, lines, long.raw.separator)
        return [None if math.isnan(value) else float(value) for value in numbers[long.time]]
    series = [*zip(runs, long.cells[long.observable], strict=True)]
    starts = [row for row in range(len(series)) if not row or series[row] != series[row - 1]]
    dates = read_dates(f"column '{long.time}' of {long.file}", texts, starts, lines)
    return [None if value is None else float(value) for value in dates.nanoseconds]


def _times_ascend(times: Sequence[float | None], starts: Sequence[int], trajectories: Sequence[str] | None) -> bool:
    """Tell whether the table can be read without reshaping: times ascend along its trajectories."""
    segments = np.searchsorted(starts, np.arange(len(times)), side="right").tolist()
    known = [
        (segments[row], "" if trajectories is None else trajectories[row], time)
        for row, time in enumerate(times)
        if time is not None
    ]
    return all(one[:2] != other[:2] or other[2] > one[2] for one, other in pairwise(known))


def _rows_by_key(
    long: _LongTable, runs: Sequence[tuple[str, ...]], times: Sequence[float | None]
) -> dict[tuple[int, float], dict[str, int]]:
    """Return the row of each observable, by trajectory number and time."""
    numbers = {run: number for number, run in enumerate(dict.fromkeys(runs))}
    rows_by_key: dict[tuple[int, float], dict[str, int]] = {}
    for row, (run, time, name) in enumerate(zip(runs, times, long.cells[long.observable], strict=True)):
        where = place(long.raw.lines, row)
        if time is None:
            raise DataError(
                f"column '{long.time}' of {long.file} is empty in {where}; a value of a long table needs a time"
            )
        rows = rows_by_key.setdefault((numbers[run], time), {})
        if name in rows:
            raise DataError(
                f"{long.file} is a long table in which '{name}' has two values at the {long.time} "
                f"{long.cells[long.time][row]} ({place(long.raw.lines, rows[name])} and {where}); "
                "distinguish replicates by a column 'replicate', or keep one"
            )
        rows[name] = row
    return rows_by_key


def _units(long: _LongTable, names: Sequence[str], observables: Sequence[str]) -> tuple[str, ...]:
    below = long.raw.units or ("",) * len(long.raw.headers)
    stated: dict[str, str] = {}
    for header, unit in zip(long.raw.headers, below, strict=True):
        name, own = split_unit(on_one_line(header))
        stated[name] = own or unit
    of_rows = {} if long.unit is None else dict(zip(long.cells[long.observable], long.cells[long.unit], strict=True))
    units = {name: unit for name, unit in of_rows.items() if not is_missing(unit)}
    return tuple(
        units.get(name) or stated[long.value] if name in observables else stated.get(name, "") for name in names
    )
