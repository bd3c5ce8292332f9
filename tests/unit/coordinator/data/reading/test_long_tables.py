"""Long tables, with one value in each row, become wide ones; what cannot is refused in a sentence."""

import pytest

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
    with pytest.raises(DataError, match=r"column 'T' of a\.csv, a long table, differs between observables of one time"):
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
    ("text", "sentence"),
    [
        (
            "name,t,value\nA,0,1\nA,1,2\nB,0,3\nB,1,4\nA,1.0,5\n",
            "a.csv is a long table in which 'A' has two values at the t 1.0 (line 3 and line 6); tell replicates apart "
            "by a column 'replicate', or keep one",
        ),
        (
            "name,t,value\nA,0,1\nA,,2\nB,0,3\nB,1,4\n",
            "column 't' of a.csv is empty in line 3; a value of a long table needs a time",
        ),
        (
            "name,t,value\nA,0,1\nA,1,2\nt,0,3\nt,1,4\n",
            "a.csv has an observable and a column that are both called 't'; rename one of them",
        ),
    ],
)
def test_what_cannot_be_read_is_one_sentence(read, text, sentence):
    with pytest.raises(DataError) as raised:
        read(text)
    assert str(raised.value) == sentence
