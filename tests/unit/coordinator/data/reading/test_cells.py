"""Numbers as countries write them; numbers and dates that a format stores as such, whatever the text around them."""

import datetime
import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import openpyxl
import pytest

from atoll.api.tables import table_of
from atoll_coordinator.data.reading.cells import parse_numbers
from atoll_core.config import DataConfig
from atoll_core.data.table import Table
from atoll_core.errors import DataError


def numbers(separator=",", **columns):
    cells = {name: text.split("|") for name, text in columns.items()}
    read, remarks = parse_numbers("a.csv", cells, [0] * len(next(iter(cells.values()))), separator)
    return {name: values.tolist() for name, values in read.items()}, remarks


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1,234.5|6", [1234.5, 6.0]),
        ("1,234,567|1.5", [1234567.0, 1.5]),
        ("1.234,5|6", [1234.5, 6.0]),
        ("0,5|-1,25e-3", [0.5, -0.00125]),
        ("1 234,5|2", [1234.5, 2.0]),
        ("1 234.5|2", [1234.5, 2.0]),
        ("1'234.5|2", [1234.5, 2.0]),
        ("1 234|5 678", [1234.0, 5678.0]),
        ("1.234.567|0", [1234567.0, 0.0]),
        ("0,100|0,103|-0,106", [0.1, 0.103, -0.106]),
        ("1.00000D+00|9.5d-1|.5D0", [1.0, 0.95, 0.5]),
    ],
)
def test_a_column_tells_how_it_is_written(text, expected):
    assert numbers("\t", x=text)[0]["x"] == expected


@pytest.mark.parametrize(("separator", "expected"), [(",", 1234.0), (";", 1.234)])
def test_what_separates_cells_decides_where_nothing_else_does(separator, expected):
    assert numbers(separator, x="1,234|2,345")[0]["x"][0] == expected


def test_other_columns_decide_before_that():
    assert numbers(";", x="1,234|2,345", t="0.5|1.5")[0]["x"] == [1234.0, 2345.0]
    assert numbers("\t", x="1,234|2,345", t="0,5|1,5")[0]["x"] == [1.234, 2.345]


def test_a_group_of_thousands_never_begins_with_zero():
    read, remarks = numbers(",", t="0,000|0,100", x="4,000|3,715")
    assert (read, remarks) == ({"t": [0.0, 0.1], "x": [4.0, 3.715]}, ("decimal commas in t, x",))


def test_columns_that_contradict_each_other_decide_nothing():
    with pytest.raises(DataError, match=r"'x' of a\.csv holds '4,000', which may be 4000 or 4;"):
        numbers(",", t="0,5|1,5", y="0.5|1.5", x="4,000|3,715")


def test_points_separate_thousands_where_commas_are_decimal():
    read, remarks = numbers(";", x="1.234|12.345", t="0,5|1,5")
    assert read["x"] == [1234.0, 12345.0]
    assert remarks == ("decimal commas in t", "separators of thousands in x")
    assert numbers(";", x="1.234|12.5", t="0,5|1,5")[0]["x"] == [1.234, 12.5]


def test_points_and_commas_of_three_digits_are_read_as_one_country_writes_them():
    assert numbers(";", x="1.234|12.345", y="1,234|2,345")[0] == {"x": [1234.0, 12345.0], "y": [1.234, 2.345]}


@pytest.mark.parametrize("text", ["1,23,456", "12,34.5", "1.2.3", "1,234 567", "0x10", "1,5,6", "4_002", "1D2", ".D2"])
def test_other_texts_are_no_numbers(text):
    with pytest.raises(DataError, match="where a number is expected"):
        numbers(x=f"1|{text}")


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
