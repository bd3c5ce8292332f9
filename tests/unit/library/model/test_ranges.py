"""What is extrapolated is told by the ranges that were measured, as they are printed."""

import pytest

from atoll.model.equations import names_outside, outside_sentence

RANGES = {"x": (0.123456, 98.7654), "y": (-1000.4, 0.0), "z": (3.0, 3.0)}


def test_an_end_as_it_is_printed_is_not_outside() -> None:
    printed = [float(f"{end:.4g}") for end in (*RANGES["x"], *RANGES["y"])]
    for name, end in zip("xxyy", printed, strict=True):
        assert names_outside({name: end}, RANGES) == ()


@pytest.mark.parametrize(("name", "value"), [("x", 0.1233), ("x", 98.9), ("y", -1001.0), ("y", 0.01), ("z", 3.01)])
def test_what_is_beyond_an_end_is_outside(name: str, value: float) -> None:
    """A number outside by a hundredth of the range counted as inside: y = 10 of -1000 to 0."""
    assert names_outside({name: value}, RANGES) == (name,)
    assert f"{name} = {value:.4g} (measured: " in outside_sentence({name: value}, RANGES)


def test_what_has_no_range_is_in_none() -> None:
    assert outside_sentence({"angle": 700.0}, RANGES) == ""
