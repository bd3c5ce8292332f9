"""Dates and clock times: forms, order of day and month, midnight, zones, units; which column of dates is the time."""

import datetime
from pathlib import Path

import pytest

from atoll_coordinator.data.reading.dates import NANOSECONDS, Dates, read_dates, times_of
from atoll_coordinator.data.reading.files import read_table
from atoll_core.config import DataConfig
from atoll_core.data.table import Table
from atoll_core.errors import DataError

S, H, D = (NANOSECONDS[unit] for unit in ("s", "h", "d"))


def dates_of(*cells, starts=(0,)):
    return read_dates("column 't' of a.csv", cells, starts, range(2, 99))


def since_1970(*date):
    return int(datetime.datetime(*date, tzinfo=datetime.UTC).timestamp()) * S


@pytest.mark.parametrize(
    ("cell", "date"),
    [
        ("2020-02-29", (2020, 2, 29)),
        ("2020/2/9 7:05", (2020, 2, 9, 7, 5)),
        ("2020-02-29T07:05:06Z", (2020, 2, 29, 7, 5, 6)),
        ("2020-02-29 07:05:06+02:30", (2020, 2, 29, 4, 35, 6)),
        ("2020-02-29 07:05:06 -0100", (2020, 2, 29, 8, 5, 6)),
        ("2020-02", (2020, 2, 1)),
        ("29.2.2020 07:05", (2020, 2, 29, 7, 5)),
        ("29.02.20", (2020, 2, 29)),
        ("29/02/2020", (2020, 2, 29)),
        ("2/29/2020 1:05 PM", (2020, 2, 29, 13, 5)),
        ("29-Feb-2020 07:05:06", (2020, 2, 29, 7, 5, 6)),
        ("29 February 2020", (2020, 2, 29)),
        ("Feb 29, 2020", (2020, 2, 29)),
        ("1969-12-31 23:00", (1969, 12, 31, 23)),
    ],
)
def test_a_date_is_read(cell, date):
    assert dates_of(cell).nanoseconds == (since_1970(*date),)


@pytest.mark.parametrize(
    ("cell", "seconds"),
    [("7:05", 25500), ("00:00:01,25", 1.25), ("12:00:00 AM", 0), ("36:00:00", 129600), ("1 days 00:00:02", 86402)],
)
def test_a_clock_time_is_read(cell, seconds):
    assert dates_of(cell).nanoseconds == (round(seconds * S),)


def test_a_fraction_keeps_its_nanoseconds():
    assert dates_of("2020-01-01T00:00:00.123456789").nanoseconds == (since_1970(2020, 1, 1) + 123456789,)


@pytest.mark.parametrize(
    ("cells", "form"),
    [
        (("01/02/2020", "13/02/2020"), "dates day/month/year"),
        (("01/02/2020", "01/13/2020"), "dates month/day/year"),
        (("31-01-2020", "01-02-2020"), "dates day-month-year"),
        (("10/01/2020", "11/01/2020", "01/02/2020"), "dates day/month/year"),
        (("01.02.2020", "02.02.2020"), "dates day.month.year"),
    ],
)
def test_the_other_dates_tell_day_from_month(cells, form):
    assert dates_of(*cells).form == form


def test_day_and_month_do_not_matter_where_all_are_of_one_day():
    dates = dates_of("03/01/2021 06:00", "03/01/2021 06:30")
    assert dates.form == "dates day/month/year (or month/day/year: all are of one day)"
    assert times_of([dates], (0,), None)[0].tolist() == [0.0, 30.0]


def test_a_clock_goes_on_past_midnight_within_a_trajectory():
    dates = dates_of("23:00", "01:00", "23:00", "02:00", "04:00", starts=(0, 4))
    assert dates.nanoseconds == (23 * H, 25 * H, 47 * H, 50 * H, 4 * H)


@pytest.mark.parametrize(
    ("cells", "unit", "step"),
    [
        (("2020-01-01", "2020-01-02", "2020-01-03"), "d", 1.0),
        (("2020-01-01", "2020-02-01", "2020-03-01"), "d", 31.0),
        (("2020-01-01 00:00", "2020-01-01 06:00", "2020-01-01 12:00"), "h", 6.0),
        (("2020-01-01 00:00", "2020-01-01 00:15", "2020-01-01 00:30"), "min", 15.0),
        (("2020-01-01 00:00:00.0", "2020-01-01 00:00:00.5", "2020-01-01 00:00:01.0"), "s", 0.5),
    ],
)
def test_the_unit_is_the_longest_that_a_usual_step_has(cells, unit, step):
    times, time_unit, remark, _ = times_of([dates_of(*cells)], (0,), None)
    assert (time_unit, times[1] - times[0], times[0]) == (unit, step, 0.0)
    assert remark.endswith(f"in {unit} since {'2020-01-01' if cells[0] == '2020-01-01' else '2020-01-01 00:00:00'}")


def test_files_read_together_have_one_unit_and_one_beginning():
    times, unit, *_ = times_of(
        [dates_of("2020-01-01", "2020-01-02"), dates_of("2020-01-05", "2020-01-06")], (0, 2), None
    )
    assert (times.tolist(), unit) == ([0.0, 1.0, 4.0, 5.0], "d")


def test_a_unit_may_be_asked_for():
    assert times_of([dates_of("2020-01-01", "2020-01-02")], (0,), "h")[0].tolist() == [0.0, 24.0]
    assert times_of([dates_of("2020-01-01", "2020-01-02")], (0,), "hours")[1] == "hours"
    with pytest.raises(DataError, match="counted in d, h, min, s, but 'fortnights' is wanted"):
        times_of([dates_of("2020-01-01", "2020-01-02")], (0,), "fortnights")


def test_only_missing_dates_are_refused():
    with pytest.raises(DataError, match="holds no date"):
        times_of([Dates((None,), "dates", has_date=True)], (0,), None)


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


def test_dates_without_marks_are_dates_where_their_column_is_called_so(tmp_path: Path) -> None:
    table = read(tmp_path, "Date,x,n", "20210228,1,20210228", "20210301,2,20210301")
    assert (table.names, table.column("time").tolist()) == (("time", "x", "n"), [0.0, 1.0])
    assert table.column("n").tolist() == [20210228.0, 20210301.0]
    assert read(tmp_path, "date,t,x", "20210228,0,1", "20210301,1,2").skipped == ("date",)
    assert read(tmp_path, "date,x", "20210228,1", "20211301,2").names == ("date", "x")
    runs = read(tmp_path, "date,t,x", "20210228,0,1", "20210301,1,2", config=DataConfig(trajectory="date"))
    assert runs.column("date").tolist() == [20210228.0, 20210301.0]
