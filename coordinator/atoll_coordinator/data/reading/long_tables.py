"""Long tables, which have one measured value in each row, -> wide ones, with a column for each observable. Pure.

``observableId, simulationConditionId, measurement, time`` is how PEtab writes measurements, ``variable, value`` what
`melt` of pandas makes, ``name, value`` what tidyr does. Such a table is known by the names of its columns, and by times
that are repeated or go back: else it is read as it stands.
"""

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np

from atoll_coordinator.data.reading.cells import is_missing, is_text, on_one_line
from atoll_coordinator.data.reading.dates import is_date, read_dates
from atoll_coordinator.data.reading.numerals import place, read_numbers
from atoll_coordinator.data.reading.raw_table import RawTable
from atoll_coordinator.data.roles.column_options import named_columns, split_unit, strip_units
from atoll_coordinator.data.roles.time_column import find_time_column
from atoll_coordinator.data.roles.trajectory_column import TRAJECTORY_NAME
from atoll_core.config import DataConfig
from atoll_core.errors import DataError

_OBSERVABLES: Final = (
    "observable variable name quantity species analyte signal sensor channel parameter key metric measure field"
)
_VALUES: Final = "value values measurement measured val concentration reading result"
_RUNS: Final = (
    "simulationcondition preequilibrationcondition condition experiment replicate run trajectory subject batch trial "
    "repeat"
)
_UNITS: Final = "unit units"
"""How columns of long tables are called, without capitals, marks, and "id" at the end."""

Cells = Mapping[str, Sequence[str]]
_Key = tuple[int, float]
"""The number of a trajectory, and a time."""


class _Roles(NamedTuple):
    """Names of the columns of a long table: `runs` tell trajectories apart, `carried` are named by options."""

    time: str
    observable: str
    value: str
    runs: tuple[str, ...]
    carried: tuple[str, ...]
    unit: str | None


def may_be_long(names: Iterable[str]) -> bool:
    """Tell whether columns are called as those of long tables are."""
    plain = [split_unit(on_one_line(name))[0] for name in names]
    return all(any(_is_called(name, known) for name in plain) for known in (_OBSERVABLES, _VALUES))


def widened(file: str, raw: RawTable, config: DataConfig) -> RawTable:
    """Return a long table with a column for each observable, any other table as it is.

    The rows of a trajectory are in the order of their times. Conditions and replicates tell trajectories apart; further
    columns are left out unless options name them. Raises DataError where an observable has two values at one time.
    """
    if not may_be_long(raw.headers):
        return raw
    headers = [split_unit(on_one_line(header))[0] for header in raw.headers]
    cells = {name: [cell.strip() for cell in column] for name, column in zip(headers, raw.columns, strict=True) if name}
    if len(cells) < sum(map(bool, headers)):
        return raw
    config = strip_units(config, cells)
    roles = _roles(cells, config)
    if roles is None:
        return raw
    runs = [tuple(cells[name][row] for name in roles.runs) for row in range(len(raw.lines))]
    times = _times(file, raw, cells, roles, runs)
    if _ascend(times, raw.starts, cells.get(config.trajectory or TRAJECTORY_NAME)):
        return raw
    rows_by_key = _rows_by_key(file, raw, cells, roles, runs, times)
    keys = sorted(rows_by_key)
    first = [min(rows_by_key[key].values()) for key in keys]
    wide = {roles.time: [cells[roles.time][row] for row in first]}
    if roles.runs:
        wide[config.trajectory or TRAJECTORY_NAME] = ["/".join(filter(None, runs[row])) for row in first]
    groups = [rows_by_key[key].values() for key in keys]
    wide |= {name: _carried(file, name, cells[name], groups) for name in roles.carried}
    observables = [*dict.fromkeys(cells[roles.observable])]
    clash = next((name for name in observables if name in wide), None)
    if clash is not None:
        raise DataError(f"{file} has an observable and a column that are both called '{clash}'; rename one of them")
    for name in observables:
        rows = [rows_by_key[key].get(name) for key in keys]
        wide[name] = ["" if row is None else cells[roles.value][row] for row in rows]
    breaks = [row for row, (one, other) in enumerate(pairwise(keys), start=1) if one[0] != other[0]]
    return replace(
        raw,
        headers=tuple(wide),
        columns=[*wide.values()],
        lines=[raw.lines[row] for row in first],
        starts=[0, *breaks],
        units=_units(raw, headers, cells, roles, [*wide]),
        remarks=(*raw.remarks, *_remarks(roles, observables)),
        left_out=(*raw.left_out, *_left_out(cells, roles)),
    )


def _roles(cells: Cells, config: DataConfig) -> _Roles | None:
    """Return the columns of a long table; None where it is none, or options give its columns other parts."""
    time = find_time_column([*cells], config)
    named = named_columns(config)
    free = [name for name in cells if name != time and name not in named]
    observables = [name for name in free if _is_called(name, _OBSERVABLES) and _has_names(cells[name])]
    values = [name for name in free if _is_called(name, _VALUES) and not is_text(cells[name])]
    if time is None or time not in cells or len(observables) != 1 or len(values) != 1:
        return None
    (observable,), (value,) = observables, values
    runs = tuple(name for name in cells if _is_called(name, _RUNS) and not all(map(is_missing, cells[name])))
    if config.trajectory is not None:
        runs = (config.trajectory,) if config.trajectory in cells else ()
    carried = tuple(name for name in cells if name in named and name not in (time, config.trajectory))
    unit = next((name for name in free if _is_called(name, _UNITS) and _follows(cells[name], cells[observable])), None)
    return _Roles(time, observable, value, runs, carried, unit)


def _is_called(name: str, known: str) -> bool:
    """Tell whether the name of a column is a known word, but for capitals, marks and "id" at the end."""
    return "".join(filter(str.isalnum, name.lower())).removesuffix("id") in known.split()


def _has_names(cells: Sequence[str]) -> bool:
    """Tell whether a column holds names, two at least, in all rows."""
    return is_text(cells) and not any(map(is_missing, cells)) and len(set(cells)) > 1


def _follows(cells: Sequence[str], other: Sequence[str]) -> bool:
    """Tell whether a column has one text for each text of another one, as a unit for each observable."""
    return len({*zip(other, cells, strict=True)}) == len(set(other))


def _times(
    file: str, raw: RawTable, cells: Cells, roles: _Roles, runs: Sequence[tuple[str, ...]]
) -> list[float | None]:
    """Return the time of each row, in any unit, by which rows are ordered; None where it is missing."""
    texts = cells[roles.time]
    if not is_date(next((text for text in texts if not is_missing(text)), "")):
        numbers, _ = read_numbers(file, {roles.time: texts}, raw.lines, raw.separator)
        return [None if math.isnan(number) else float(number) for number in numbers[roles.time]]
    series = [*zip(runs, cells[roles.observable], strict=True)]
    starts = [row for row in range(len(series)) if not row or series[row] != series[row - 1]]
    dates = read_dates(f"column '{roles.time}' of {file}", texts, starts, lambda row: place(raw.lines, row))
    return [None if number is None else float(number) for number in dates.nanoseconds]


def _ascend(times: Sequence[float | None], starts: Sequence[int], trajectories: Sequence[str] | None) -> bool:
    """Tell whether the table can be read as it stands: times ascend along what would be its trajectories."""
    segments = np.searchsorted(starts, np.arange(len(times)), side="right").tolist()
    known = [
        (segments[row], "" if trajectories is None else trajectories[row], time)
        for row, time in enumerate(times)
        if time is not None
    ]
    return all(one[:2] != other[:2] or other[2] > one[2] for one, other in pairwise(known))


def _rows_by_key(
    file: str,
    raw: RawTable,
    cells: Cells,
    roles: _Roles,
    runs: Sequence[tuple[str, ...]],
    times: Sequence[float | None],
) -> dict[_Key, dict[str, int]]:
    """Return the row of each observable by trajectory and time."""
    numbers = {run: number for number, run in enumerate(dict.fromkeys(runs))}
    rows_by_key: dict[_Key, dict[str, int]] = {}
    for row, (run, time, name) in enumerate(zip(runs, times, cells[roles.observable], strict=True)):
        where = place(raw.lines, row)
        if time is None:
            raise DataError(
                f"column '{roles.time}' of {file} is empty in {where}; a value of a long table needs a time"
            )
        rows = rows_by_key.setdefault((numbers[run], time), {})
        if name in rows:
            raise DataError(
                f"{file} is a long table in which '{name}' has two values at the {roles.time} "
                f"{cells[roles.time][row]} ({place(raw.lines, rows[name])} and {where}); "
                "tell replicates apart by a column 'replicate', or keep one"
            )
        rows[name] = row
    return rows_by_key


def _carried(file: str, name: str, cells: Sequence[str], rows: Sequence[Collection[int]]) -> list[str]:
    """Return the cells of a column that options name, which has to be the same for all observables of one time."""
    kept = []
    for some in rows:
        values = {cells[row] for row in some}
        if len(values) > 1:
            listed = " and ".join(sorted(values)[:2])
            raise DataError(
                f"column '{name}' of {file}, a long table, differs between observables of one time ({listed}); "
                "write a table with a column for each observable"
            )
        kept.append(values.pop())
    return kept


def _units(raw: RawTable, headers: Sequence[str], cells: Cells, roles: _Roles, names: Sequence[str]) -> tuple[str, ...]:
    """Return the units of the columns of the wide table: of headers, of a row of units, or of a column of units."""
    below = raw.units or ("",) * len(headers)
    stated = {
        name: split_unit(on_one_line(header))[1] or unit
        for name, header, unit in zip(headers, raw.headers, below, strict=True)
    }
    told = {} if roles.unit is None else dict(zip(cells[roles.observable], cells[roles.unit], strict=True))
    told = {name: "" if is_missing(unit) else unit for name, unit in told.items()}
    others = {*cells[roles.observable]}
    return tuple((told.get(name) or stated[roles.value]) if name in others else stated.get(name, "") for name in names)


def _left_out(cells: Cells, roles: _Roles) -> list[str]:
    """Say which columns are no part of the wide table."""
    used = {roles.time, roles.observable, roles.value, roles.unit, *roles.carried, *roles.runs}
    others = [name for name in cells if name not in used]
    return [f"left out: {', '.join(others)}"] if others else []


def _remarks(roles: _Roles, observables: Sequence[str]) -> list[str]:
    """Say what was taken for what."""
    remarks = [f"a long table, with a column for each '{roles.observable}': {', '.join(observables)}"]
    if roles.runs:
        remarks.append(f"trajectories by {', '.join(roles.runs)}")
    return remarks
