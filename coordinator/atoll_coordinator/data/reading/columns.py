"""`RawTable` -> the columns of one file: numbers, dates, and text that is set aside. Pure."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, cast

import numpy as np

from atoll_coordinator.data.reading.calendar_columns import with_calendar
from atoll_coordinator.data.reading.cells import is_missing, is_text, on_one_line, shortened, visible
from atoll_coordinator.data.reading.date_columns import STAMPS, compact_dates, read_date_columns, time_stamps
from atoll_coordinator.data.reading.dates import Dates, is_date, split_origin
from atoll_coordinator.data.reading.long_tables import widened
from atoll_coordinator.data.reading.numerals import place, read_numbers
from atoll_coordinator.data.reading.raw_table import RawTable
from atoll_coordinator.data.reading.times_as_columns import turned
from atoll_coordinator.data.roles.column_options import named_columns, split_unit, strip_units
from atoll_coordinator.data.roles.roles import assigned
from atoll_coordinator.data.roles.trajectory_column import find_trajectory_column
from atoll_core.config import DataConfig
from atoll_core.data.dataset import FloatArray
from atoll_core.data.table import MANY
from atoll_core.errors import DataError

TIME: Final = "time"


@dataclass(frozen=True)
class Columns:
    """The columns of one file by name, each with its unit; `skipped` hold text, `remarks` say how it was read.

    `labels` are the texts that the numbers of a column of trajectories or groups stand for, from 1; `left_out` says
    what else of the file is no part of these columns.
    """

    file: str
    values: Mapping[str, FloatArray | Dates]
    units: Mapping[str, str]
    lines: Sequence[int]
    starts: Sequence[int]
    skipped: tuple[str, ...]
    remarks: tuple[str, ...]
    labels: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()


def columns_of(file: str, raw: RawTable, config: DataConfig) -> Columns:
    """Turn cells into numbers and dates; raises DataError where columns share a name, or a cell cannot be read.

    Text in every cell sets a column aside unless `config` names it; the columns of trajectories and of groups alone may
    hold names, which are numbered. Dates are read as `read_date_columns` says. A column without a name (such as a
    table's row numbers) is set aside, by its place.
    """
    raw = widened(file, with_calendar(turned(file, _with_index(raw), config), config), config)
    stated, cells = _headed(file, raw)
    counted = {name: split_origin(unit) for name, unit in stated.items()}
    units = {name: unit for name, (unit, _) in counted.items()}
    since = tuple(f"{name}: in {unit} since {origin}" for name, (unit, origin) in counted.items() if origin)
    names = [*cells]
    config = strip_units(config, names)
    needed, trajectory = named_columns(config), find_trajectory_column(names, config)
    texts = {name: column for name, column in cells.items() if is_text(column)}
    labels = {name: _labels(texts[name]) for name in (trajectory, config.group) if name in texts}
    runs = {name: _numbered(texts.pop(name)) for name in labels}
    unlabelled = {name: column for name, column in cells.items() if name not in (trajectory, *labels)}
    stamps = time_stamps(unlabelled, units, config)
    texts |= compact_dates(unlabelled, config) | stamps
    dates = read_date_columns(file, texts, names, raw.starts, config, lambda row: place(raw.lines, row))
    read_dates = {
        name: replace(column, form=STAMPS) if name in stamps else column for name, column in dates.values.items()
    }
    plain = {
        name: column
        for name, column in cells.items()
        if name not in runs and name not in dates.values and (name not in texts or name in needed)
    }
    kept = {*runs, *dates.values, *plain}
    called = {name: dates.renamed.get(name, name) for name in names if name in kept}
    if texts and not assigned([*called.values()], config, trajectory).equations:
        raise _nothing_left(file, {name: cells[name] for name in texts if name not in dates.values}, raw.lines)
    numbers, remarks = read_numbers(file, plain, raw.lines, raw.separator)
    read = cast(dict[str, FloatArray | Dates], {**runs, **read_dates, **numbers})
    skipped = (*_unnamed(raw), *(name for name in texts if name not in read and name != dates.absorbed))
    renamed = (f"column '{old}' is the {new}" for old, new in dates.renamed.items())
    left_out = (f"text left out: {', '.join(skipped)}",) if skipped else ()
    return Columns(
        file,
        {new: read[name] for name, new in called.items()},
        {new: units[name] for name, new in called.items()},
        raw.lines,
        raw.starts,
        skipped,
        (*raw.remarks, *remarks, *renamed, *since, *raw.left_out, *left_out),
        labels,
        raw.left_out,
    )


def _nothing_left(file: str, texts: Mapping[str, Sequence[str]], lines: Sequence[int]) -> DataError:
    """Name columns of text, and a cell of each."""
    examples = []
    for name, cells in [*texts.items()][:MANY]:
        row = next(row for row, cell in enumerate(cells) if not is_missing(cell))
        examples.append(f"'{name}' holds '{shortened(cells[row], 40)}' in {place(lines, row)}")
    more = ", …" if len(texts) > MANY else ""
    advice = "write numbers alone into cells, and their unit into the header, as x [%]"
    return DataError(f"no column of numbers is left in {file}: {', '.join(examples)}{more}; {advice}")


def _with_index(raw: RawTable) -> RawTable:
    """Name a first column of dates that has no name, as an index of pandas, so that it can be the time."""
    if raw.headers[:1] != ("",) or TIME in raw.headers or not raw.lines:
        return raw
    first = next((cell for cell in raw.columns[0] if not is_missing(cell)), "")
    return replace(raw, headers=(TIME, *raw.headers[1:])) if is_date(first) else raw


def _headed(file: str, raw: RawTable) -> tuple[dict[str, str], dict[str, list[str]]]:
    """Return units and cells by name."""
    units: dict[str, str] = {}
    named: dict[str, list[str]] = {}
    counts = Counter(split_unit(on_one_line(header))[0] for header in raw.headers if header)
    units_below = raw.units or ("",) * len(raw.headers)
    for header, unit_below, cells in zip(raw.headers, units_below, raw.columns, strict=True):
        if header:
            name, unit = split_unit(on_one_line(header))
            if counts[name] > 1:
                raise DataError(f"{file} has {counts[name]} columns named '{name}'; give each column its own name")
            units[name], named[name] = unit or unit_below, cells
    if not raw.lines:
        raise DataError(f"{file} has a header but no rows; rows of numbers are expected below it")
    return units, named


def _unnamed(raw: RawTable) -> list[str]:
    places = enumerate(zip(raw.headers, raw.columns, strict=True), start=1)
    return [f"column {number}" for number, (header, cells) in places if not header and any(map(str.strip, cells))]


def _numbered(cells: Sequence[str]) -> FloatArray:
    """Number the different texts of a column by first appearance."""
    numbers = {label: float(number) for number, label in enumerate(_labels(cells), start=1)}
    return np.array([numbers[visible(cell.strip())] for cell in cells], dtype=np.float64)


def _labels(cells: Sequence[str]) -> tuple[str, ...]:
    """Return the different texts of a column, by first appearance."""
    return tuple(dict.fromkeys(visible(cell.strip()) for cell in cells))
