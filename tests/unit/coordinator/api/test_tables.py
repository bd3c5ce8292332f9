"""Tables are made of what Python users hold; what does not fit is refused in a sentence."""

from pathlib import Path

import numpy as np
import polars
import pytest

from atoll.config import DataConfig
from atoll.errors import DataError
from atoll_coordinator.api.tables import table_of

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
        (np.array(["2020-01-01", "2020-01-02"], dtype="M8[s]"), "dates"),
        (["a", "b"], "all columns hold text"),
    ],
)
def test_what_is_no_number_is_named(values: object, sentence: str) -> None:
    with pytest.raises(DataError, match=sentence):
        table_of({"x": values}, DataConfig())


def test_files_are_read_as_the_command_line_reads_them(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("t,x\n0,1\n1,2\n")
    assert table_of(tmp_path / "a.csv", DataConfig()).files == ("a.csv",)


@pytest.mark.parametrize("data", [3, [], [{"x": [1.0]}, {"y": [1.0]}], {"x": []}, {"x": [1.0], "y": [1.0, 2.0]}])
def test_what_does_not_fit_is_refused(data: object) -> None:
    with pytest.raises(DataError):
        table_of(data, DataConfig())
