"""Simulations end by themselves: at the last time, or with a status that says why not."""

import csv
import io

import numpy as np
import pytest

from atoll.model.simulation import simulate, state_sizes
from atoll.model.vector_field import JointErrors, VectorField
from atoll_core.errors import UsageError

TIMES = np.linspace(0.0, 5.0, 11)


def ending(equation: str, start: float = 1.0, most: int = 5000) -> tuple[str, float]:
    """Return status and last time of dx/dt = equation."""
    simulation = simulate(VectorField.of({"x": equation}), np.array([start]), TIMES, most=most)
    assert len(simulation.t) == len(simulation.x)
    return simulation.status, float(simulation.t[-1])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("equation", "expected"),
    [
        ("-x", ("finished", 5.0)),
        ("-100000.0*(x - 1.0)", ("finished", 5.0)),  # stiff, but implicit steps are long
        ("x**2", ("blow-up", 0.5)),
        ("exp(x)", ("blow-up", 0.0)),
        ("100.0*x", ("blow-up", 3.0)),
        ("-sqrt(x) - 0.1", ("undefined", 1.5)),
        ("1.0/(x - 1.0)", ("undefined", 0.0)),
        ("100000.0*cos(100000.0*x)", ("stiff", 0.0)),
    ],
)
def test_the_status_says_how_it_ended(equation: str, expected: tuple[str, float]) -> None:
    most = 20 if expected[0] == "stiff" else 20_000
    assert ending(equation, most=most) == expected


def test_csv_has_a_column_for_each_state_and_no_bands_without_errors() -> None:
    simulation = simulate(VectorField.of({"x": "y", "y": "-x"}), np.array([0.0, 1.0]), TIMES)
    rows = list(csv.reader(io.StringIO(simulation.to_csv())))
    assert rows[0] == ["t", "x", "y"]
    assert [float(row[1]) for row in rows[1:]] == simulation["x"].tolist()
    assert simulation["x"] == pytest.approx(np.sin(TIMES), abs=1e-7)


def test_one_time_has_a_band_without_width() -> None:
    field = VectorField.of({"x": "3.0*x"})
    errors = JointErrors(field, (0,), np.ones((1, 1)))
    simulation = simulate(field, np.array([2.0]), TIMES[:1], bands=(errors, 2.0))
    assert simulation.status == "finished"
    assert simulation.lower is not None
    assert simulation.lower.tolist() == simulation.x.tolist() == [[2.0]]


@pytest.mark.parametrize(
    ("start", "times"),
    [([np.nan], TIMES), ([1.0, 2.0], TIMES), ([1.0], TIMES[::-1]), ([1.0], np.zeros(2))],
)
def test_what_does_not_fit_is_refused(start: list[float], times: np.ndarray) -> None:
    with pytest.raises(UsageError):
        simulate(VectorField.of({"x": "x"}), np.array(start), times)


def test_each_state_is_followed_with_errors_of_its_own_size() -> None:
    field = VectorField.of({"x": "-0.1*x", "y": "-y"})
    simulation = simulate(field, np.array([300.0, 1e-12]), np.linspace(0.0, 10.0, 11))
    np.testing.assert_allclose(simulation["y"], 1e-12 * np.exp(-simulation.t), rtol=1e-8)


def test_a_state_that_begins_at_0_has_the_size_that_was_measured_or_that_it_comes_to() -> None:
    times = np.linspace(0.0, 10.0, 11)
    rates = {"x": "1e-12*u - x"}
    unknown = simulate(VectorField.of(rates, "u"), np.zeros(1), times, lambda t: np.array([float(t > 5.0)]))
    measured = simulate(VectorField.of(rates, "u", (1e-12,)), np.zeros(1), times, lambda t: np.array([float(t > 5.0)]))
    for simulated in (unknown, measured):
        np.testing.assert_allclose(simulated["x"][6:], 1e-12 * (1.0 - np.exp(5.0 - simulated.t[6:])), rtol=1e-8)


def test_an_early_end_says_how_many_times_were_reached() -> None:
    simulation = simulate(VectorField.of({"x": "x**2"}), np.array([1.0]), TIMES)
    assert simulation.message == "a state grows without bounds near time 1; 2 of 11 times were reached"


PREY = VectorField.of({"x": "x*(1.0 - y)", "y": "y*(x - 1.0)"})


@pytest.mark.slow
@pytest.mark.parametrize(("start", "until"), [(20.0, 60.0), (30.0, 100.0), (60.0, 200.0)])
@pytest.mark.parametrize("unit", [1.0, 2.0**-40])
def test_a_state_that_comes_back_from_a_deep_trough_is_right(start: float, until: float, unit: float) -> None:
    field = VectorField.of({"x": "x*(1.0 - y)", "y": f"y*({1.0 / unit!r}*x - 1.0)"})
    simulation = simulate(field, np.array([start * unit, start]), np.linspace(0.0, until, 9))
    in_logarithms = VectorField.of({"x": "1.0 - exp(y)", "y": "exp(x) - 1.0"})
    expected = simulate(in_logarithms, np.log([start, start]), simulation.t)
    assert (simulation.status, expected.status) == ("finished", "finished")
    np.testing.assert_allclose(np.log(simulation.x / [unit, 1.0]), expected.x, atol=1e-6)


def test_bands_come_back_from_a_deep_trough() -> None:
    errors = JointErrors(PREY, (0,), np.full((1, 1), 1e-20))
    simulation = simulate(PREY, np.array([20.0, 20.0]), np.linspace(0.0, 60.0, 9), bands=(errors, 2.0))
    assert simulation.stderr is not None
    assert (simulation.stderr < 1e-6 * simulation.x).all()


def test_a_state_that_may_cross_zero_or_never_comes_back_is_followed_as_before() -> None:
    times = np.linspace(0.0, 50.0, 11)
    swing = simulate(VectorField.of({"x": "y", "y": "-x"}), np.array([1.0, 0.0]), times)
    assert swing["x"] == pytest.approx(np.cos(times), abs=1e-8)
    stiff = simulate(VectorField.of({"x": "-100000.0*x", "y": "x - y"}), np.array([1.0, 0.0]), times, most=5000)
    assert stiff.status == "finished"
    assert abs(stiff["x"][-1]) < 1e-15


def test_sizes_that_are_followed_have_the_unit_of_each_state() -> None:
    sizes = state_sizes(VectorField.of({"x": "-0.0001*x", "y": "1.3*y"}), np.array([300.0, 1e-12]), TIMES)
    assert sizes.tolist() == [300.0, 1e-12]
    troughs = state_sizes(PREY, np.array([30.0, 30.0]), np.linspace(0.0, 100.0, 3))
    assert (troughs < 1e-20).all()
    assert (troughs > 1e-25).all()
