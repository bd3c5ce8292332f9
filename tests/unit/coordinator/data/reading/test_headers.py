"""Where a table begins: headers below names of groups, in comments, below titles and settings, or none at all."""

import numpy as np
import openpyxl
import pytest

from atoll_coordinator.data.reading.files import read_table
from atoll_core.config import DataConfig
from atoll_core.errors import DataError


def test_a_header_may_stand_below_names_of_groups(read):
    table = read(",ball,,\nt,step,x,\n0,0,1.5,\n0.1,1,1.25,\n")
    assert table.names == ("t", "step", "x")
    assert table.columns.tolist() == [[0.0, 0.1], [0.0, 1.0], [1.5, 1.25]]
    assert table.line_of_row.tolist() == [3, 4]
    assert table.read_as == "text with commas; header in line 2 below names of groups: ball"


def test_units_may_stand_below_both_lines_of_a_header(read):
    table = read("# from a camera\n;left hand;\nt;x;y pos\ns;m;cm\n0;1;2\n1;3;4\n")
    assert table.names == ("t", "x", "y pos")
    assert table.units == ("s", "m", "cm")
    assert "header in line 3 below names of groups: left hand" in table.read_as


def test_names_that_several_groups_have_carry_that_of_their_group(read):
    table = read("\n,ball 1,,ball 2,,\nt,x,y,t,x,y\n0,1,2,0,3,4\n1,5,6,1,7,8\n")
    assert table.names == ("t", "ball 1 x", "ball 1 y", "ball 2 x", "ball 2 y")
    assert table.column("ball 2 x").tolist() == [3.0, 7.0]


def test_times_of_groups_that_differ_are_not_one(read):
    table = read(",A,,B,\nclock,x,,clock,x\n0,1,,0.5,3\n1,5,,1.5,7\n", time="A clock")
    assert table.names == ("clock", "A x", "B clock", "B x")


def test_two_levels_of_columns_of_pandas_are_a_header(read):
    table = read(",A,A,B\n,x,y,x\nt,,,\n0.0,1,2,3\n0.5,4,5,6\n")
    assert table.names == ("t", "A x", "y", "B x")
    assert table.columns.tolist() == [[0.0, 0.5], [1.0, 4.0], [2.0, 5.0], [3.0, 6.0]]


@pytest.mark.parametrize(
    ("text", "names", "units"),
    [
        (",t,x\nunit,s,m\n1,0,5\n2,1,6\n", ("t", "x"), ("s", "m")),
        ("t,,x\ns,V,widgets\n0,1,5\n1,2,6\n", ("t", "x"), ("s", "widgets")),
        ("year,,x\na,V,m\n0,1,5\n1,2,6\n", ("year", "x"), ("a", "m")),
        (",t,x\n1,0,5\n2,1,6\n", ("t", "x"), ("", "")),
        ("t,x,\ns,m,\n0,1,\n1,2,\n", ("t", "x"), ("s", "m")),
    ],
)
def test_a_row_of_units_is_no_header(read, text, names, units):
    table = read(text)
    assert (table.names, table.units) == (names, units)


@pytest.mark.parametrize("mark", ["%", "#", "# "])
def test_a_comment_is_the_header_of_rows_that_hold_text_too(read, mark):
    table = read(f"{mark}time,frame id,x pos\n0.0,world,1\n0.1,world,2\n0.2,map,4\n")
    assert table.names == ("time", "x pos")
    assert table.columns.tolist() == [[0.0, 0.1, 0.2], [1.0, 2.0, 4.0]]
    assert table.read_as == "text with commas; header in a comment; text left out: frame id"


@pytest.mark.parametrize(
    "text",
    [
        "# made by us, on monday, again\nt,run,x\n0,a,1\n1,a,2\n",
        "# made by us today\nt,run,x\n0,a,1\n1,a,2\n",
        "# time, run, 7\nt,run,x\n0,a,1\n1,a,2\n",
    ],
)
def test_a_header_that_stands_below_a_comment_stays_the_header(read, text):
    assert read(text).names == ("t", "x")


def test_words_of_a_remark_are_no_header_of_rows_with_text(read):
    """Of such rows the comment has to have the separator of the rows, not only as many words."""
    table = read("# measured on monday\n0.0,world,1\n0.1,world,2\n0.2,world,4\n")
    assert not {"measured", "monday"} & {*table.names, *table.skipped}


STAMP = 1_700_000_000_123_456_789
STEPS = (0, 20_000_001, 41_000_000, 60_500_000)


def test_nanoseconds_since_1970_are_times_in_seconds(read):
    rows = "".join(f"{STAMP + step},{STAMP},{step}\n" for step in STEPS)
    table = read("time,header stamp,x\n" + rows)
    assert (table.names, table.units) == (("time", "x"), ("s", ""))
    assert table.column("time") == pytest.approx(np.array(STEPS) / 1e9, abs=1e-15)
    assert "time: nanoseconds since 1970, in s since 2023-11-14 22:13:20.123456789 UTC" in table.read_as
    assert table.skipped == ("header stamp",)


@pytest.mark.parametrize(
    ("text", "options"),
    [
        (f"t,x\n{STAMP},1\n{STAMP + 10**7},2\n", {"units": {"t": "ns"}}),
        (f"t [ns],x\n{STAMP},1\n{STAMP + 10**7},2\n", {}),
        (f"t,x\n{STAMP / 1e9:.3f},1\n{STAMP / 1e9 + 1:.3f},2\n", {}),
        (f"t,x\n{STAMP // 10**6},1\n{STAMP // 10**6 + 1},2\n", {}),
    ],
)
def test_times_with_a_unit_and_shorter_numbers_stay_as_they_are(read, text, options):
    times = read(text, **options).column("t")
    assert times[0] > 1e9


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("0 1.5 2\n0.5 1.25 3\n1 1 4\n", ("t", "x1", "x2")),
        ("0,1.5\n0.5,1.25\n1,1\n\n0,1\n0.5,7\n", ("t", "x")),
        ("0;1,5\n0,5;1,25\n1;1\n", ("t", "x")),
        ("3,1\n2,2\n4,1\n", ("x1", "x2")),
        ("2020-01-01,1,ok\n2020-01-02,2,bad\n2020-01-03,1,ok\n", ("t", "x1")),
        ("2020-01-01,1\n2020-01-02,2\n2020-01-03,1\n", ("t", "x")),
        ("# run 7\n0,1.5,3\n1,1.25,2\n", ("t", "x1", "x2")),
    ],
)
def test_a_table_without_a_header_keeps_its_first_row(text, names, read):
    table = read(text)
    assert table.names == names
    assert table.rows == sum(map(bool, text.replace("# run 7\n", "").splitlines()))
    assert f"no header: columns are called {', '.join(names)}" in table.read_as


def test_a_workbook_and_an_array_without_a_header_keep_their_first_rows(tmp_path):
    rows = [[0.0, 1.5, 2.0], [0.5, 1.25, 3.0], [1.0, 1.0, 4.0]]
    book = openpyxl.Workbook()
    for row in rows:
        book.active.append(row)
    book.save(tmp_path / "a.xlsx")
    np.save(tmp_path / "a.npy", np.array(rows))
    for name in ("a.xlsx", "a.npy"):
        table = read_table([tmp_path / name], DataConfig())
        assert (table.names, table.columns.T.tolist()) == (("t", "x1", "x2"), rows)


@pytest.mark.parametrize(
    ("text", "names", "skipped"),
    [
        ("t,x\n0,1.5,a\n1,2.5,b\n", ("t", "x"), ("column 3",)),
        ("t,x\n0,1.5,7,8,9\n1,2.5,7,7,7\n", ("t", "x"), ("column 3", "column 4", "column 5")),
        ("x t\n7 2.5 0\n5 1.5 1\n", ("x", "t"), ("column 1",)),
        ("t;x\nb;0;1\na;0,5;2\nc;1;2\n", ("t", "x"), ("column 1",)),
        ("t,x\n0,1.5,,\n1,2.5,,\n", ("t", "x"), ()),
    ],
)
def test_columns_beyond_the_header_are_left_out_and_named(text, names, skipped, read):
    table = read(text)
    assert (table.names, table.skipped) == (names, skipped)
    assert ("text left out: " + ", ".join(skipped) in table.read_as) == bool(skipped)


@pytest.mark.parametrize(
    "text",
    [
        "t,x\n0,0,1,5\n1,0,2,5\n",  # decimal commas
        "t,x\n0,1,5\n1,2,5\n",  # these, in one column only
        "t;x\n1;0,5;2\n2;1;2\n",  # both the first and the last two may be meant
        "a,b\n5,1.5,0\n7,2.5,1\n",  # nothing tells
    ],
)
def test_columns_beyond_the_header_that_may_be_something_else_are_refused(text, read):
    with pytest.raises(DataError, match="where the header has 2"):
        read(text)


@pytest.mark.parametrize("header", ["0,1", "1,2"])
def test_numbers_in_place_of_names_are_no_row(read, header):
    """As frames without names of columns are written."""
    with pytest.raises(DataError, match="holds numbers only"):
        read(header + "\n" + "".join(f"{10 + n / 10},{n}.5\n" for n in range(8)))
    assert read("," + header + "\n" + "".join(f"{n},{10 + n / 10},{n}.5\n" for n in range(8))).rows == 8


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


@pytest.mark.parametrize("separator", [",", ";"])
def test_dates_with_spaces_below_a_row_of_units_split_nothing(read, separator):
    rows = [["Date Time", "Temp C"], ["yyyy-mm-dd hh:mm", "degC"]]
    rows += [[f"2021-03-01 0{hour}:00", f"{hour}.5"] for hour in range(8)]
    table = read("".join(separator.join(row) + "\n" for row in rows), time="Date Time")
    assert table.names == ("Date Time", "Temp C")
    assert table.column("Temp C").tolist() == [hour + 0.5 for hour in range(8)]
