"""How sentences quote what a person has given."""

import pytest

from atoll_core.quoting import enumerated


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
