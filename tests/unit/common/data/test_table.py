"""Tables: their bytes, their digest, and how they say where a row stands."""

import copy
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from atoll_core.data.table import Table
from atoll_core.errors import DataError, RemoteProtocolError
from atoll_core.wire.codec import encode_arrays


def table_of(columns, starts=(0,), files=("a.csv",), file_of_row=None, line_of_row=None, **other):
    columns = np.asarray(columns, dtype=np.float64)
    count, rows = columns.shape
    return Table(
        names=tuple(f"c{index}" for index in range(count)),
        units=("",) * count,
        columns=columns,
        starts=starts,
        files=files,
        file_of_row=np.zeros(rows, dtype=np.int64) if file_of_row is None else np.asarray(file_of_row, dtype=np.int64),
        line_of_row=np.arange(2, rows + 2) if line_of_row is None else np.asarray(line_of_row, dtype=np.int64),
        **other,
    )


@pytest.mark.slow
@settings(max_examples=50, deadline=None)
@given(
    columns=arrays.arrays(np.float64, st.tuples(st.integers(1, 4), st.integers(1, 6))),
    unit=st.text(max_size=5),
    file=st.text(min_size=1, max_size=8),
)
def test_bytes_give_the_same_table_back(columns, unit, file):
    """NaN, infinity and signed zero included: compared by bits."""
    table = Table(
        tuple(f"θ{index}" for index in range(len(columns))),
        (unit,) * len(columns),
        columns,
        (0,),
        (file,),
        np.zeros(columns.shape[1], dtype=np.int64),
        np.arange(columns.shape[1], dtype=np.int64),
        ("label",),
    )
    again = Table.from_bytes(table.to_bytes())
    assert again.columns.tobytes() == table.columns.tobytes()
    assert (again.names, again.units, again.starts, again.files) == (
        table.names,
        table.units,
        table.starts,
        table.files,
    )
    assert again.skipped == ("label",)
    assert again.digest == table.digest


def test_the_digest_covers_values_and_breaks():
    table = table_of([[1.0, 2.0, 3.0]])
    assert table.digest == table_of([[1.0, 2.0, 3.0]]).digest
    assert table.digest != table_of([[1.0, 2.0, 4.0]]).digest
    assert table.digest != table_of([[1.0, 2.0, 3.0]], starts=(0, 1)).digest


@pytest.mark.parametrize(
    ("rows", "text"),
    [
        ([11], "row 12 (line 13 of a.csv)"),
        ([11, 39], "rows 12, 40 (lines 13, 41 of a.csv), 2 in all"),
        ([0, 1, 2, 3, 4, 5], "rows 1, 2, 3, 4, 5, … (lines 2, 3, 4, 5, 6 of a.csv), 6 in all"),
    ],
)
def test_rows_are_named_with_their_lines(rows, text):
    assert table_of(np.zeros((1, 50))).places(rows) == text


def test_rows_of_several_files_are_named_with_each_file():
    table = table_of(np.zeros((1, 4)), (0, 2), ("a.csv", "b.csv"), [0, 0, 1, 1], [2, 3, 2, 3])
    assert table.places([1, 3]) == "rows 2, 4 (line 3 of a.csv; line 3 of b.csv), 2 in all"


@pytest.mark.parametrize("starts", [(), (1,), (0, 0), (0, 2, 1), (0, 9)])
def test_starts_that_do_not_fit_are_refused(starts):
    with pytest.raises(DataError, match="trajectories that start at rows"):
        table_of(np.zeros((1, 4)), starts)


HOSTILE = (
    None, True, -1, 0.5, 1e300, math.inf, math.nan, 2**63, "", "x", "midnight", "9999-12-31", b"\xff", [], {}, [[]],
    {"x": 1}, {"x": ["a", 2]}, {"x": ["midnight", "nan"]}, {"x": ["0001-01-01", 1e300]}, [0, 2**62],
)  # fmt: skip


@pytest.mark.slow
@settings(max_examples=400, deadline=None)
@given(st.data())
def test_whatever_a_header_says_there_is_a_table_or_a_refusal(data):
    """A table that is taken says all it can be asked, too."""
    header = {
        "names": ["t", "x"], "units": ["", "m"], "starts": [0, 2], "files": ["a"], "skipped": [], "read_as": "",
        "labels": {"x": ["a", "b"]}, "origins": {"t": ["2024-01-01", 86400.0]},
    }  # fmt: skip
    parts = {
        "columns": np.array([[0.0, 1.0, math.nan], [1.0, 1e300, math.inf]]),
        "file_of_row": np.zeros(3, np.int64),
        "line_of_row": np.array([-5, 0, 2**62]),
    }
    for name in data.draw(st.lists(st.sampled_from(sorted(header)), max_size=2)):
        whole = header[name]
        holder = data.draw(
            st.sampled_from([value for value in (header, whole) if isinstance(value, dict | list) and value])
        )
        place = data.draw(st.sampled_from([*holder])) if isinstance(holder, dict) else 0
        holder[name if holder is header else place] = copy.deepcopy(data.draw(st.sampled_from(HOSTILE)))
    name = data.draw(st.sampled_from([None, *parts]))
    if name is not None:
        kind = data.draw(st.sampled_from(["f8", "i8", "u1"]))
        parts[name] = np.zeros(data.draw(st.sampled_from([(), (0,), (3,), (2, 3), (3, 2), (2, 0)])), kind)
    try:
        table = Table.from_bytes(encode_arrays(header, parts))
    except RemoteProtocolError:
        return
    assert Table.from_bytes(table.to_bytes()).digest == table.digest
    assert table.places(range(table.rows))
    for name in table.names:
        for value in (*table.column(name).tolist(), -1.0, 2.5):
            assert table.moment(name, value)
            assert table.label(name, value) is None or table.labels


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("labels", ["x"]), ("labels", 3), ("origins", "t"), ("starts", [math.inf]), ("starts", [0.5]), ("starts", "0"),
        ("origins", {"t": ["midnight", math.nan]}), ("origins", {"t": ["midnight", "1"]}), ("labels", {"x": "ab"}),
    ],
)  # fmt: skip
def test_hostile_headers_are_refused(key, value):
    header = {"names": ["x"], "units": [""], "starts": [0], "files": ["a"], "skipped": [], key: value}
    parts = {"columns": np.zeros((1, 3)), "file_of_row": np.zeros(3, np.int64), "line_of_row": np.zeros(3, np.int64)}
    with pytest.raises(RemoteProtocolError, match="the bytes of a table do not fit"):
        Table.from_bytes(encode_arrays(header, parts))
