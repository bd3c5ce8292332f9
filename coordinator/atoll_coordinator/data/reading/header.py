"""Where the header of a table stands: in its first row, or below rows that are empty or hold names of groups. Pure.

A recorder of several objects writes ``,mass A,,`` above ``t,frame,x,y``; pandas writes two levels of columns so.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, islice

from atoll_coordinator.data.reading.cells import is_missing, is_numeral, on_one_line
from atoll_coordinator.data.reading.dates import ascends, is_date, is_datum
from atoll_coordinator.data.reading.raw_table import RawTable, is_units_row, plain_unit
from atoll_coordinator.data.roles.time_column import TIME_NAMES
from atoll_coordinator.data.roles.unit_texts import are_units

Record = tuple[int, list[str]]
"""Line number and cells of one row."""


@dataclass(frozen=True)
class Header:
    """The header of a table in line `line`: its `names`, and above each of them the name of its group, if any.

    A table without a header `is_made` one.
    """

    line: int
    names: list[str]
    groups: tuple[str, ...] = ()
    is_made: bool = False

    def applied(self, raw: RawTable) -> RawTable:
        """Return a table with this header; names that several groups have carry that of their group.

        Where the columns of one name are equal, as times of several objects are, they are one column.
        """
        if self.is_made:
            return named_by_place(raw)
        if not self.groups or len(raw.headers) != len(self.groups):
            return raw
        counts = Counter(name for name in raw.headers if name)
        kept: dict[int, str] = {}
        for place, (name, group) in enumerate(zip(raw.headers, self.groups, strict=True)):
            same = [other for other, called in enumerate(raw.headers) if called == name]
            is_shared = all(raw.columns[other] == raw.columns[place] for other in same)
            if counts[name] > 1 and is_shared and place > same[0]:
                continue
            is_repeated = counts[name] > 1 and not is_shared and group
            kept[place] = f"{group} {name}" if is_repeated else name
        named = ", ".join(dict.fromkeys(filter(None, self.groups)))
        return replace(
            raw,
            headers=tuple(kept.values()),
            columns=[raw.columns[place] for place in kept],
            units=tuple(raw.units[place] for place in kept) if raw.units else (),
            remarks=(*raw.remarks, f"header in line {self.line} below names of groups: {named}"),
        )


def take_header(records: Iterable[Record]) -> tuple[Header, Iterator[Record]]:
    """Return the header and the rows below it; where all rows are empty, a header without a name."""
    rows = iter(records)
    line, top = next(((line, cells) for line, cells in rows if any(map(str.strip, cells))), (0, [""]))
    following = [*islice(rows, 3)]
    if _is_data(top, [cells for _, cells in following]):
        return Header(line, [""] * len(top), is_made=True), chain([(line, top)], following, rows)
    if not following or not are_groups(top, following[0][1], [cells for _, cells in following[1:]]):
        return Header(line, top), chain(following, rows)
    (line, names), *below = following
    if below and not names[0].strip() and _names_index(below[0][1]):  # as pandas writes two levels of columns
        names, below = [below[0][1][0], *names[1:]], below[1:]
    groups: list[str] = []
    for name in map(on_one_line, top):
        groups.append(name or (groups[-1] if groups else ""))
    return Header(line, names, tuple(groups)), chain(below, rows)


def _is_data(top: Sequence[str], following: Sequence[Sequence[str]]) -> bool:
    """Tell whether the first row is one of data: numbers and dates, in the first cell as well, as in the row below it.

    Text may stand in the same cells of both, beside two numbers or dates at least.
    """
    below = next((cells for cells in following if any(map(str.strip, cells))), top)
    filled = [cell.strip() for cell in top if cell.strip()]
    if any(filled == [str(place + first) for place in range(len(filled))] for first in (0, 1)) and len(filled) > 1:
        return all(cell.strip() == "" or cell.strip().isdigit() for cell in below)  # 0, 1, 2 are names of columns
    if len(below) != len(top) or not any(map(is_numeral, top)):
        return False
    if all(is_missing(cell) or is_datum(cell) for cell in (*top, *below)):
        return True
    kinds = [[(is_datum(cell), is_missing(cell)) for cell in cells] for cells in (top, below)]
    return kinds[0] == kinds[1] and is_datum(top[0]) and sum(map(is_datum, top)) > 1


def named_by_place(raw: RawTable) -> RawTable:
    """Return a table without a header with names: t for the first column where it ascends, x1, x2, … for others."""
    has_time = len(raw.headers) > 1 and ascends(raw.columns[0], raw.starts)
    count = len(raw.headers) - has_time
    names = (*(("t",) if has_time else ()), *(("x",) if count == 1 else [f"x{place + 1}" for place in range(count)]))
    return replace(raw, headers=names, remarks=(*raw.remarks, f"no header: columns are called {', '.join(names)}"))


def are_groups(top: Sequence[str], names: Sequence[str], below: Sequence[Sequence[str]]) -> bool:
    """Tell whether `top` holds names of groups of the columns that `names` names; `below` are a row or two of data.

    The names of a header are complete and differ; those of groups leave out cells that the row below them fills, above
    numbers, or are repeated. A row of units stands below the header.
    """
    texts = [cell.strip() for cell in top]
    filled = [text for text in texts if text]
    called = [name.strip() for name in names]
    if len(texts) != len(called) or not filled or any(map(is_numeral, (*filled, *called))):
        return False
    if any(text in TIME_NAMES for text in filled) or all(are_units([plain_unit(name)]) for name in called if name):
        return False

    def is_column(place: int) -> bool:
        cells = [row[place] for row in below if place < len(row)]
        return any(not is_missing(cell) and (is_numeral(cell) or is_date(cell)) for cell in cells)

    new = [place for place, name in enumerate(called) if name and not texts[place] and is_column(place)]
    if any(place > 0 or called[place] in TIME_NAMES for place in new):
        return True
    if not texts[0] and not called[0] and below and _names_index(below[0]):
        return True
    is_repeated = len(set(filled)) < len(filled)
    has_time = any(name in TIME_NAMES for name in called)
    return is_repeated and any(map(is_column, range(len(called)))) and (has_time or not is_units_row(names, top))


def _names_index(cells: Sequence[str]) -> bool:
    """Tell whether a row names nothing but its first column."""
    return bool(cells) and not is_missing(cells[0]) and not is_numeral(cells[0]) and not any(map(str.strip, cells[1:]))
