"""Files whose table does not begin in the first line: titles, settings and rows of a recorder stand above it."""

import numpy as np
import openpyxl
import pytest

from atoll_coordinator.data.reading.files import read_table
from atoll_core.config import DataConfig
from atoll_core.errors import DataError

ROWS = [(0.5 * row, 1.25 + row, 3.5 - row * row) for row in range(12)]


def body(form: str = "{},{},{}\n") -> str:
    return "".join(form.format(*row) for row in ROWS)


PREAMBLES = {
    "lines of text": (
        "Instrument: FooMeter\nSerial: 123\n\nt,x,y\n" + body(),
        "lines 1 to 2 above the header left out",
    ),
    "a title": ("Run 3 of Monday\nt,x,y\n" + body(), "line 1 above the header left out"),
    "a title with as many cells": ("Experiment, run 3, by me\nt,x,y\n" + body(), "line 1 above the header left out"),
    "settings": (
        "Device,FM-1\nRate,100\nDate,2020-01-01\n\nt,x,y\n" + body(),
        "lines 1 to 3 above the header left out",
    ),
    "settings without a blank line": ("Device,FM-1\nRate,100\nt,x,y\n" + body(), "lines 1 to 2 above"),
    "settings with empty cells": ("Device,FM-1,\nRate,100,\n,,\nt,x,y\n" + body(), "lines 1 to 2 above"),
    "sections": ("[Header]\nversion=2\n[Data]\nt\tx\ty\n" + body("{}\t{}\t{}\n"), "lines 1 to 3 above"),
    "decimal commas": ("Gerät;FM-1\nWert;1,5\n\nt;x;y\n" + body("{};{};{}\n").replace(".", ","), "lines 1 to 2 above"),
    "spaces": ("made by FM 1\nversion 2\n\n  t   x   y\n" + body("{:8.3f} {:8.3f} {:9.3f}\n"), "lines 1 to 2 above"),
    "Latin-1": ("Gerät,1\n\nt,x,y\n".encode("latin-1") + body().encode(), "line 1 above the header left out"),
    "UTF-16": (("Gerät,1\n\nt,x,y\n" + body()).encode("utf-16"), "line 1 above the header left out"),
    "comments in between": ("Device,FM-1\n# a comment\nRate,100\n\nt,x,y\n" + body(), "lines 1 to 3 above the header"),
    "units below": ("Device,FM-1\n\nt,x,y\ns,m,m\n" + body(), "line 1 above the header left out; units in line 4"),
    "groups below": ("Device,FM-1\n\n,ball,\nt,x,y\n" + body(), "header in line 4 below names of groups: ball"),
    "rows of a logger": (
        '"TOA5","CR1","8","os","prog"\n"t","x","y"\n"Smp","Wind","Level"\n"","Avg","Avg"\n' + body(),
        "line 1 above the header left out; lines 3 to 4 below the header left out",
    ),
}


@pytest.mark.parametrize("kind", PREAMBLES)
def test_what_stands_above_a_header_is_passed_over_and_named(kind, read):
    text, says = PREAMBLES[kind]
    table = read(text)
    assert table.names == ("t", "x", "y")
    assert np.allclose(table.columns.T, ROWS)
    assert says in table.read_as
    assert table.starts == (0,)


def test_a_preamble_of_two_columns_is_told_by_the_name_of_the_time(read):
    table = read("Device,FM-1\nOperator,Bob\nTime,Level\n0,1\n1,2\n2,4\n")
    assert (table.names, table.line_of_row.tolist()) == (("Time", "Level"), [4, 5, 6])


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("a,b\nzero,one\n0,1\n1,2\n", "column 'a' of a.csv holds 'zero' in line 2"),
        ("a,b\nc,d\ne,f\n0,1\n1,2\n", "column 'a' of a.csv holds 'c' in line 2"),
        ("t,x\n0,1\n1,2\n\nt,x\n0,3\n1,4\n", "column 't' of a.csv holds 't' in line 5"),
    ],
)
def test_rows_of_text_of_which_any_may_be_the_header_are_refused(text, sentence, read):
    with pytest.raises(DataError) as raised:
        read(text)
    assert sentence in str(raised.value)


def test_a_title_of_a_workbook_may_have_more_cells_than_its_header(tmp_path):
    book = openpyxl.Workbook()
    for cells in (["Experiment", "run 3", "by me"], ["t", "x"], *([t, x, "ok"] for t, x, _ in ROWS)):
        book.active.append(cells)
    book.save(tmp_path / "a.xlsx")
    table = read_table([tmp_path / "a.xlsx"], DataConfig())
    assert (table.names, table.skipped, table.rows) == (("t", "x"), ("column 3",), len(ROWS))


def test_a_workbook_may_have_settings_above_its_table(tmp_path):
    book = openpyxl.Workbook()
    for cells in (["Device", "FM-1"], ["Rate", 100], [], ["t", "x", "y"], *map(list, ROWS)):
        book.active.append(cells)
    book.save(tmp_path / "a.xlsx")
    table = read_table([tmp_path / "a.xlsx"], DataConfig())
    assert table.names == ("t", "x", "y")
    assert np.allclose(table.columns.T, ROWS)
    assert "lines 1 to 2 above the header left out" in table.read_as


@pytest.mark.parametrize("separator", [",", ";"])
def test_dates_with_spaces_below_a_row_of_units_split_nothing(read, separator):
    rows = [["Date Time", "Temp C"], ["yyyy-mm-dd hh:mm", "degC"]]
    rows += [[f"2021-03-01 0{hour}:00", f"{hour}.5"] for hour in range(8)]
    table = read("".join(separator.join(row) + "\n" for row in rows), time="Date Time")
    assert table.names == ("Date Time", "Temp C")
    assert table.column("Temp C").tolist() == [hour + 0.5 for hour in range(8)]
