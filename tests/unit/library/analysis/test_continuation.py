"""Folds, branch points and Hopf points against closed forms; nullclines and conserved quantities."""

from typing import Any

import numpy as np
import pytest

from atoll.analysis.conserved import conserved_quantities, is_volume_preserving
from atoll.analysis.continuation import ContinuationParameter, continuation, special_points
from atoll.analysis.flow import Flow
from atoll.analysis.nullclines import nullclines
from atoll.model.vector_field import VectorField
from tests.unit.library.analysis.systems import COMPETITION, box, flow


def constant(system: Flow) -> ContinuationParameter:
    """Return the first constant as what varies."""
    return ContinuationParameter("c1", float(system.parameters[0]), (0,), (1.0,))


def test_folds_of_the_cubic_are_where_its_derivative_vanishes() -> None:
    system = flow(x="0.1 + x - x**3")
    branches = continuation(system, box((-2.0, 2.0)), constant(system), (-1.0, 1.0))
    points = special_points(branches)
    assert [point.kind for point in points] == ["fold", "fold"]
    fold = 2.0 / (3.0 * np.sqrt(3.0))
    np.testing.assert_allclose([point.value for point in points], [-fold, fold], rtol=1e-9)
    np.testing.assert_allclose([point.point[0] for point in points], [3**-0.5, -(3**-0.5)], rtol=1e-5)
    assert len(branches) == 1
    assert set(branches[0].unstable.tolist()) == {0, 1}


def test_hopf_points_of_the_nerve_are_where_the_trace_vanishes() -> None:
    """FitzHugh-Nagumo: v' = v - v**3/3 - w + i, w' = e (v + a - b w): the trace is 0 at v = +-sqrt(1 - b e)."""
    a, b, e = 0.7, 0.8, 0.08
    nerve = flow(v="0.5 + v - v**3/3.0 - w", w=f"{e}*(v + {a} - {b}*w)")
    points = special_points(continuation(nerve, box((-3.0, 3.0), (-2.0, 3.0)), constant(nerve), (-0.5, 2.0)))
    assert [point.kind for point in points] == ["Hopf", "Hopf"]
    v = np.sqrt(1.0 - b * e) * np.array([-1.0, 1.0])
    np.testing.assert_allclose([point.point[0] for point in points], v, rtol=1e-8)
    np.testing.assert_allclose([point.value for point in points], (v + a) / b - v + v**3 / 3.0, rtol=1e-8)
    frequency = np.sqrt(e - (b * e) ** 2)
    np.testing.assert_allclose([point.frequency for point in points], [frequency, frequency], rtol=1e-7)


def test_a_pitchfork_is_a_branch_point() -> None:
    system = flow(x="0.5*x - x**3")
    points = special_points(continuation(system, box((-2.0, 2.0)), constant(system), (-1.0, 1.0)))
    assert {point.kind for point in points} == {"branch point"}
    np.testing.assert_allclose([point.value for point in points], 0.0, atol=1e-6)


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
    system = {name: value for value, name in volterra.terms}
    assert {name: value / system["x"] for name, value in system.items()} == pytest.approx(
        {"x": 1.0, "y": 1.0, "log(x)": -2.0, "log(y)": -1.0}
    )


def test_an_angle_is_what_the_model_has_a_sine_of() -> None:
    (energy,) = conserved_quantities(flow(x="y", y="-2.0*sin(3.0*x)"), box((-2.0, 2.0), (-2.0, 2.0)))
    assert {name: value for value, name in energy.terms} == pytest.approx({"y**2": -0.75, "cos(3*x)": 1.0})


@pytest.mark.parametrize(
    ("equations", "sides"),
    [
        ({"x": "-x"}, [(0.0, 1e-3)]),
        ({"x": "-x"}, [(1000.0, 1000.0001)]),
        ({"x": "y", "y": "-x - 0.1*y**3"}, [(0.0, 1e-10), (0.0, 1e-10)]),
        ({"x": "y", "y": "-x - 0.1*y**3"}, [(-1e-10, 0.0), (-1e-10, 0.0)]),
        ({"x": "y", "y": "-sin(x) - 0.00001*y"}, [(0.0, 1e-5), (0.0, 1e-5)]),
        ({"x": "0.3*y - x", "y": "x*y - 2.0*y"}, [(1000.0, 1000.001), (1000.0, 1000.001)]),
        ({"x": "0.3*y - x", "y": "x*y - 2.0*y"}, [(-1000.001, -1000.0), (-1000.001, -1000.0)]),
        (
            {"s": "0.1*p - 2.0*s*i", "i": "2.0*s*i - 0.5*i", "p": "0.5*i - 0.12*p"},
            [(0.0, 1.0), (0.0, 1.0), (0.0, 1e-3)],
        ),
    ],
)
def test_no_law_is_hinted_where_there_is_none_however_small_or_far_the_box(equations: Any, sides: Any) -> None:
    assert conserved_quantities(flow(**equations), box(*sides)) == ()
    assert not is_volume_preserving(flow(**equations), box(*sides))


def test_a_law_is_seen_in_a_narrow_box_as_well() -> None:
    (energy,) = conserved_quantities(flow(x="y", y="-2.0*sin(x)"), box((1.0, 1.001), (1.0, 1.001)))
    assert energy.text == "-0.25*y**2 + cos(x)"


WIDE = ((-2.0, 2.0), (-2.0, 2.0))
ABOVE = ((0.1, 2.0), (0.1, 2.0))


@pytest.mark.parametrize(
    ("equations", "sides", "laws"),
    [
        ({"x": "y", "y": "0.0"}, WIDE, ["y"]),
        ({"s": "-2.0*s*i", "i": "2.0*s*i - 0.7*i", "r": "0.7*i"}, (*ABOVE, (0.1, 2.0)), ["s + i + r"]),
        ({"s": "-2.0*s*i", "i": "2.0*s*i - 0.7*i"}, ABOVE, ["s + i - 0.35*log(s)"]),
        ({"s": "-2.0*s*i", "i": "2.0*s*i - 0.7*i"}, ((0.0, 2.0), (0.0, 2.0)), ["s + i - 0.35*log(s)"]),
        ({"s": "-2.0*s*i", "i": "2.0*s*i - 0.7*i"}, ((-0.1, 2.0), (0.1, 2.0)), []),  # log(s) is none there
        (
            {"x": "2.0*y*z", "y": "-3.0*x*z", "z": "x*y"},  # Euler's top
            (*WIDE, (-2.0, 2.0)),
            ["x**2 + 0.6666666667*y**2", "-0.5*x**2 + z**2"],
        ),
        ({"x": "y", "y": "x - x**3"}, WIDE, ["-x**2 + y**2 + 0.5*x**4"]),  # Duffing, without friction
        (
            {"x": "u", "y": "v", "u": "-x - 2.0*x*y", "v": "-y - x*x + y*y"},  # Hénon and Heiles
            (*WIDE, *WIDE),
            ["0.5*x**2 + 0.5*y**2 + 0.5*u**2 + 0.5*v**2 + x**2*y - 0.3333333333*y**3"],
        ),
        ({"x": "sqrt(x)*y", "y": "-sqrt(x)*x"}, WIDE, ["x**2 + y**2"]),  # half of the box has no rates
        ({"x": "y", "y": "-sin(x**2)"}, WIDE, []),  # of which no angle is linear
        (
            {"x": "u", "y": "v", "u": "-sin(x - 2.0*y) - x", "v": "2.0*sin(x - 2.0*y) - 0.3*y"},
            (*WIDE, *WIDE),
            ["-0.5*x**2 - 0.15*y**2 - 0.5*u**2 - 0.5*v**2 + cos(x - 2*y)"],
        ),
        ({"x": "log(-1.0 - x**2)", "y": "x"}, WIDE, []),  # no rates at all
        ({"x": "y", "y": "-y", "z": "0.0"}, (*WIDE, (-2.0, 2.0)), ["x + y", "z"]),
        ({"x": "y", "y": "-sin(x) - sin(1.1*x)"}, WIDE, ["-0.5*y**2 + cos(x) + 0.9090909091*cos(1.1*x)"]),
        ({"x": "y", "y": "-sin(x) - 2.0*cos(x)"}, WIDE, ["0.25*y**2 - 0.5*cos(x) + sin(x)"]),
        ({"x": "y", "y": "-x - 1e-7*x**3"}, WIDE, ["x**2 + y**2 + 5e-08*x**4"]),  # in all digits
    ],
)
def test_laws_of_the_literature_are_hinted_as_they_are_written(equations: Any, sides: Any, laws: list[str]) -> None:
    assert [quantity.text for quantity in conserved_quantities(flow(**equations), box(*sides))] == laws


@pytest.mark.parametrize(("side", "of_y"), [((0.1, 2.0), [-1.0]), ((-2.0, -0.1), [1.0]), ((-2.0, 2.0), [])])
def test_a_law_holds_on_the_measured_side_of_zero(side: tuple[float, float], of_y: list[float]) -> None:
    """The force is the size of x, so that x**2 - y**2 is constant above 0 and x**2 + y**2 below."""
    quantities = conserved_quantities(flow(x="y", y="sqrt(x**2)"), box(side, (-2.0, 2.0)))
    terms = [{name: value for value, name in quantity.terms} for quantity in quantities]
    assert [term.keys() for term in terms] == [{"x**2", "y**2"}] * len(of_y)
    assert [term["y**2"] / term["x**2"] for term in terms] == pytest.approx(of_y)


def test_volumes_are_kept_where_the_divergence_vanishes_everywhere() -> None:
    assert is_volume_preserving(flow(x="2.0*y*z", y="-3.0*x*z", z="x*y"), box(*WIDE, (-2.0, 2.0)))
    assert is_volume_preserving(flow(x="x*y + 0.3*x", y="-0.5*y**2 - 0.3*y"), box(*WIDE))
    assert is_volume_preserving(flow(x="y", y="sqrt(x)"), box(*WIDE))
    partly = flow(x="sqrt(x)*y", y="-0.25*y**2/sqrt(x)", z="1.0")  # known where x is above 0
    assert is_volume_preserving(partly, box(*WIDE, (-2.0, 2.0)))
    assert is_volume_preserving(flow(x="0.1*x*y + 0.2*x*y", y="-0.15*y**2"), box(*WIDE))  # up to rounding
    assert not is_volume_preserving(flow(x="1.000000001*x", y="-y"), box(*WIDE))
    assert not is_volume_preserving(flow(x="sqrt(x**2) - x", y="1.0"), box(*WIDE))  # in one half of the box
    assert not is_volume_preserving(flow(x="1e-8*x", y="x"), box(*WIDE))
    assert not is_volume_preserving(flow(x="sqrt(-1.0 - x**2)", y="x"), box(*WIDE))  # without any divergence


@pytest.mark.parametrize("rate", ["-x + sin(u)", "-x*cos(u)", "-x*cos(u) - sin(u + 1.0)"])
def test_sines_of_inputs_are_of_no_angle_of_the_states(rate: str) -> None:
    """Their slopes are all 0, which had no first one: an analysis of each such model ended with IndexError."""
    driven = Flow.of(VectorField.of({"x": "y", "y": rate}, ("u",)), np.array([0.5]))
    (energy,) = conserved_quantities(driven, box(*WIDE))
    assert {name for _, name in energy.terms} <= {"x", "x**2", "y**2"}
