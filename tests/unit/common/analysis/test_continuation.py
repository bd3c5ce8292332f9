"""Folds, branch points and Hopf points against closed forms; nullclines and conserved quantities."""

import numpy as np
import pytest

from atoll.analysis.conserved import conserved_quantities, is_volume_preserving
from atoll.analysis.continuation import continuation, special_points
from atoll.analysis.nullclines import nullclines
from atoll.analysis.varied import Varied
from tests.unit.common.analysis.systems import COMPETITION, LORENZ, box, flow


def test_folds_of_the_cubic_are_where_its_derivative_vanishes() -> None:
    its = flow(x="0.1 + x - x**3")
    branches = continuation(its, box((-2.0, 2.0)), Varied.parameter(its, 0), (-1.0, 1.0))
    found = special_points(branches)
    assert [each.kind for each in found] == ["fold", "fold"]
    fold = 2.0 / (3.0 * np.sqrt(3.0))
    np.testing.assert_allclose([each.value for each in found], [-fold, fold], rtol=1e-9)
    np.testing.assert_allclose([each.point[0] for each in found], [3**-0.5, -(3**-0.5)], rtol=1e-5)
    assert len(branches) == 1
    assert set(branches[0].unstable.tolist()) == {0, 1}


def test_hopf_points_of_the_nerve_are_where_the_trace_vanishes() -> None:
    """FitzHugh-Nagumo: v' = v - v**3/3 - w + i, w' = e (v + a - b w): the trace is 0 at v = +-sqrt(1 - b e)."""
    a, b, e = 0.7, 0.8, 0.08
    nerve = flow(v="0.5 + v - v**3/3.0 - w", w=f"{e}*(v + {a} - {b}*w)")
    found = special_points(continuation(nerve, box((-3.0, 3.0), (-2.0, 3.0)), Varied.parameter(nerve, 0), (-0.5, 2.0)))
    assert [each.kind for each in found] == ["Hopf", "Hopf"]
    v = np.sqrt(1.0 - b * e) * np.array([-1.0, 1.0])
    np.testing.assert_allclose([each.point[0] for each in found], v, rtol=1e-8)
    np.testing.assert_allclose([each.value for each in found], (v + a) / b - v + v**3 / 3.0, rtol=1e-8)
    frequency = np.sqrt(e - (b * e) ** 2)
    np.testing.assert_allclose([each.frequency for each in found], [frequency, frequency], rtol=1e-7)


def test_a_pitchfork_is_a_branch_point() -> None:
    its = flow(x="0.5*x - x**3")
    found = special_points(continuation(its, box((-2.0, 2.0)), Varied.parameter(its, 0), (-1.0, 1.0)))
    assert {each.kind for each in found} == {"branch point"}
    np.testing.assert_allclose([each.value for each in found], 0.0, atol=1e-6)


def test_nullclines_lie_where_a_rate_vanishes() -> None:
    of_x, of_y = nullclines(COMPETITION, box((0.1, 4.0), (0.1, 3.0)))
    (line,) = of_x
    np.testing.assert_allclose(line[:, 0] + 2.0 * line[:, 1], 3.0, atol=1e-9)
    assert np.ptp(line[:, 0]) == pytest.approx(2.7, abs=0.02)
    (line,) = of_y
    np.testing.assert_allclose(line.sum(axis=1), 2.0, atol=1e-9)


def test_a_pole_is_no_nullcline_and_a_circle_is_closed() -> None:
    of_x, of_y = nullclines(flow(x="1.0/(x - 0.13)", y="x**2 + y**2 - 1.0"), box((-2.0, 2.0), (-2.0, 2.0)))
    assert of_x == ()
    (circle,) = of_y
    np.testing.assert_allclose(np.hypot(*circle.T), 1.0, atol=1e-9)
    assert (circle[0] == circle[-1]).all()


def test_energy_and_lotka_volterras_integral_are_hinted() -> None:
    (energy,) = conserved_quantities(flow(x="y", y="-2.0*sin(x)"), box((-2.0, 2.0), (-2.0, 2.0)))
    assert {name: value for value, name in energy.terms} == pytest.approx({"y**2": -0.25, "cos(x)": 0.5 * 1.0 + 0.5})
    (volterra,) = conserved_quantities(flow(x="x*(1.0 - y)", y="y*(x - 2.0)"), box((0.1, 4.0), (0.1, 4.0)))
    its = {name: value for value, name in volterra.terms}
    assert {name: value / its["x"] for name, value in its.items()} == pytest.approx(
        {"x": 1.0, "y": 1.0, "log(x)": -2.0, "log(y)": -1.0}
    )


def test_a_dissipative_system_keeps_nothing() -> None:
    where = box((-20.0, 20.0), (-20.0, 20.0), (0.0, 40.0))
    assert conserved_quantities(LORENZ, where) == ()
    assert not is_volume_preserving(LORENZ, where)
    assert is_volume_preserving(flow(x="y", y="-sin(x)"), box((-1, 1), (-1, 1)))
