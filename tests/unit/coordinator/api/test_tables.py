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


def test_text_is_numbered_by_first_appearance() -> None:
    assert table_of({"run": ["b", "a", "b"]}, DataConfig()).column("run").tolist() == [1.0, 2.0, 1.0]


def test_files_are_read_as_the_command_line_reads_them(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("t,x\n0,1\n1,2\n")
    assert table_of(tmp_path / "a.csv", DataConfig()).files == ("a.csv",)


@pytest.mark.parametrize("data", [3, [], [{"x": [1.0]}, {"y": [1.0]}], {"x": []}, {"x": [1.0], "y": [1.0, 2.0]}])
def test_what_does_not_fit_is_refused(data: object) -> None:
    with pytest.raises(DataError):
        table_of(data, DataConfig())
