"""Tables are made of what Python users hold; what does not fit is refused in a sentence."""

from pathlib import Path

import numpy as np
import polars
import pytest

from atoll.api.tables import numbers_of, table_of
from atoll_core.config import DataConfig
from atoll_core.errors import DataError

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
        ([1.0, "2.0", "n/a"], "holds 'n/a' in row 3"),
        (np.array([1j, 2.0]), "complex"),
        (["a", "b"], "all columns hold text"),
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


def test_dates_beside_a_time_are_refused() -> None:
    with pytest.raises(DataError, match="'day' holds dates or times beside the time 't'"):
        table_of({"t": [0.0, 1.0, 2.0], "day": DAYS}, DataConfig())


def test_an_index_of_a_pandas_frame_is_a_column_where_it_says_something() -> None:
    pandas = pytest.importorskip("pandas")
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


def test_coordinates_of_an_xarray_data_set_are_columns() -> None:
    xarray = pytest.importorskip("xarray")
    lines = xarray.Dataset({"x": ("t", [1.0, 2.0])}, coords={"t": [0.0, 0.5]})
    assert table_of(lines, DataConfig()).names == ("t", "x")


def test_files_are_read_as_the_command_line_reads_them(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("t,x\n0,1\n1,2\n")
    assert table_of(tmp_path / "a.csv", DataConfig()).files == ("a.csv",)


@pytest.mark.parametrize("data", [3, [], [{"x": [1.0]}, {"y": [1.0]}], {"x": []}, {"x": [1.0], "y": [1.0, 2.0]}])
def test_what_does_not_fit_is_refused(data: object) -> None:
    with pytest.raises(DataError):
        table_of(data, DataConfig())


BELOW = np.array([True, False, False])
"""The mask of the first entry, below which stands what is no measurement."""


@pytest.mark.parametrize("kind", ["f8", "f4", "i4", "bool"])
def test_what_is_masked_is_missing(kind: str) -> None:
    values = np.ma.array([-9999, 0, 1], mask=BELOW).astype(kind)
    (found,) = table_of({"x": values}, DataConfig()).columns
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


def test_masked_arrays_of_a_discoverer_keep_their_masks() -> None:
    values = numbers_of(np.ma.array([[1, -9999], [2, 3]], mask=[[False, True], [False, False]]), "an array")
    assert values is not None
    assert str(values.tolist()) == "[[1.0, nan], [2.0, 3.0]]"


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


def test_names_of_trajectories_are_kept() -> None:
    parts = [{"t": [0, 1], "x": [1, 2], "run": ["b", "a"]}, {"t": [0, 1], "x": [1, 2], "run": ["a", "c"]}]
    table = table_of(parts, DataConfig(trajectory="run"))
    assert table.column("run").tolist() == [1.0, 2.0, 2.0, 3.0]
    assert table.labels == {"run": ("b", "a", "c")}


def test_columns_without_a_value_are_left_out() -> None:
    table = table_of({"t": [0, 1], "x": [1, 2], "y": [np.nan, np.nan]}, DataConfig())
    assert (table.names, table.read_as) == (("t", "x"), "empty columns left out: y")


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
