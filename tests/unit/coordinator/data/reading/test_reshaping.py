"""Long tables, times in the header and times in several columns become a row for each time."""

import numpy as np
import polars
import pytest

from atoll.api.tables import table_of
from atoll_coordinator.data.roles.roles import assign_roles
from atoll_coordinator.data.trajectories.measurements import take_measurements
from atoll_core.config import DataConfig
from atoll_core.errors import DataError


def long(header="variable,t,value", names=("prey", "big cat"), times=range(6), form="{name},{time},{value}"):
    """Return a long table, one name after the other, whose values are 10 times the time, and 1 more for each name."""
    rows = [
        form.format(name=name, time=time, value=10 * time + number)
        for number, name in enumerate(names)
        for time in times
    ]
    return "\n".join([header, *rows, ""])


def test_each_observable_becomes_a_column(read):
    table = read(long())
    assert table.names == ("t", "prey", "big cat")
    assert table.column("prey").tolist() == [0.0, 10.0, 20.0, 30.0, 40.0, 50.0]
    assert table.column("big cat").tolist() == [1.0, 11.0, 21.0, 31.0, 41.0, 51.0]
    assert table.starts == (0,)
    assert "a long table, with a column for each 'variable': prey, big cat" in table.read_as


def test_times_are_put_in_order_and_what_was_not_measured_is_missing(read):
    table = read("Species,Time,Concentration\nA,0,1\nA,5.0,2\nA,20,3\nB,10,4\nB,0.0,5\nB,5,6\n")
    assert table.names == ("Time", "A", "B")
    assert table.column("Time").tolist() == [0.0, 5.0, 10.0, 20.0]
    assert str(table.column("A").tolist()) == "[1.0, 2.0, nan, 3.0]"
    assert str(table.column("B").tolist()) == "[5.0, 6.0, 4.0, nan]"
    assert table.line_of_row.tolist() == [2, 3, 5, 4]


def test_conditions_and_replicates_are_trajectories_with_names(read):
    conditions = "preequilibrationConditionId\tsimulationConditionId\treplicateId"
    header = f"observableId\t{conditions}\tmeasurement\ttime\tnoiseParameters"
    rows = [
        f"{name}\t\t{condition}\t{replicate}\t{10 * time + replicate}\t{time}\tsd_{name}"
        for condition in ("low", "high")
        for name in ("pA", "pB")
        for replicate in (1, 2)
        for time in range(5)
    ]
    table = read("\n".join([header, *rows, ""]), "a.tsv")
    assert table.names == ("time", "trajectory", "pA", "pB")
    assert table.starts == (0, 5, 10, 15)
    assert table.labels == {"trajectory": ("low/1", "low/2", "high/1", "high/2")}
    assert table.column("pB").tolist()[5:10] == [2.0, 12.0, 22.0, 32.0, 42.0]
    assert "trajectories by simulationConditionId, replicateId" in table.read_as
    assert "left out: preequilibrationConditionId, noiseParameters" in table.read_as
    config = DataConfig(holdout="trajectory=high/1")
    roles, options = assign_roles(table, config)
    measured = take_measurements(table, roles, options)
    assert measured.held_out == (False, False, True, False)
    assert measured.trajectories is not None
    assert measured.trajectories.names == ("low/1", "low/2", "high/1", "high/2")


def test_what_options_name_is_kept(read):
    form = "{name},{time},{value},warm,37"
    text = long("variable,t,value,run,T", form=form) + long("", form="{name},{time},{value},cold,4")[1:]
    table = read(text, trajectory="run", inputs=("T",))
    assert table.names == ("t", "run", "T", "prey", "big cat")
    assert table.labels == {"run": ("warm", "cold")}
    assert table.column("T").tolist() == [37.0] * 6 + [4.0] * 6
    with pytest.raises(
        DataError, match=r"column 'T' of a\.csv, a long table, differs between observables at the same time"
    ):
        read("variable,t,value,T\nA,0,1,7\nA,1,2,7\nB,0,3,8\nB,1,3,7\n", inputs=("T",))


@pytest.mark.parametrize(
    ("header", "form", "units"),
    [
        ("name,t [h],value [mg/L]", "{name},{time},{value}", ("h", "mg/L", "mg/L")),
        ("name,t,value,unit", "{name},{time},{value},{name} u", ("", "prey u", "big cat u")),
        ("name,t,value\nnone,h,g", "{name},{time},{value}", ("h", "g", "g")),
    ],
)
def test_units_are_those_of_the_values(read, header, form, units):
    assert read(long(header, form=form)).units == units


def test_dates_and_decimal_commas_are_times(read):
    rows = [f"{name};2024-01-0{day};1,{day}" for name in "AB" for day in (1, 2, 4)]
    table = read("\n".join(["signal;time;value", *rows, ""]))
    assert (table.names, table.units) == (("time", "A", "B"), ("d", "", ""))
    assert table.column("time").tolist() == [0.0, 1.0, 3.0]
    rows = [f"{name};0,{time};1,{time}" for name in "AB" for time in (1, 2, 4)]
    assert read("\n".join(["signal;t;value", *rows, ""])).column("t").tolist() == [0.1, 0.2, 0.4]


@pytest.mark.parametrize(
    ("text", "options"),
    [
        ("t,name,value\n0,a,1\n1,b,2\n2,a,3\n", {}),
        ("t,who,x\n0,a,1\n1,a,2\n0,b,3\n1,b,4\n", {}),
        ("t,name,value\n0,a,1\n1,a,2\n0,b,3\n1,b,4\n", {"trajectory": "name"}),
        ("t,name,value\n0,a,1\n1,a,2\n0,b,3\n1,b,4\n", {"states": ("value",)}),
        ("t,name,value\n0,a,1\n1,a,2\n\n0,b,3\n1,b,4\n", {}),
        ("t,name,value,trajectory\n0,a,1,1\n1,b,2,1\n0,a,3,2\n1,b,4,2\n", {}),
    ],
)
def test_a_table_that_can_be_read_as_it_stands_is(read, text, options):
    table = read(text, **options)
    assert "long table" not in table.read_as
    assert "b" not in table.names


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("name,t,value\nA,0,1\nA,1,2\nB,0,3\nB,1,4\nA,1.0,5\n", "'A' has two values at the t 1.0 (line 3 and line 6)"),
        ("name,t,value\nA,0,1\nA,,2\nB,0,3\nB,1,4\n", "column 't' of a.csv is empty in line 3"),
        ("name,t,value\nA,0,1\nA,1,2\nt,0,3\nt,1,4\n", "both called 't'"),
    ],
)
def test_a_long_table_that_cannot_be_read_is_refused(read, text, words):
    with pytest.raises(DataError) as raised:
        read(text)
    assert words in str(raised.value)


YEARS = "name,code,1990,1991,1992,1993,1994\n"


def test_a_table_with_years_as_columns_is_turned(read):
    table = read(YEARS + "hare,H,30,47,70,77,36\nlynx,L,4,6.1,,35,59\n")
    assert table.names == ("time", "hare", "lynx")
    assert str(table.columns.tolist()) == (
        "[[1990.0, 1991.0, 1992.0, 1993.0, 1994.0], [30.0, 47.0, 70.0, 77.0, 36.0], [4.0, 6.1, nan, 35.0, 59.0]]"
    )
    assert "a column for each row of a table with times as columns: hare, lynx" in table.read_as
    assert table.left_out == ("left out: code",)


def test_dates_as_columns_and_those_of_frames_are_times(read):
    header = "site,1/22/20,1/23/20,1/24/20,1/25/20,1/26/20\n"
    table = read(header + "A,0,1,3,7,15\nB,5,5,6,6,7\n")
    assert (table.names, table.units) == (("time", "A", "B"), ("d", "", ""))
    assert table.columns[:2].tolist() == [[0, 1, 2, 3, 4], [0, 1, 3, 7, 15]]
    frame = polars.DataFrame({"site": ["A", "B"], **{f"2020-01-2{day}": [day, 2 * day] for day in range(2, 8)}})
    assert table_of(frame, DataConfig()).column("B").tolist() == [4, 6, 8, 10, 12, 14]


def test_trajectories_of_a_turned_table_are_those_that_an_option_names(read):
    text = YEARS + "hare,A,1,2,3,4,5\nlynx,A,6,7,8,9,10\nhare,B,2,3,4,5,6\nlynx,B,7,8,9,10,11\n"
    table = read(text, trajectory="code")
    assert (table.names, table.labels) == (("time", "code", "hare", "lynx"), {"code": ("A", "B")})
    assert table.column("hare").tolist() == [1, 2, 3, 4, 5, 2, 3, 4, 5, 6]
    assert read(text).names == ("time", "hare A", "lynx A", "hare B", "lynx B")
    with pytest.raises(DataError, match=r"a\.csv has times as columns, and two rows called 'hare A'; give each row"):
        read(YEARS + "hare,A,1,2,3,4,5\nhare,A,6,7,8,9,10\n")


@pytest.mark.parametrize(
    "text",
    [
        "t,1,2,3,4,5\n0,1,2,3,4,5\n1,2,3,4,5,6\n",
        "date,1,2,3,4,5\n2020-01-01,1,2,3,4,5\n2020-01-02,2,3,4,5,6\n",
        "who,t,1,2,3,4,5\na,0,1,2,3,4,5\na,1,2,3,4,5,6\n",
        "who,5,4,3,2,1\na,0,1,2,3,4\nb,1,2,3,4,5\n",
        "who,1,2,3,4\na,1,2,3,4\nb,2,3,4,5\n",
    ],
)
def test_columns_that_are_called_by_numbers_stay_columns(text, read):
    table = read(text)
    assert [name for name in table.names if name.isdecimal()] == [
        name for name in text.partition("\n")[0].split(",") if name.isdecimal()
    ]


MONTHS = "Jan,Feb,Mar,Apr,May,Jun,Jul,Aug,Sep,Oct,Nov,Dec"


def test_a_table_with_a_column_for_each_month_has_a_row_for_each(read):
    first, second = (",".join(str(base + month) for month in range(12)) for base in (1, 13))
    table = read(f"Year,{MONTHS},J-D\n2001,,{first[2:]},6.5\n2002,{second[:-6]},,,\n")
    assert (table.names, table.units) == (("time", "value"), ("year", ""))
    assert table.left_out == ("left out: J-D",), "the mean of a year is no state of its months"
    assert table.column("value").tolist() == [float(value) for value in range(2, 23)]
    assert np.allclose(np.diff(table.column("time")), 1.0 / 12.0)
    assert table.column("time")[0] == pytest.approx(2001.0 + 1.0 / 12.0)


@pytest.mark.parametrize(
    ("text", "unit", "times"),
    [
        ("year,quarter,x\n2020,3,1\n2020,4,2\n2021,1,3\n", "year", [2020.5, 2020.75, 2021.0]),
        ("Year,Quarter,x\n2020,Q3,1\n2020,Q4,2\n2021,Q1,3\n", "year", [2020.5, 2020.75, 2021.0]),
        ("when,x\n2020Q3,1\n2020-Q4,2\nQ1 2021,3\n", "year", [2020.5, 2020.75, 2021.0]),
        ("x,year,month\n1,2020,11\n2,2020,12\n3,2021,1\n", "year", [2020 + 10 / 12, 2020 + 11 / 12, 2021.0]),
        ("x,year,month\n1,2020,Nov\n2,2020,December\n3,2021,jan\n", "year", [2020 + 10 / 12, 2020 + 11 / 12, 2021.0]),
        ("year,month,day,x\n2020,2,28,1\n2020,2,29,2\n2020,3,1,3\n", "d", [0, 1, 2]),
        ("year,month,day,hour,x\n2020,2,28,22,1\n2020,2,28,23,2\n2020,2,29,0,3\n", "h", [0, 1, 2]),
        ("year,doy,x\n2019,365,1\n2020,1,2\n2020,2,3\n", "d", [0, 1, 2]),
    ],
)
def test_times_that_several_columns_tell_are_one(text, unit, times, read):
    table = read(text)
    assert (set(table.names), table.units[table.names.index("time")]) == ({"time", "x"}, unit)
    assert np.allclose(table.column("time"), times)
    assert "time from" in table.read_as


def test_parts_of_a_time_that_have_another_part_stay_columns(read):
    text = "year,month,x\n2020,11,1\n2020,12,2\n2021,1,3\n"
    assert read(text, inputs=("month",)).names == ("year", "month", "x")
    assert read(text, target="x").names == ("year", "month", "x")
    assert read(text, time="year").names == ("year", "x")
    assert read("t,year,month\n0,2020,11\n1,2020,12\n").names == ("t", "year", "month")
    assert read("year,month,x\n2020,11,1\n2020,13,2\n").names == ("year", "month", "x")


def test_a_part_of_the_time_that_cannot_be_read_is_no_state(read):
    """With whole minutes alone the times would repeat, and the seconds would be sought an equation for."""
    rows = "".join(f"2020,1,1,0,{n},{12.5 + n},{n}\n" for n in range(6))
    table = read("year,month,day,hour,minute,second,x\n" + rows)
    assert "time" not in table.names
    table = read("year,month,hour,x\n" + "".join(f"2020,1,{n},{n}\n" for n in range(6)))
    assert "time" not in table.names
