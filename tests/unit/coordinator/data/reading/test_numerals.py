"""Numbers as countries write them: decimal commas, separators of thousands, and what tells them apart."""

import pytest

from atoll_coordinator.data.reading.cells import read_numbers
from atoll_core.errors import DataError


def numbers(separator=",", **columns):
    cells = {name: text.split("|") for name, text in columns.items()}
    read, remarks = read_numbers("a.csv", cells, [0] * len(next(iter(cells.values()))), separator)
    return {name: values.tolist() for name, values in read.items()}, remarks


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1,234.5|6", [1234.5, 6.0]),
        ("1,234,567|1.5", [1234567.0, 1.5]),
        ("1.234,5|6", [1234.5, 6.0]),
        ("0,5|-1,25e-3", [0.5, -0.00125]),
        ("1 234,5|2", [1234.5, 2.0]),
        ("1 234.5|2", [1234.5, 2.0]),
        ("1'234.5|2", [1234.5, 2.0]),
        ("1 234|5 678", [1234.0, 5678.0]),
        ("1.234.567|0", [1234567.0, 0.0]),
        ("0,100|0,103|-0,106", [0.1, 0.103, -0.106]),
        ("1.00000D+00|9.5d-1|.5D0", [1.0, 0.95, 0.5]),
    ],
)
def test_a_column_tells_how_it_is_written(text, expected):
    assert numbers("\t", x=text)[0]["x"] == expected


@pytest.mark.parametrize(("separator", "expected"), [(",", 1234.0), (";", 1.234)])
def test_what_separates_cells_decides_where_nothing_else_does(separator, expected):
    assert numbers(separator, x="1,234|2,345")[0]["x"][0] == expected


def test_other_columns_decide_before_that():
    assert numbers(";", x="1,234|2,345", t="0.5|1.5")[0]["x"] == [1234.0, 2345.0]
    assert numbers("\t", x="1,234|2,345", t="0,5|1,5")[0]["x"] == [1.234, 2.345]


def test_a_group_of_thousands_never_begins_with_zero():
    read, remarks = numbers(",", t="0,000|0,100", x="4,000|3,715")
    assert (read, remarks) == ({"t": [0.0, 0.1], "x": [4.0, 3.715]}, ("decimal commas in t, x",))


def test_columns_that_contradict_each_other_decide_nothing():
    with pytest.raises(DataError, match=r"'x' of a\.csv holds '4,000', which may be 4000 or 4;"):
        numbers(",", t="0,5|1,5", y="0.5|1.5", x="4,000|3,715")


def test_points_separate_thousands_where_commas_are_decimal():
    read, remarks = numbers(";", x="1.234|12.345", t="0,5|1,5")
    assert read["x"] == [1234.0, 12345.0]
    assert remarks == ("decimal commas in t", "separators of thousands in x")
    assert numbers(";", x="1.234|12.5", t="0,5|1,5")[0]["x"] == [1.234, 12.5]


def test_points_and_commas_of_three_digits_are_read_as_one_country_writes_them():
    assert numbers(";", x="1.234|12.345", y="1,234|2,345")[0] == {"x": [1234.0, 12345.0], "y": [1.234, 2.345]}


def test_plain_numbers_have_no_remark():
    assert numbers(x="1.234|1e5|") == ({"x": [1.234, 1e5, pytest.approx(float("nan"), nan_ok=True)]}, ())


@pytest.mark.parametrize("text", ["1,23,456", "12,34.5", "1.2.3", "1,234 567", "0x10", "1,5,6", "4_002", "1D2", ".D2"])
def test_other_texts_are_no_numbers(text):
    with pytest.raises(DataError, match="where a number is expected"):
        numbers(x=f"1|{text}")
