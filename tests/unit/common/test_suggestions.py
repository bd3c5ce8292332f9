"""What may have been meant by a name that is not known."""

import pytest

from atoll.suggestions import did_you_mean


@pytest.mark.parametrize(
    ("name", "meant"), [("stats", "states"), ("Time", "time"), ("--sede", "--seed"), ("tme", "time")]
)
def test_the_closest_known_name_is_offered(name: str, meant: str) -> None:
    assert did_you_mean(name, ["states", "time", "--seed", "--season"]) == f"; did you mean '{meant}'?"


def test_nothing_is_offered_where_nothing_is_close() -> None:
    assert did_you_mean("phi", ["states", "time"]) == ""
    assert did_you_mean("x", []) == ""
