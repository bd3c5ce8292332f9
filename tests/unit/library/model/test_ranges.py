"""Extrapolation is reported relative to the measured ranges, as they are printed."""

import pytest

from atoll.model.equations import outside_sentence

RANGES = {"x": (0.123456, 98.7654), "y": (-1000.4, 0.0), "z": (3.0, 3.0)}


@pytest.mark.parametrize(("name", "value"), [("x", 0.1233), ("x", 98.9), ("y", -1001.0), ("y", 0.01), ("z", 3.01)])
def test_a_printed_end_is_inside_and_a_number_beyond_it_is_outside(name: str, value: float) -> None:
    """A number outside by a hundredth of the range counted as inside: y = 10 of -1000 to 0."""
    assert all(outside_sentence({name: float(f"{end:.4g}")}, RANGES) == "" for end in RANGES[name])
    assert f"{name} = {value:.4g} (measured: " in outside_sentence({name: value}, RANGES)
    assert outside_sentence({"angle": 700.0}, RANGES) == ""
