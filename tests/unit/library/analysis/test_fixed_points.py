"""Fixed points and kinds of the paper's seven systems and of others, against closed forms.

Sources: COMPETITION, the linear part by hand (Strogatz 1994, section 6.4); glider: v**4 = 1/(1 + 0.05**2) and
tan(theta) = -0.05 from cos(theta) = v**2 and sin(theta) = -0.05 v**2; bacterial respiration: x = 20 - 10, y from
10 = x y/(1 + x**2/2) (Strogatz, exercise 7.3.8); predator-prey: y = (4 - x)(1 + x) and y = x/(0.075 (1 + x))
(exercise 7.2.17, after Odell 1980); magnets and shear flow by symmetry; van der Pol in Lienard's form:
trace 10, determinant 1.
"""

import numpy as np
import pytest

from atoll.analysis.fixed_points import fixed_points, kind_of
from tests.unit.library.analysis.systems import COMPETITION, LORENZ, box, flow

PI = float(np.pi)
V = (1.0 + 0.05**2) ** -0.25
SEVEN = {
    "glider": (
        flow(v="-0.05*v**2 - sin(theta)", theta="v - cos(theta)/v"),
        box((0.1, 3.0), (-3.0, 3.0)),
        {(V, -float(np.arctan(0.05))): "stable focus"},
    ),
    "respiration": (
        flow(x="20.0 - x - x*y/(1.0 + 0.5*x**2)", y="10.0 - x*y/(1.0 + 0.5*x**2)"),
        box((0.0, 20.0), (0.0, 80.0)),
        {(10.0, 51.0): "stable focus"},
    ),
    "magnets": (
        flow(a="0.5*sin(a - b) - sin(a)", b="0.5*sin(b - a) - sin(b)"),
        box((-1.0, 4.0), (-1.0, 4.0)),
        {(0.0, 0.0): "non-hyperbolic", (0.0, PI): "saddle", (PI, 0.0): "saddle", (PI, PI): "unstable node"},
    ),
    "shear": (
        flow(theta="cot(phi)*cos(theta)", phi="(cos(phi)**2 + 0.1*sin(phi)**2)*sin(theta)"),
        box((-1.0, 4.0), (0.5, 2.5)),
        {(0.0, PI / 2): "centre", (PI, PI / 2): "centre"},
    ),
    "van der Pol": (
        flow(x="10.0*(y - (x**3/3.0 - x))", y="-x/10.0"),
        box((-3.0, 3.0), (-2.0, 2.0)),
        {(0.0, 0.0): "unstable node"},
    ),
    "Lotka-Volterra": (
        COMPETITION,
        box((0.0, 4.0), (0.0, 3.0)),
        {
            (0.0, 0.0): "unstable node",
            (0.0, 2.0): "stable node",
            (1.0, 1.0): "saddle",
            (3.0, 0.0): "stable node",
        },
    ),
}


@pytest.mark.parametrize("name", SEVEN)
def test_the_papers_systems_have_their_fixed_points(name: str) -> None:
    system, where, expected = SEVEN[name]
    fixed = fixed_points(system, where)
    assert fixed.are_isolated
    points = sorted(fixed.points, key=lambda point: tuple(np.round(point.point, 3) + 0.0))
    assert [point.kind for point in points] == [expected[point] for point in sorted(expected)]
    atol = 1e-3 if "non-hyperbolic" in expected.values() else 1e-9
    np.testing.assert_allclose([point.point for point in points], sorted(expected), atol=atol)


@pytest.mark.slow
def test_attraction_without_a_negative_eigenvalue_is_seen_in_simulations() -> None:
    degenerate = flow(x="-x**3", y="-y")
    assert [point.is_stable for point in fixed_points(degenerate, box((-1, 1), (-1, 1))).points] == [True]
    passing = flow(x="x**2", y="-y")
    assert [point.is_stable for point in fixed_points(passing, box((-1, 1), (-1, 1))).points] == [False]


@pytest.mark.slow
def test_a_weak_focus_is_no_centre() -> None:
    (point,) = fixed_points(flow(x="-y - x*(x**2 + y**2)", y="x - y*(x**2 + y**2)"), box((-1, 1), (-1, 1))).points
    assert (point.kind, point.is_stable) == ("non-hyperbolic", True)
    (point,) = fixed_points(flow(x="-y", y="x"), box((-1, 1), (-1, 1))).points
    assert (point.kind, point.is_stable) == ("centre", False)


def test_lorenz_has_saddle_foci_beside_a_saddle() -> None:
    points = fixed_points(LORENZ, box((-25.0, 25.0), (-25.0, 25.0), (0.0, 50.0))).points
    assert [point.kind for point in points] == ["saddle-focus", "saddle", "saddle-focus"]
    side = float(np.sqrt(72.0))
    np.testing.assert_allclose(
        [point.point for point in points], [(-side, -side, 27), (0, 0, 0), (side, side, 27)], atol=1e-9
    )


@pytest.mark.parametrize(
    ("eigenvalues", "kind"),
    [
        ([-1.0], "stable node"),
        ([2.0, 1.0], "unstable node"),
        ([1j, -1j], "centre"),
        ([0.1, 1j, -1j], "non-hyperbolic"),
        ([-1.0, -1 + 1j, -1 - 1j], "stable focus"),
        ([0.0, 0.0], "non-hyperbolic"),
    ],
)
def test_kinds_follow_from_eigenvalues(eigenvalues: list[complex], kind: str) -> None:
    assert kind_of(np.array(sorted(eigenvalues, key=lambda point: -complex(point).real), dtype=complex)) == kind


def test_a_real_part_of_rounding_is_none() -> None:
    system = flow(theta="cot(phi)*cos(theta)", phi="(cos(phi)**2 + 0.1*sin(phi)**2)*sin(theta)")
    (point,) = fixed_points(system, box((2.0, 4.0), (0.5, 2.5))).points
    np.testing.assert_array_equal(point.eigenvalues.real, 0.0)


@pytest.mark.parametrize(
    ("equations", "sides"),
    [
        ({"x": "exp(-x)"}, [(0.0, 600.0)]),
        ({"x": "exp(-x**2)"}, [(-10.0, 10.0)]),
        ({"x": "1.0/(1.0 + x**6)"}, [(-1e3, 1e4)]),
        ({"x": "x**2 + 1e-12"}, [(-1.0, 1.0)]),
        ({"x": "-x*exp(-y)", "y": "exp(-y)"}, [(0.0, 100.0), (0.0, 100.0)]),
    ],
)
def test_where_rates_only_become_small_is_no_fixed_point(equations: dict[str, str], sides: list[tuple]) -> None:
    assert fixed_points(flow(**equations), box(*sides)).points == ()
