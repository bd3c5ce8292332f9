"""Names fit a language, differ, and are the same wherever they can be."""

import pytest

from atoll.export.language import Naming

NAMING = Naming(frozenset({"end", "pi"}), ("row_",), longest=8)


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["x", "y1"], ["x", "y1"]),
        (["end", "end_"], ["end__2", "end_"]),
        (["θ", "theta"], ["theta_2", "theta"]),
        (["Ω", "ж", "é"], ["Omega", "zhe", "e"]),
        (["x 1", "x-1"], ["x_1", "x_1_2"]),
        (["_a", "2nd", "価"], ["a", "x2nd", "x"]),
        (["temperature", "temperate"], ["temperat", "temper_2"]),
        (["π"], ["pi_"]),
        (["row_1", "xrow_1"], ["xrow_1_2"[:8], "xrow_1"]),
    ],
)
def test_names_are_kept_spelled_or_numbered(names: list[str], expected: list[str]) -> None:
    assert list(NAMING.assign({name: name for name in names}).values()) == expected


def test_case_may_tell_nothing_apart() -> None:
    naming = Naming(frozenset({"Sin"}), is_caseless=True)
    assert naming.assign({"A": "A", "a": "a", "sin": "sin"}) == {"A": "A", "a": "a_2", "sin": "sin_"}
