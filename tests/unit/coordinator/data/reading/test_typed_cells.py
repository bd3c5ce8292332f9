"""What a format holds as a number or a date is that, however the text around it is written."""

import datetime
import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import openpyxl
import pytest

from atoll.api.tables import table_of
from atoll_coordinator.data.reading.cells import NumberCell, cell_of
from atoll_core.config import DataConfig
from atoll_core.data.table import Table
from atoll_core.errors import DataError

Row = Sequence[object]
Entrance = Callable[[Path, Sequence[str], Sequence[Row]], object]


def workbook(folder: Path, header: Sequence[str], rows: Sequence[Row]) -> object:
    book = openpyxl.Workbook()
    for row in (header, *rows):
        book.active.append(list(row))
    book.save(folder / "a.xlsx")
    return folder / "a.xlsx"


def records(folder: Path, header: Sequence[str], rows: Sequence[Row]) -> object:
    (folder / "a.json").write_text(json.dumps([dict(zip(header, row, strict=True)) for row in rows]), "utf-8")
    return folder / "a.json"


def frame(_: Path, header: Sequence[str], rows: Sequence[Row]) -> object:
    import pandas

    return pandas.DataFrame([*rows], columns=[*header], dtype=object)


ENTRANCES: dict[str, Entrance] = {
    "workbook": workbook,
    "records": records,
    "frame": frame,
    "object arrays": lambda _, header, rows: {
        name: np.array([row[place] for row in rows], dtype=object) for place, name in enumerate(header)
    },
}


@pytest.fixture(params=ENTRANCES)
def read(request: pytest.FixtureRequest, tmp_path: Path) -> Callable[[Sequence[str], Sequence[Row]], Table]:
    return lambda header, rows: table_of(ENTRANCES[request.param](tmp_path, header, rows), DataConfig())


def test_numbers_with_three_decimals_are_no_thousands_beside_decimal_commas(read) -> None:
    """1.234 was read as 1234 from a workbook in which another column held text with decimal commas."""
    table = read(("t", "x", "y"), [(0, 1.234, "0,5"), (1, 2.345, "0,6"), (2, 3.456, "0,75"), (3, 4.567, "1,25")])
    assert table.column("x").tolist() == [1.234, 2.345, 3.456, 4.567]
    assert table.column("y").tolist() == [0.5, 0.6, 0.75, 1.25]
    assert "separators of thousands" not in table.read_as


def test_numbers_and_texts_of_one_column_are_read_each_as_it_is_meant(read) -> None:
    """A column in which some cells were typed as text, with decimal commas, was refused."""
    table = read(("t", "x"), [(0, 1.5), (1, "0,6"), (2, 2.125), (3, "1.024,5")])
    assert table.column("x").tolist() == [1.5, 0.6, 2.125, 1024.5]


def test_numbers_do_not_tell_how_texts_are_written(read) -> None:
    with pytest.raises(DataError, match=r"holds '1,234', which may be 1234 or 1\.234"):
        read(("t", "x", "y"), [(0, "1,234", 0.5), (1, "2,345", 0.25), (2, 1.5, 0.125)])


def test_numbers_of_a_long_table_stay_what_they_are(read) -> None:
    rows = [("a", 0, 1.234), ("a", 1, 2.345), ("b", 0, "0,5"), ("b", 1, "0,6")]
    table = read(("variable", "time", "value"), rows)
    assert (table.column("a").tolist(), table.column("b").tolist()) == ([1.234, 2.345], [0.5, 0.6])


def test_dates_of_a_workbook_are_dates_however_texts_are_written(tmp_path: Path) -> None:
    days = [datetime.datetime(2021, 4, day) for day in (3, 4, 5, 6)]
    path = workbook(tmp_path, ("day", "x"), [*zip(days, ("0,5", "0,6", "0,75", "1,25"), strict=True)])
    table = table_of(path, DataConfig())
    assert table.column("time").tolist() == [0.0, 1.0, 2.0, 3.0]
    assert "since 2021-04-03" in table.read_as


def test_a_number_that_a_spreadsheet_has_made_a_date_is_refused(tmp_path: Path) -> None:
    rows = [(0, 1.5), (1, datetime.datetime(2021, 5, 1)), (2, 2.5)]
    with pytest.raises(DataError, match=r"column 'x' of a\.xlsx holds '2021-05-01T00:00:00' in line 3 where a number"):
        table_of(workbook(tmp_path, ("t", "x"), rows), DataConfig())


@pytest.mark.parametrize("value", [1, 1.5, True, np.float64(1.5), np.int64(3), np.float32(0.25)])
def test_numbers_of_all_kinds_are_cells_of_numbers(value: object) -> None:
    cell = cell_of(value)
    assert isinstance(cell, NumberCell)
    assert isinstance(cell.strip(), NumberCell)
    assert float(cell) == value
