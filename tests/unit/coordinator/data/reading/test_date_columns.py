"""Which column of dates is the time, and when dates are left alone."""

from pathlib import Path

import pytest

from atoll_coordinator.data.reading.files import read_table
from atoll_core.config import DataConfig
from atoll_core.data.table import Table


def read(folder: Path, header: str, *rows: str, config: DataConfig | None = None) -> Table:
    (folder / "a.csv").write_text("\n".join([header, *rows, ""]))
    return read_table([folder / "a.csv"], config or DataConfig())


def test_date_and_clock_in_two_columns_are_the_time(tmp_path: Path) -> None:
    table = read(tmp_path, "Date,Time of day,x", "2020-01-01,23:30,1", "2020-01-02,00:30,2")
    assert (table.names, table.units, table.column("time").tolist()) == (("time", "x"), ("h", ""), [0.0, 1.0])
    assert table.skipped == ()


def test_a_column_that_is_named_keeps_its_name(tmp_path: Path) -> None:
    rows = ("2020-01-01,2020-02-01,1", "2020-01-02,2020-02-02,2")
    table = read(tmp_path, "begin,end,x", *rows, config=DataConfig(time="end"))
    assert (table.names, table.units, table.skipped) == (("end", "x"), ("d", ""), ("begin",))


@pytest.mark.parametrize("header", ["t,date,x", "time,date,x"])
def test_dates_beside_a_time_of_numbers_are_left_out(header: str, tmp_path: Path) -> None:
    table = read(tmp_path, header, "0,2020-01-01,1", "1,2020-01-02,2")
    assert table.skipped == ("date",)
    assert "text left out: date" in table.read_as


def test_the_configuration_may_say_the_unit(tmp_path: Path) -> None:
    table = read(tmp_path, "t,x", "2020-01-01,1", "2020-01-02,2", config=DataConfig(units={"t": "h"}))
    assert (table.units, table.column("t").tolist()) == (("h", ""), [0.0, 24.0])


def test_dates_without_marks_are_dates_where_their_column_is_called_so(tmp_path: Path) -> None:
    table = read(tmp_path, "Date,x,n", "20210228,1,20210228", "20210301,2,20210301")
    assert (table.names, table.column("time").tolist()) == (("time", "x", "n"), [0.0, 1.0])
    assert table.column("n").tolist() == [20210228.0, 20210301.0]
    assert read(tmp_path, "date,t,x", "20210228,0,1", "20210301,1,2").skipped == ("date",)
    assert read(tmp_path, "date,x", "20210228,1", "20211301,2").names == ("date", "x")
    runs = read(tmp_path, "date,t,x", "20210228,0,1", "20210301,1,2", config=DataConfig(trajectory="date"))
    assert runs.column("date").tolist() == [20210228.0, 20210301.0]


def test_dates_may_name_trajectories(tmp_path: Path) -> None:
    table = read(tmp_path, "trajectory,t,x", "2020-01-01,0,1", "2020-01-02,0,2")
    assert table.column("trajectory").tolist() == [1.0, 2.0]


def test_dates_are_left_out_of_a_regression(tmp_path: Path) -> None:
    assert read(tmp_path, "date,x,y", "2020-01-01,1,2", config=DataConfig(target="y")).names == ("x", "y")
