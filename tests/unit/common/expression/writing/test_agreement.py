"""A shorter writing stands only where it has the values of the longer one over the box of the data."""

import numpy as np

from atoll_core.expression.text.parsing import from_infix
from atoll_core.expression.writing import shortest as search
from atoll_core.expression.writing.shortest import agree, points_of, shortest_over

NAMES = ("x", "y")
BOX = np.array([[-1.0, 0.2, 3.0], [2.0, 2.5, 2.25]])


def test_the_points_are_the_rows_and_fill_the_box():
    points = points_of(BOX)
    assert np.array_equal(points[:, :3], BOX)
    inner = points[:, 3:]
    for low, high, index in ((-1.0, 3.0, inner[0]), (2.0, 2.5, inner[1])):
        assert index.min() >= low
        assert index.max() <= high
        assert np.histogram(index, 5, (low, high))[0].min() >= len(index) // 6
    assert len({*inner[0].tolist()}) == inner.shape[1]


def test_values_differ_or_a_pole_appears():
    program = from_infix("x*y", NAMES)
    points = points_of(BOX)
    assert agree(program, from_infix("y*x + 1e-12", NAMES), points)
    assert not agree(program, from_infix("x*y + 0.001", NAMES), points)
    assert not agree(program, from_infix("x*y + log(x) - log(x)", NAMES), points)
    assert agree(from_infix("x*y + log(x) - log(x)", NAMES), program, points)


def test_a_writing_that_differs_on_the_box_is_not_taken(monkeypatch):
    program = from_infix("x + y - y", NAMES)
    assert shortest_over(program, BOX) == from_infix("x", NAMES)
    monkeypatch.setattr(search, "shortest", lambda _: from_infix("y", NAMES))
    assert shortest_over(program, BOX) == program
