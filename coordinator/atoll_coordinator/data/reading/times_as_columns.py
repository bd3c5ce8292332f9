"""Tables with a column for each year, date or month -> tables with a row for each. Pure.

``species,1990,1991,1992`` is how statistics are published and spreadsheets are kept; ``year,Jan,Feb,…`` how weather
stations report.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations, pairwise, zip_longest
from typing import Final

from atoll_coordinator.data.reading.calendar_columns import year_of
from atoll_coordinator.data.reading.cells import NumberCell, is_missing, is_numeral, number, on_one_line
from atoll_coordinator.data.reading.dates import MONTHS, is_date, is_datum
from atoll_coordinator.data.reading.raw_table import RawTable
from atoll_coordinator.data.roles.column_options import named_columns, split_unit, strip_units
from atoll_coordinator.data.roles.time_column import TIME_NAMES
from atoll_coordinator.settings import SETTINGS
from atoll_core.config import DataConfig
from atoll_core.errors import DataError

TIME: Final = "time"
VALUE: Final = "value"
"""What the values of the months are called."""


def has_times(header: Sequence[str], rows: Sequence[Sequence[str]]) -> bool:
    """Tell whether a header has names of columns, then times, above rows of names and numbers."""
    first = _first_time(header)
    return first is not None and _fits(first, [*zip_longest(*rows, fillvalue="")])


def turned(file: str, raw: RawTable, config: DataConfig) -> RawTable:
    """Return a table whose columns are times or months with a row for each of these; any other table as it is.

    Raises DataError where two rows have one name.
    """
    months = _months(raw, config)
    if months is not None:
        return _of_months(raw, *months)
    first = _first_time(raw.headers)
    if first is None or not _fits(first, raw.columns) or named_columns(config) & set(raw.headers[first:]):
        return raw
    return _of_times(file, raw, first, config)


# ------------------------------------------------------------------------------------------------- times as columns


def _first_time(header: Sequence[str]) -> int | None:
    """Return the place from which on the names of columns are times; None where they are not, or nothing else is."""
    names = [split_unit(on_one_line(name))[0] for name in header]
    count = len(names)
    while count and not names[count - 1]:
        count -= 1
    first = next((place for place in range(count) if all(map(is_datum, names[place:count]))), count)
    times, ids = names[first:count], names[:first]
    if not ids or len(times) < SETTINGS.checks.min_rows or any(name in TIME_NAMES for name in ids):
        return None
    if all(map(is_numeral, times)):
        numbers = [number(time) for time in times]
        if any(one is None or other is None or not one < other for one, other in pairwise(numbers)):
            return None
    elif not all(map(is_date, times)):
        return None
    return first


def _fits(first: int, columns: Sequence[Sequence[str]]) -> bool:
    """Tell whether rows have names, and numbers from column `first` on: columns 1, 2, 3 beside a time do not."""
    has_names = any(map(_are_names, columns[:first]))
    return has_names and any(is_numeral(cell) for column in columns[first:] for cell in column)


def _are_names(cells: Sequence[str]) -> bool:
    """Tell whether cells hold text that is neither numbers nor dates."""
    return any(not is_missing(cell) for cell in cells) and not any(map(is_datum, cells))


def _of_times(file: str, raw: RawTable, first: int, config: DataConfig) -> RawTable:
    """Return the table with a row for each time; trajectories that options name stand below each other."""
    headers = [split_unit(on_one_line(header))[0] for header in raw.headers]
    config = strip_units(config, headers)
    texts = [place for place in range(first) if _are_names(raw.columns[place])]
    run = next((place for place in texts if headers[place] == config.trajectory), None)
    runs = [""] * len(raw.lines) if run is None else raw.columns[run]
    ids = [place for place in texts if place != run]
    chosen, names = _names(raw, runs, ids)
    if len({*zip(runs, names, strict=True)}) < len(names):
        twice = next(name for row, name in enumerate(names) if name in names[:row])
        raise DataError(f"{file} has times as columns, and two rows called '{twice}'; give each row its own name")
    times = [place for place in range(first, len(headers)) if headers[place]]
    labels = [*dict.fromkeys(names)]
    place_of = {pair: row for row, pair in enumerate(zip(runs, names, strict=True))}
    named = [*dict.fromkeys(runs)]
    columns = {config.time or TIME: [headers[place] for _ in named for place in times]}
    if run is not None:
        columns[headers[run]] = [each for each in named for _ in times]
    for label in labels:
        rows = [place_of.get((each, label)) for each in named]
        columns[label] = ["" if row is None else raw.columns[place][row] for row in rows for place in times]
    others = [
        header or f"column {place + 1}"
        for place, header in enumerate(headers)
        if place not in (run, *chosen, *times) and (header or any(map(str.strip, raw.columns[place])))
    ]
    return replace(
        raw,
        headers=tuple(columns),
        columns=[*columns.values()],
        lines=[0] * (len(times) * len(named)),
        starts=[len(times) * place for place in range(len(named))],
        units=(),
        remarks=(*raw.remarks, f"a column for each row of a table with times as columns: {', '.join(labels)}"),
        left_out=(*raw.left_out, *([f"left out: {', '.join(others)}"] if others else [])),
    )


def _names(raw: RawTable, runs: Sequence[str], ids: Sequence[int]) -> tuple[tuple[int, ...], list[str]]:
    """Return the columns that give each row its own name, as few as do, and the names."""
    for count in range(1, len(ids) + 1):
        for chosen in combinations(ids, count):
            cells = zip(*(raw.columns[place] for place in chosen), strict=True)
            names = [" ".join(filter(None, map(on_one_line, parts))) for parts in cells]
            if all(names) and len({*zip(runs, names, strict=True)}) == len(names):
                return chosen, names
    return tuple(ids), [" ".join(map(on_one_line, parts)) for parts in zip(*(raw.columns[i] for i in ids), strict=True)]


# ------------------------------------------------------------------------------------------------- months as columns


def _months(raw: RawTable, config: DataConfig) -> tuple[int, list[int]] | None:
    """Return the places of the column of years and of those of the months; None where there are none."""
    names = [split_unit(on_one_line(header))[0] for header in raw.headers]
    places: Mapping[str, int] = {name.strip(".").lower()[:3]: place for place, name in enumerate(names)
                                 if name.strip(".").lower() in MONTHS}  # fmt: skip
    if len(places) < 12 or named_columns(config) & {names[place] for place in places.values()}:
        return None
    years = next((place for place in range(len(names)) if place not in places.values() and year_of(raw.columns[place])),
                 None)  # fmt: skip
    return (
        None
        if years is None
        else (years, sorted(places.values(), key=lambda place: MONTHS[names[place].strip(".").lower()]))
    )


def _of_months(raw: RawTable, years: int, months: Sequence[int]) -> RawTable:
    """Return the table with a row for each month, in years, without the months before the first and after the last."""
    rows = [(row, month) for row in range(len(raw.lines)) for month in range(len(months))]
    known = [place for place, (row, month) in enumerate(rows) if not is_missing(raw.columns[months[month]][row])]
    rows = rows[known[0] : known[-1] + 1] if known else rows
    beside = [place for place in range(len(raw.headers)) if place not in (years, *months)]
    others = [place for place in beside if _are_names(raw.columns[place])]  # means of years are no states of months
    left_out = [raw.headers[place] or f"column {place + 1}" for place in beside if place not in others]
    columns: list[list[str]] = [
        [NumberCell(float(raw.columns[years][row]) + month / 12.0) for row, month in rows],
        [raw.columns[months[month]][row] for row, month in rows],
        *([raw.columns[place][row] for row, _ in rows] for place in others),
    ]
    starts = [next((at for at, (row, _) in enumerate(rows) if row >= start), 0) for start in raw.starts]
    return replace(
        raw,
        headers=(f"{TIME} [year]", VALUE, *(raw.headers[place] for place in others)),
        columns=columns,
        lines=[raw.lines[row] for row, _ in rows],
        starts=sorted(set(starts)),
        units=(),
        remarks=(*raw.remarks, f"a row for each month, whose values are called '{VALUE}'"),
        left_out=(*raw.left_out, *([f"left out: {', '.join(left_out)}"] if left_out else [])),
    )
