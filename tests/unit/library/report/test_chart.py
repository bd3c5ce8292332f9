"""Charts: ticks are round and within bounds, lines are interrupted where numbers are missing."""

import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from atoll.report.markup import Axis, Chart, Element, ticks


@given(st.floats(-1e9, 1e9), st.floats(1e-6, 1e9))
def test_ticks_are_few_within_bounds_and_told_apart(low: float, width: float) -> None:
    high = low + width
    if not (high - low) > 1e-9 * max(abs(low), abs(high)):
        return
    places = ticks((low, high), False)
    assert 2 <= len(places) <= 7
    assert all(low - 1e-6 * width <= place <= high + 1e-6 * width for place, _ in places)
    assert len({label for _, label in places}) == len(places)


@pytest.mark.parametrize(
    ("bounds", "labels"),
    [
        ((-3.0, 0.1), ["0.001", "0.01", "0.1", "1"]),
        ((0.0, 1.0), ["1", "2", "5", "10"]),
        ((-0.4, -0.1), ["0.4", "0.5", "0.6", "0.7"]),
        ((-12.0, 0.0), ["1e-12", "1e-09", "1e-06", "0.001", "1"]),
    ],
)
def test_logarithmic_ticks_are_powers_of_ten_or_parts_of_them(bounds: tuple[float, float], labels: list[str]) -> None:
    assert [label for _, label in ticks(bounds, True)] == labels


def paths(svg: Element, style: str) -> list[str]:
    return [element.get("d", "") for element in svg.iter("path") if style in (element.get("class") or "").split()]


def test_a_line_is_interrupted_where_a_number_is_missing() -> None:
    chart = Chart("a chart", Axis("t"), Axis("x"))
    chart.add_line([0.0, 1.0, 2.0, 3.0, 4.0], [0.0, 1.0, None, 1.0, math.nan], "c0")
    (path,) = paths(chart.svg(), "line")
    assert re.sub(r"[-\d.,]+", "", path) == "MLM"


def test_what_has_no_logarithm_is_left_out() -> None:
    chart = Chart("a chart", Axis("n"), Axis("error", is_logarithmic=True))
    chart.add_points([1.0, 2.0, 3.0], [0.1, 0.0, None], "c0")
    assert len(list(chart.svg().iter("circle"))) == 1


def test_a_band_is_closed_over_the_rows_that_are_known() -> None:
    chart = Chart("a chart", Axis("t"), Axis("x"))
    chart.add_band([0.0, 1.0, 2.0], [0.0, None, 0.0], [1.0, 1.0, 1.0], "c0")
    (path,) = paths(chart.svg(), "area")
    assert re.sub(r"[-\d.,]+", "", path) == "MLLLZ"
