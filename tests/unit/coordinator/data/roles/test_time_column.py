"""Which column is the time: the one that options name, else one that is called so and has no other role."""

import pytest

from atoll_coordinator.data.roles.columns import find_time_column
from atoll_core.config import DataConfig


@pytest.mark.parametrize(
    ("names", "options", "expected"),
    [
        ("x time y", {}, "time"),
        ("time x t", {}, "t"),
        ("year t x", {"time": "year"}, "year"),
        ("t x", {"states": ("t", "x")}, None),
        ("t time x", {"target": "t"}, "time"),
        ("t x", {"inputs": ("t",)}, "t"),
        ("x y", {}, None),
    ],
)
def test_the_time_is_named_or_called_so(names, options, expected):
    assert find_time_column(names.split(), DataConfig(**options)) == expected
