"""Reading files: dialects, units, breaks between trajectories, and one sentence for whatever cannot be read."""

import numpy as np
import polars
import pytest

from atoll_coordinator.data.reading.files import read_table
from atoll_core.config import DataConfig
from atoll_core.errors import DataError

ANYTHING = DataConfig()


@pytest.fixture
def read(tmp_path):
    def write_and_read(*texts, config=ANYTHING, suffix=".csv"):
        paths = []
        for name, text in zip("abc", texts, strict=False):
            paths.append(tmp_path / f"{name}{suffix}")
            paths[-1].write_bytes(text if isinstance(text, bytes) else text.encode())
        return read_table(paths, config)

    return write_and_read


@pytest.mark.parametrize(
    "text",
    [
        "t;x\n0;1\n1;2\n",
        "t\tx\n0\t1\n1\t2\n",
        "t,x\r\n0,1\r\n1,2\r\n",
        "\ufefft,x\n0,1\n1,2",
        '"t","x"\n"0","1"\n1,2\n',
        "t , x\n 0, 1\n1 ,2 \n",
        "\n\nt,x\n0,1\n1,2\n",
        "t;x\n0,0;1,0\n1;2\n",
    ],
)
def test_dialects_read_the_same(read, text):
    table = read(text)
    assert table.names == ("t", "x")
    assert table.columns.tolist() == [[0.0, 1.0], [1.0, 2.0]]


def test_units_are_split_from_names(read):
    table = read('t [s],"v [m/s]",angle[deg],[x]\n0,1,2,3\n')
    assert table.names == ("t", "v", "angle", "[x]")
    assert table.units == ("s", "m/s", "deg", "")


def test_known_units_may_stand_in_parentheses(read):
    table = read("Time (s),x (mol/L),rate (of x),N(t),f (1)\n0,1,2,3,4\n")
    assert table.names == ("Time", "x", "rate (of x)", "N(t)", "f (1)")
    assert table.units == ("s", "mol/L", "", "", "")


def test_all_digits_survive(read):
    values = [0.1 + 0.2, 1e-300, -1.7976931348623157e308, 5e-324]
    assert read("x\n" + "\n".join(f"{value:.17g}" for value in values)).column("x").tolist() == values


def test_blank_rows_separate_trajectories(read):
    table = read("\nt,x\n0,1\n1,2\n\n\n,\n0,3\n1,4\n\n")
    assert table.starts == (0, 2)
    assert table.column("x").tolist() == [1, 2, 3, 4]
    assert table.line_of_row.tolist() == [3, 4, 8, 9]


def test_each_file_is_a_trajectory_of_its_own(read):
    table = read("t,x\n0,1\n1,2\n", "x,t\n3,0\n\n4,0\n")
    assert table.column("x").tolist() == [1, 2, 3, 4]
    assert table.starts == (0, 2, 3)
    assert table.files == ("a.csv", "b.csv")
    assert table.places([2]) == "row 3 (line 2 of b.csv)"


def test_missing_cells_are_nan_and_infinity_is_kept(read):
    table = read("t,x,y\n0,,NaN\n1,inf,N/A\n2,-inf,null\n3,0,1\n")
    assert np.isnan(table.column("y")[:3]).all()
    assert np.isnan(table.column("x")[0])
    assert table.column("x")[1:].tolist() == [np.inf, -np.inf, 0.0]


@pytest.mark.parametrize(
    "row", ["-,-", "YYYY-MM-DD,–", "yyyy-mm-dd,m", "hh:mm:ss,-", ",-", "[dd.mm.yyyy HH:MM:SS],", "[-],[-]"]
)
def test_a_row_of_units_may_say_that_there_are_none_and_how_dates_are_written(read, row):
    table = read(f"time,x\n{row}\n2020-01-01,1\n2020-01-02,2\n")
    assert table.column("x").tolist() == [1.0, 2.0]
    assert table.units == ("d", "m" if "m" in row.partition(",")[2] else "")


def test_a_first_row_with_a_number_holds_no_units(read):
    with pytest.raises(DataError, match=r"column 't' of a\.csv holds '-' in line 2"):
        read("t,x\n-,1\n0,2\n1,3\n")


@pytest.mark.parametrize("config", [DataConfig(), DataConfig(trajectory="trajectory")])
def test_the_trajectory_column_may_hold_names(read, config):
    table = read("trajectory,t,x\nred,0,1\nred,1,2\nblue,0,3\n", config=config)
    assert table.column("trajectory").tolist() == [1, 1, 2]


def test_parquet_is_read_like_text(tmp_path):
    frame = polars.DataFrame({"t": [0, 1, None, 0], "v [m/s]": [1.5, None, None, 2.5], "who": ["a", "b", None, "c"]})
    frame.write_parquet(tmp_path / "a.parquet")
    table = read_table([tmp_path / "a.parquet"], DataConfig())
    assert table.names == ("t", "v")
    assert table.units == ("", "m/s")
    assert table.starts == (0, 2)
    assert table.column("v")[[0, 2]].tolist() == [1.5, 2.5]
    assert table.places([1]) == "row 2"


def test_what_is_no_file_is_refused(tmp_path):
    for paths, words in (([], "no data file"), ([tmp_path], "is a folder"), ([tmp_path / "a"], "there is no file")):
        with pytest.raises(DataError, match=words):
            read_table(paths, DataConfig())


def test_files_with_different_columns_are_refused(read):
    with pytest.raises(DataError, match=r"a.csv and b.csv differ in the columns x, y; files read together"):
        read("t,x\n0,1\n", "t,y\n0,1\n")


def test_lists_in_parquet_are_refused(tmp_path):
    polars.DataFrame({"t": [0.0], "x": [[1.0, 2.0]]}).write_parquet(tmp_path / "a.parquet")
    with pytest.raises(DataError, match=r"column 'x' of a\.parquet holds lists"):
        read_table([tmp_path / "a.parquet"], DataConfig())


@pytest.mark.parametrize("content", [b"", b"hello", b"PK\x03\x04 and no more"])
def test_an_npz_that_is_none_is_refused_without_advice_to_trust_it(tmp_path, content):
    (tmp_path / "a.npz").write_bytes(content)
    with pytest.raises(DataError, match=r"a\.npz is not an NPZ file of plain arrays") as caught:
        read_table([tmp_path / "a.npz"], DataConfig())
    assert "pickle" not in str(caught.value)


def test_characters_that_a_terminal_obeys_are_escaped(read):
    table = read("t,x\x1b[31m,trajectory\n0,1,a\x1b\n1,2,a\x1b\n", config=DataConfig(group="trajectory"))
    assert table.names == ("t", r"x\x1b[31m", "trajectory")
    assert table.labels == {"trajectory": (r"a\x1b",)}


def test_units_with_an_origin_are_units(read):
    table = read("t [hours since 2020-01-01 00:00],x [fish since]\n0,1\n")
    assert (table.units, table.read_as) == (("h", "fish since"), "text with commas; t: in h since 2020-01-01 00:00")


def test_columns_without_a_value_are_left_out(read):
    table = read("t,a,x,b\n0,,1,NA\n1,,2,nan\n")
    assert table.names == ("t", "x")
    assert table.columns.tolist() == [[0.0, 1.0], [1.0, 2.0]]
    assert table.read_as == "text with commas; empty columns left out: a, b"


def test_a_column_without_a_value_is_kept_where_it_is_wanted(read):
    assert read("t,a,x\n0,,1\n1,,2\n", config=DataConfig(states=("a", "x"))).names == ("t", "a", "x")
    assert read("t,a\n0,\n1,\n").names == ("t", "a")
    assert read("time,x,y\n,1,2\n,2,3\n").names == ("time", "x", "y")
    assert read("t,a,x\n0,,1\n1,,2\n", "t,a,x\n0,5,1\n1,6,2\n").names == ("t", "a", "x")


def test_names_of_trajectories_are_the_same_in_all_files(read):
    table = read("t,x,run\n0,1,a\n1,2,b\n", "t,x,run\n0,1,b\n1,2,c\n", config=DataConfig(trajectory="run"))
    assert table.column("run").tolist() == [1.0, 2.0, 2.0, 3.0]
    assert table.labels == {"run": ("a", "b", "c")}
    mixed = read("t,x,run\n0,1,a\n1,2,b\n", "t,x,run\n0,1,7\n1,2,7\n", config=DataConfig(trajectory="run"))
    assert mixed.column("run").tolist() == [1.0, 2.0, 7.0, 7.0]
    assert mixed.labels == {}
