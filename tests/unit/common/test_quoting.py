"""How sentences quote what a person has given. What may have been meant by a name that is not known."""

from pathlib import Path

import pytest

from atoll_core.quoting import did_you_mean, enumerated, similar_file


@pytest.mark.parametrize(
    ("names", "text"),
    [
        ([], ""),
        (["a"], "a"),
        (["a", "b"], "a and b"),
        (["a", "b", "c"], "a, b and c"),
        (["a", "b", "c", "d"], "a, b, c and d"),
        (["a", "b", "c", "d", "e", "f"], "a, b, c, d and 2 more"),
    ],
)
def test_names_are_enumerated(names: list[str], text: str) -> None:
    assert enumerated(names, 4) == text


def test_all_are_enumerated_unless_there_is_a_bound() -> None:
    assert enumerated("abcdef") == "a, b, c, d, e and f"


@pytest.mark.parametrize(
    ("name", "meant"), [("stats", "states"), ("Time", "time"), ("--sede", "--seed"), ("tme", "time")]
)
def test_the_closest_known_name_is_offered(name: str, meant: str) -> None:
    assert did_you_mean(name, ["states", "time", "--seed", "--season"]) == f"; did you mean '{meant}'?"


def test_nothing_is_offered_where_nothing_is_close() -> None:
    assert did_you_mean("phi", ["states", "time"]) == ""
    assert did_you_mean("x", []) == ""


def test_a_file_of_nearly_the_name_is_offered(tmp_path: Path) -> None:
    (tmp_path / "data.csv").touch()
    assert similar_file(tmp_path / "dtaa.csv") == "; did you mean 'data.csv'?"
    assert similar_file(tmp_path / "none" / "data.csv") == similar_file(tmp_path / "x") == ""
