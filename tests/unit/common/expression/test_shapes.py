"""Shapes of expressions: which texts are shapes, and which expressions have them."""

import numpy as np
import pytest

from atoll_core.errors import UsageError
from atoll_core.expression.shapes import read_shapes, shape_points
from atoll_core.expression.text.parsing import from_infix

NAMES = ("S", "u")
ROWS = np.stack([np.linspace(0.1, 3.0, 40), np.linspace(-1.0, 1.0, 40)])
MONOD = "0.5*S/(0.3 + S)"


@pytest.mark.parametrize(
    ("shape", "kept", "left"),
    [
        ("positive", ("S", "S*S - S + 0.3", "0"), ("S - 1", "-S", "u")),
        ("increasing in S", (MONOD, "S + u", "2", "u", "S**3"), ("S*(2 - S)", "-S", "S*u")),
        ("decreasing in u", ("S - u", "exp(-u)"), ("S + u", "u*u", "S*u")),
        ("S -> 0: 0", (MONOD, "S*u", "0"), (f"0.1 + {MONOD}", "1/S", "S + u")),
        ("S -> inf: 0.4..0.6", (MONOD, "0.5"), ("S", "0.7*S/(1 + S)", "exp(-S)")),
        ("u -> -inf: 0", ("exp(u)", "1/(3 - u)"), ("tanh(u)", "u")),
        ("u -> 2: 1..5", ("2 + 0*S",), ("u*u*u", "S - 1")),
    ],
)
def test_an_expression_has_a_shape_or_not(shape: str, kept: tuple[str, ...], left: tuple[str, ...]) -> None:
    shapes, points = read_shapes([shape], NAMES, "--shape"), shape_points(ROWS)
    assert [text for text in kept if not shapes.are_kept(from_infix(text, NAMES), points)] == []
    assert [text for text in left if shapes.are_kept(from_infix(text, NAMES), points)] == []


def test_all_shapes_of_an_expression_are_demanded() -> None:
    shapes = read_shapes(["positive", "increasing in S"], NAMES, "").with_all(read_shapes(["S -> 0: 0"], NAMES, ""))
    points = shape_points(ROWS)
    assert shapes.are_kept(from_infix(MONOD, NAMES), points)
    for text in ("S + 1", "3 - S", "S*(S - 0.2)"):
        assert not shapes.are_kept(from_infix(text, NAMES), points), text


def test_points_lie_in_the_measured_box_and_not_only_on_the_curve() -> None:
    """A law may have its shape along the measured curve only by accident."""
    points = shape_points(ROWS)
    assert points.shape == (2, 80)
    assert (points[:, :40] == ROWS).all()
    assert ((points >= ROWS.min(axis=1, keepdims=True)) & (points <= ROWS.max(axis=1, keepdims=True))).all()
    on_curve = np.interp(points[0, 40:], *ROWS)
    assert np.abs(points[1, 40:] - on_curve).max() > 1.0
    assert np.isin(points[1], ROWS[1]).all()


def test_large_tables_have_few_points_and_small_ones_all_rows() -> None:
    assert shape_points(np.ones((3, 100_000))).shape[1] <= 256
    assert shape_points(np.ones((3, 1))).shape == (3, 2)


def test_values_that_do_not_exist_do_not_count() -> None:
    shapes = read_shapes(["positive"], NAMES, "")
    assert shapes.are_kept(from_infix("sqrt(u)", NAMES), shape_points(ROWS))
    assert shapes.are_kept(from_infix("log(-S)", NAMES), shape_points(ROWS))


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("growing in S", "must be of the form"),
        ("increasing in X", "names X, but the variables are S, u"),
        ("S -> 0", "must be of the form"),
        ("S -> 0: 3..1", "write the smaller number first"),
        ("x -> inf: 0", "names x"),
    ],
)
def test_what_is_no_shape_is_refused(text: str, part: str) -> None:
    with pytest.raises(UsageError, match=f"--monotone.*{part}"):
        read_shapes([text], NAMES, "--monotone")
