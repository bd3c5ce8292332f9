"""A figure passes where it is what it should be."""

import pytest

from benchmarks.analysis.check import near, same, seconds


@pytest.mark.parametrize(
    ("check", "passes"),
    [
        (near("p", "q", 1.019, 1.0, "", 0.02), True),
        (near("p", "q", -10.3, -10.0, "", 0.02), False),
        (near("p", "q", 0.03, 0.0, "", 0.02), False),
        (same("p", "q", [1, 2], [1, 2], ""), True),
        (seconds("p", "q", [0.1, 0.2, 9.0], 0.3), True),
        (seconds("p", "q", [1.0], None), None),
    ],
)
def test_a_figure_is_compared_with_what_is_expected(check: object, passes: bool | None) -> None:
    assert check.passes is passes  # type: ignore[attr-defined]
