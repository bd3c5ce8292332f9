"""Tables are made of what Python users hold; what does not fit is refused in a sentence."""

import io
import pickle
from pathlib import Path

import numpy as np
import polars
import pytest

from atoll.api.discover import submit
from atoll.api.tables import in_python, numbers_of, python_words, table_of
from atoll_coordinator.data.columns.examination import examine
from atoll_core.config import DataConfig, JobConfig
from atoll_core.data.table import Table
from atoll_core.errors import DataError, Field, UsageError

COLUMNS = {"t [s]": [0.0, 1.0, 2.0], "x": np.array([1, 2, 3])}


@pytest.mark.parametrize("data", [COLUMNS, polars.DataFrame(COLUMNS)])
def test_columns_by_name_and_frames_are_tables(data: object) -> None:
    table = table_of(data, DataConfig())
    assert (table.names, table.units, table.starts) == (("t", "x"), ("s", ""), (0,))
    assert table.columns.tolist() == [[0.0, 1.0, 2.0], [1.0, 2.0, 3.0]]


def test_a_list_has_a_trajectory_in_each_entry() -> None:
    other = {"x": [9.0], "t [s]": [0.0]}
    table = table_of([COLUMNS, other], DataConfig())
    assert table.starts == (0, 3)
    assert table.column("x").tolist() == [1.0, 2.0, 3.0, 9.0]


def test_text_is_numbered_in_the_trajectory_column_alone() -> None:
    table = table_of({"run": ["b", "a", "b"], "remark": ["", "bad", "x"], "x": [1, 2, 3]}, DataConfig(trajectory="run"))
    assert table.names == ("run", "x")
    assert table.column("run").tolist() == [1.0, 2.0, 1.0]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ([1.0, "2.0", "two"], "column 'x' of data holds 'two' in row 3 where a number is expected"),
        (np.array([1j, 2.0]), "complex"),
        (np.array([1j, None]), "complex"),
        (["a", "b"], "no column of numbers is left in data: 'x' holds 'a' in row 1"),
        ([[1.0], [1.0, 2.0]], "column 'x' holds rows of different lengths"),
    ],
)
def test_what_is_no_number_is_named(values: object, sentence: str) -> None:
    with pytest.raises(DataError, match=sentence):
        table_of({"x": values}, DataConfig())


DAYS = np.array(["2020-01-01", "2020-01-02", "2020-01-04"], dtype="M8[s]")


@pytest.mark.parametrize("name", ["t", "time", "day"])
def test_dates_are_the_time(name: str) -> None:
    table = table_of([{name: DAYS, "x": [1.0, 2.0, 3.0]}, {name: DAYS + 1, "x": [1.0, 2.0, 3.0]}], DataConfig())
    assert (table.names[0], table.units[0]) == ("t" if name == "t" else "time", "d")
    assert table.columns[0][:3].tolist() == [0.0, 1.0, 3.0]
    assert table.columns[0][3] == pytest.approx(1.0 / 86400.0)
    assert "since 2020-01-01" in table.read_as
    assert table_of({"t": DAYS.astype(object), "x": [1.0, 2.0, 3.0]}, DataConfig()).columns[0].tolist() == [0, 1, 3]
    durations = table_of({"t": DAYS - DAYS[0], "x": [1.0, 2.0, 3.0]}, DataConfig())
    assert (durations.names, durations.units, durations.columns[0][1]) == (("t", "x"), ("s", ""), 86400.0)


def test_an_index_of_a_pandas_frame_is_a_column_where_it_says_something() -> None:
    import pandas

    frame = pandas.DataFrame({"x": [1.0, 2.0, 3.0]}, index=pandas.DatetimeIndex(DAYS))
    assert table_of(frame, DataConfig()).columns.tolist() == [[0.0, 1.0, 3.0], [1.0, 2.0, 3.0]]
    assert table_of(frame.tz_localize("Europe/Berlin"), DataConfig()).names == ("time", "x")
    assert table_of(frame.reset_index(drop=True), DataConfig()).names == ("x",)
    frame.index = pandas.to_timedelta([0.0, 1.0, 3.0], unit="min")
    durations = table_of(frame, DataConfig())
    assert (durations.names, durations.column("time").tolist()) == (("time", "x"), [0.0, 60.0, 180.0])
    frame.index = pandas.Index([0.5, 1.0, 2.0], name="t")
    assert table_of(frame, DataConfig()).column("t").tolist() == [0.5, 1.0, 2.0]
    assert table_of({"x": frame["x"], "t": frame.index}, DataConfig()).names == ("x", "t")


@pytest.mark.parametrize(
    "data", [3, [], [{"x": [1.0]}, {"y": [1.0]}], {"x": []}, {"x": [1.0], "y": [1.0, 2.0]}, {"t": [0, 1], "x": [1]}]
)
def test_what_does_not_fit_is_refused(data: object) -> None:
    with pytest.raises(DataError):
        table_of(data, DataConfig())


BELOW = np.array([True, False, False])
"""The mask of the first entry, below which stands what is no measurement."""


@pytest.mark.parametrize("kind", ["f8", "f4", "i4", "bool"])
def test_what_is_masked_is_missing(kind: str) -> None:
    values = np.ma.array([-9999, 0, 1], mask=BELOW).astype(kind)
    _, found = table_of({"t": [0, 1, 2], "x": values}, DataConfig()).columns
    assert np.isnan(found).tolist() == BELOW.tolist()
    assert found[1:].tolist() == [0.0, 1.0]
    assert table_of({"x": np.ma.array([5, 6, 7])}, DataConfig()).columns.tolist() == [[5.0, 6.0, 7.0]]


def test_masked_dates_and_structured_arrays_keep_their_masks() -> None:
    days = np.ma.array(DAYS, mask=[False, True, False])
    assert str(table_of({"t": days, "x": [1.0, 2.0, 3.0]}, DataConfig()).columns[0].tolist()) == "[0.0, nan, 3.0]"
    table = np.ma.array([(0.0, 1), (1.0, -9999), (2.0, 3)], dtype=[("t", "f8"), ("x", "i8")])
    table["x"][1] = np.ma.masked
    found = table_of(table, DataConfig())
    assert found.names == ("t", "x")
    assert str(found.columns.tolist()) == "[[0.0, 1.0, 2.0], [1.0, nan, 3.0]]"


def test_missing_values_of_frames_are_missing() -> None:
    frame = polars.DataFrame({"t": [0, 1, 2], "x": [1, None, 3], "remark": ["good", None, "bad"]})
    table = table_of(frame, DataConfig())
    assert table.names == ("t", "x")
    assert str(table.column("x").tolist()) == "[1.0, nan, 3.0]"
    named = table_of({"t": [0, 1, 2], "x": np.array([1, NAType(), 3], dtype=object)}, DataConfig())
    assert str(named.column("x").tolist()) == "[1.0, nan, 3.0]"


class NAType:
    """What stands for a missing value in pandas: it is neither true nor false, and no number."""

    def __bool__(self) -> bool:
        raise TypeError("boolean value of NA is ambiguous")


def test_a_long_frame_is_read_as_a_long_file_is(tmp_path: Path) -> None:
    rows = [
        (name, run, time, 10.0 * time + len(run)) for name in ("A", "B") for run in ("a", "bc") for time in range(3)
    ]
    frame = polars.DataFrame(rows, schema=["species", "run", "t [h]", "value"], orient="row")
    frame.write_csv(tmp_path / "a.csv")
    table, of_file = table_of(frame, DataConfig()), table_of(tmp_path / "a.csv", DataConfig())
    assert (table.names, table.units) == (("t", "trajectory", "A", "B"), ("h", "", "", ""))
    assert (table.names, table.units, table.labels) == (of_file.names, of_file.units, of_file.labels)
    assert table.columns.tolist() == of_file.columns.tolist()
    both = table_of([frame, frame.filter(polars.col("run") == "bc")], DataConfig())
    assert both.column("trajectory").tolist() == [1, 1, 1, 2, 2, 2, 2, 2, 2]
    plain = table_of({"species": ["A", "B"], "t": [0, 1], "value": [1, 2]}, DataConfig())
    assert plain.names == ("t", "value")


def test_what_was_left_out_is_a_warning_of_the_result() -> None:
    rows = np.arange(12.0)
    data = {"t": rows, "x": rows**2, "remark": ["a"] * 12, "empty": [None] * 12, "k": [1, 2]}
    table = table_of(data, DataConfig())
    assert table.left_out == ("left out: k", "empty columns left out: empty")
    warnings = examine(table, JobConfig()).measurements.warnings
    assert "Columns of text or without a name are not used: remark." in warnings
    assert "Parts of the data were not read: left out: k; empty columns left out: empty." in warnings
    assert Table.from_bytes(table.to_bytes()).left_out == table.left_out


def test_levels_of_an_index_with_a_name_are_columns() -> None:
    import pandas

    index = pandas.MultiIndex.from_product([["hill", "lake"], [2001, 2002, 2003]], names=["site", "year"])
    frame = pandas.DataFrame({"x": [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]}, index=index)
    table = table_of(frame, DataConfig(time="year", trajectory="site"))
    assert table.names == ("site", "year", "x")
    assert (table.labels["site"], table.column("year").tolist()) == (("hill", "lake"), [2001, 2002, 2003] * 2)
    frame.index = frame.index.set_names([None, "year"])
    assert table_of(frame, DataConfig(time="year")).skipped == ("column 1",)


def test_levels_of_columns_name_columns_where_one_does_not() -> None:
    import pandas

    columns = pandas.MultiIndex.from_tuples([("", "t"), ("ball 1", "x"), ("ball 2", "x"), ("ball 2", "y")])
    frame = pandas.DataFrame([[0, 1, 2, 3], [1, 2, 3, 5]], columns=columns)
    assert table_of(frame, DataConfig()).names == ("t", "ball 1 x", "ball 2 x", "y")
    frame.columns = ["t", "x", "x", "y"]
    with pytest.raises(DataError, match="data has 2 columns named 'x'; give each column its own name"):
        table_of(frame, DataConfig())


def test_matrices_by_name_are_the_columns_that_a_file_of_arrays_has(tmp_path: Path) -> None:
    arrays = {"t": np.arange(4.0), "x": np.arange(8.0).reshape(4, 2)}
    np.savez(tmp_path / "a.npz", **arrays)
    table, of_file = table_of(arrays, DataConfig()), table_of(tmp_path / "a.npz", DataConfig())
    assert table.names == of_file.names == ("t", "x0", "x1")
    assert table.columns.tolist() == of_file.columns.tolist()


def test_texts_of_an_array_are_numbers_as_in_files() -> None:
    assert numbers_of([["0,5", "1.234,5"], ["1,5", "2"]], "x").tolist() == [[0.5, 1234.5], [1.5, 2.0]]
    with pytest.raises(DataError, match="column '2' of x holds 'two' in row 2 where a number is expected"):
        numbers_of([["0,5", "1"], ["1,5", "two"]], "x")


def test_numbers_that_are_no_text_do_not_tell_how_texts_are_written() -> None:
    """Points of numbers in other columns made 6,773 a number of thousands."""
    rows = {"t": [0.5, 1.5, 2.5], "x": ["6,773", "0,6", "7,25"]}
    for data in (
        rows,
        polars.DataFrame(rows),
        [dict(zip(rows, row, strict=True)) for row in zip(*rows.values(), strict=True)],
    ):
        assert table_of(data, DataConfig()).column("x").tolist() == [6.773, 0.6, 7.25]
    with pytest.raises(DataError, match=r"holds '6,773', which may be 6773 or 6\.773"):
        table_of({"t": [0.5, 1.5], "x": ["6,773", "7,125"]}, DataConfig())
    quarters = {"year": [2020, 2020], "quarter": [1, 2], "x": ["6,773", "0,6"]}
    assert table_of(quarters, DataConfig()).column("x").tolist() == [6.773, 0.6]


def test_a_column_of_text_is_none_of_numbers_that_has_nearly_its_name() -> None:
    """A matrix v has the columns v0, v1, …; v1 beside a vector v is another column, and its commas are seen."""
    columns = {"t": np.arange(5.0), "v": np.arange(5.0), "v1": [f"{n},600" for n in range(1, 6)]}
    with pytest.raises(DataError, match=r"may be 1600 or 1\.6"):
        table_of(columns, DataConfig())


def test_a_header_that_pandas_has_taken_for_a_row_is_found() -> None:
    """`read_csv` and `read_excel` take the first line for the header: names of groups, a title, an empty row."""
    import pandas

    text = ",mass A,,,\nt,frame,x,y,\n0.0,0,3.9,-3.1,\n0.1,1,3.8,-3.2,\n0.2,2,3.7,-3.4,\n"
    table = table_of(pandas.read_csv(io.StringIO(text)), DataConfig())
    assert (table.names, table.rows) == (("t", "frame", "x", "y"), 3)
    assert "header in line 2 below names of groups: mass A" in table.read_as
    titled = pandas.DataFrame(
        {"Unnamed: 0": [None, "t", 0, 0.5, 1.0], "Unnamed: 1": [None, "x", 1.25, 2.5, 5]}, dtype=object
    )
    assert table_of(titled, DataConfig()).columns.tolist() == [[0.0, 0.5, 1.0], [1.25, 2.5, 5.0]]
    remarks = pandas.DataFrame({"t": [0, 1, 2], "x": [1.5, 2.5, 4.5], "Unnamed: 2": ["ok", "bad", "ok"]})
    table = table_of(remarks, DataConfig())
    assert (table.names, table.skipped) == (("t", "x"), ("column 3",))


def test_the_mark_of_a_comment_before_the_time_is_no_part_of_its_name() -> None:
    """`read_csv` keeps ``%time`` of ``rostopic echo -p``, so that a frame had no time where the file has one."""
    stamps = [1609060363469364484 + 20_000_000 * row for row in range(6)]
    table = table_of({"%time": stamps, "x": np.arange(6.0)}, DataConfig())
    assert (table.names, table.units) == (("time", "x"), ("s", ""))
    assert table.column("time").tolist() == pytest.approx([0.02 * row for row in range(6)])
    assert table_of({"t": np.arange(6.0), "% CO2": np.arange(6.0)}, DataConfig()).names == ("t", "% CO2")


@pytest.mark.parametrize(
    ("sentence", "expected"),
    [
        ("--max-size must be above 0", "max_size must be above 0"),
        ("leave --order 2 out", "leave order=2 out"),
        ("make it an input with --inputs u", "make it an input with inputs='u'"),
        ("name it with --time, or use --target COLUMN", "name it with time, or use target='COLUMN'"),
        (
            "or mark trajectories (--trajectory COLUMN or blank rows)",
            "or mark trajectories (trajectory='COLUMN' or blank rows)",
        ),
        ("if so, add --hold u, since", "if so, add hold='u', since"),
        ("(--states x,y,n keeps it)", "(states='x,y,n' keeps it)"),
        ("(--states 'x,packet no.' keeps it)", "(states='x,packet no.' keeps it)"),
        ("--inputs if only other states have noise", "inputs if only other states have noise"),
        ("check --tls-ca", "check tls['ca']"),
        ("a - b -- c", "a - b -- c"),
    ],
)
def test_options_become_arguments(sentence: str, expected: str) -> None:
    assert in_python(sentence) == expected


def test_an_error_has_words_for_python_and_for_the_command_line() -> None:
    error = pickle.loads(pickle.dumps(UsageError("there is no time", python="give t", command="give --until")))
    assert (str(error), error.on_command_line) == ("there is no time; give t", "there is no time; give --until")
    error = pickle.loads(pickle.dumps(UsageError("%s must be 5 %% of %s", Field("max_time"), Field("order", 2))))
    assert (str(error), error.on_command_line) == (
        "max_time must be 5 % of order=2",
        "--max-time must be 5 % of --order 2",
    )
    assert error.fields == ("max_time", "order")
    with pytest.raises(DataError, match=r"^name it with time$") as raised, python_words():
        raise DataError("name it with --time")
    assert raised.value.on_command_line == "name it with --time"


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"connect": 3}, "connect must be an address such as 'tcp/HOST:7447', but 3"),
        ({"connect": "tls/h:1", "tls": "x"}, "tls must have the files ca, cert, key"),
        ({"connect": "tls/h:1", "tls": {"key": 1, "foo": 2}}, "tls must have the files ca, cert, key"),
        ({"connect": "tls/h:1"}, "needs certificates; give tls..ca.., tls..cert.., tls..key.."),
    ],
)
def test_addresses_and_files_that_are_none_are_refused(options: dict, sentence: str) -> None:
    with pytest.raises(UsageError, match=sentence):
        submit({"t": [0.0, 1.0], "x": [1.0, 2.0]}, **options)
