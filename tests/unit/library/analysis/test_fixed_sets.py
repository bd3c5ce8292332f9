"""Curves and surfaces of fixed points, half-stable points, eigenvalues of very different size, against closed forms."""

import numpy as np
import pytest

from atoll.analysis.analyse import analyse
from atoll.analysis.fixed_points import fixed_points
from tests.unit.library.analysis.systems import box, flow

UNIT = (0.0, 1.0)


def test_eigenvalues_of_very_different_size_make_a_node() -> None:
    (point,) = fixed_points(flow(x="-x", y="1e7*(x - y)"), box((-1, 1), (-1, 1))).points
    assert (point.kind, point.is_stable) == ("stable node", True)
    np.testing.assert_allclose(point.eigenvalues, [-1.0, -1e7])


def test_an_eigenvalue_is_zero_beside_its_own_uncertainty_alone() -> None:
    slow = fixed_points(flow(x="-1e-9*x", y="-y"), box((-1, 1), (-1, 1))).points
    assert [(point.kind, point.is_stable) for point in slow] == [("stable node", True)]
    critical = fixed_points(flow(x="v", v="-x - 2.0*v"), box((-1, 1), (-1, 1))).points
    assert [point.kind for point in critical] == ["stable node"]
    (weak,) = fixed_points(flow(x="v", v="-x - 1e-9*v"), box((-1, 1), (-1, 1))).points
    assert weak.kind == "stable focus"


@pytest.mark.parametrize(
    ("side", "bounds", "at", "attracts_in_box"),
    [
        ("x**2", (-1.0, 1.0), 0.0, False),
        ("-x**2", (0.0, 1.0), 0.0, True),
        ("-x*(x - 1.0)**2", (0.0, 2.0), 1.0, False),
        ("-(x - 1.0)**2*(x + 1.0)", (1.0, 3.0), 1.0, True),
    ],
)
def test_half_stable_points_are_not_stable(
    side: str, bounds: tuple[float, float], at: float, attracts_in_box: bool
) -> None:
    points = {round(float(point.point[0]), 3): point for point in fixed_points(flow(x=side), box(bounds)).points}
    assert points[at].kind == "non-hyperbolic"
    assert (points[at].is_stable, points[at].attracts_in_box) == (False, attracts_in_box)


def test_reactants_in_balance_rest_on_a_line_that_attracts() -> None:
    """A <-> B with rates 1 and 3: b = a/3 whatever the sum, and the eigenvalue across it is -4."""
    fixed = fixed_points(flow(a="3.0*b - a", b="a - 3.0*b"), box(UNIT, UNIT))
    assert fixed.points == ()
    (line,) = fixed.sets
    assert (line.dimension, line.is_straight) == (1, True)
    ends = sorted([line.course[0].tolist(), line.course[-1].tolist()])
    np.testing.assert_allclose(ends, [[0.0, 0.0], [1.0, 1.0 / 3.0]], atol=1e-6)
    for point in line.points:
        assert (point.kind, point.is_stable) == ("stable node", True)
        np.testing.assert_allclose(point.eigenvalues, [0.0, -4.0], atol=1e-9)


def test_lines_that_cross_are_two_and_points_beside_them_stay() -> None:
    fixed = fixed_points(flow(x="x*y*(x - 0.5)", y="x*y*(y - 0.7)"), box((-1, 1), (-1, 1)))
    assert [one.dimension for one in fixed.sets] == [1, 1]
    assert all(one.is_straight for one in fixed.sets)
    np.testing.assert_allclose([point.point for point in fixed.points], [[0.5, 0.7]], atol=1e-9)


def test_a_circle_of_fixed_points_is_one_closed_curve() -> None:
    (circle,) = fixed_points(flow(x="x*(1.0 - x**2 - y**2)", y="y*(1.0 - x**2 - y**2)"), box((-2, 2), (-2, 2))).sets
    assert (circle.dimension, circle.is_straight) == (1, False)
    np.testing.assert_allclose(np.hypot(*circle.course.T), 1.0, atol=1e-9)
    np.testing.assert_allclose(circle.course[0], circle.course[-1], atol=1e-12)


def test_an_epidemic_without_births_ends_on_a_surface() -> None:
    """S' = -2 S I, I' = 2 S I - I, R' = I: all with I = 0 rest, and attract where S < 1/2."""
    analysis = analyse(flow(S="-2.0*S*I", I="2.0*S*I - I", R="I").field, box(UNIT, UNIT, UNIT))
    (surface,) = analysis.fixed_points.sets
    assert surface.dimension == 2
    for point in surface.points:
        s = float(point.point[0])
        assert point.is_stable == (s < 0.5) or abs(s - 0.5) < 1e-3
        assert round(float(point.eigenvalues.real[np.abs(point.eigenvalues).argmax()]), 6) == round(2.0 * s - 1.0, 6)
    assert (analysis.basins.reached == 0).all()
    assert "surface of fixed points of 2 dimensions, attracts in parts" in str(analysis)


def test_a_stiff_model_is_followed_to_where_it_rests() -> None:
    """A fast variable follows a slow one, 1e7 times as fast; explicit steps end after a millionth of the way."""
    analysis = analyse(flow(x="x*(1.0 - x)", y="1e7*(x**2 - y)").field, box((0.1, 1.5), (0.0, 2.0)))
    (point,) = analysis.fixed_points.points
    np.testing.assert_allclose(point.point, [1.0, 1.0])
    assert (analysis.basins.reached == 0).all()
    assert analysis.lyapunov is None


@pytest.mark.slow
def test_a_slow_way_is_followed_to_its_end() -> None:
    """Robertson's reactions: A disappears as 1/t, for ever; the sum of all stays."""
    rates = {"A": "1e4*B*C - 0.04*A", "B": "0.04*A - 1e4*B*C - 3e7*B**2", "C": "3e7*B**2"}
    analysis = analyse(flow(**rates).field, box((0.0, 1.4), (0.0, 5e-5), (0.0, 1.3)))
    (line,) = analysis.fixed_points.sets
    np.testing.assert_allclose(line.course[:, :2], 0.0, atol=1e-9)
    assert all(point.attracts_in_box and not point.is_stable for point in line.points[1:-1])
    assert (analysis.basins.reached == 0).all()
    assert "by simulations a stable node within the box" in str(analysis)
