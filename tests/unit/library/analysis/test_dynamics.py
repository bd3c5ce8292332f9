"""The model compared with the data: periods, phases, and trajectories of equations of second order."""

import numpy as np
import pytest

from atoll.analysis.dynamics import MeasuredTrajectory, compare, measured_trajectories, motion
from atoll.api.model import Model
from atoll.model.vector_field import VectorField
from atoll_coordinator.result.result import Result
from tests.unit.library.analysis.systems import box, flow
from tests.unit.library.model.results import result

TIMES = np.linspace(0.0, 20.0, 401)


def test_a_wave_has_period_amplitudes_and_phases() -> None:
    waves = np.array([np.sin(2.0 * TIMES), 3.0 * np.sin(2.0 * TIMES - 0.5 * np.pi)]).T
    described = motion(TIMES, waves)
    assert described.period == pytest.approx(np.pi, rel=1e-3)
    np.testing.assert_allclose(described.amplitudes, [1.0, 3.0], rtol=1e-2)
    assert described.phases is not None
    np.testing.assert_allclose(described.phases, [0.0, 0.25], atol=1e-2)


def test_a_decay_has_no_period() -> None:
    assert motion(TIMES, np.exp(-TIMES)[:, None]).period is None


def test_velocities_are_differences_and_begin_as_fitted() -> None:
    angle = {
        "name": "1",
        "times": TIMES.tolist(),
        "values": {"a": np.cos(TIMES).tolist()},
        "start": {"a": 1.0, "a_dot": 7.0},
    }
    described = {
        "schema": 1,
        "symbols": {"a": "a", "a_dot": "a_dot"},
        "equations": [{"variable": "a", "lhs": "d2a/dt2", "expression": "-a"}],
        "simulation": {"trajectories": [angle]},
    }
    (measured,) = measured_trajectories(Result.of(described), VectorField.from_result(Result.of(described)))
    np.testing.assert_allclose(measured.states[1:-1, 1], -np.sin(TIMES)[1:-1], atol=1e-3)
    assert measured.states[0].tolist() == [1.0, 7.0]


@pytest.mark.slow
def test_driven_models_are_compared_along_the_recorded_inputs_or_not_at_all() -> None:
    """x' = u - x with u = 2 sin(t) from the wave's beginning: x = sin(t) - cos(t)."""
    contents = result({"x": "u - x"}, ("u",))
    times = 5.0 + TIMES
    x = {"x": (np.sin(TIMES) - np.cos(TIMES)).tolist()}
    contents["simulation"] = {
        "trajectories": [{"name": "1", "times": times.tolist(), "values": x, "start": {"x": -1.0}}]
    }
    unknown = Model(contents).analyse()
    assert unknown.comparisons == ()
    assert "not compared with trajectory 1" in str(unknown)
    recorded = {"name": "1", "times": times.tolist(), "measured": x, "inputs": {"u": (2.0 * np.sin(TIMES)).tolist()}}
    contents["data"]["trajectories"] = [recorded]
    known = Model(contents).analyse()
    (comparison,) = known.comparisons
    assert comparison.has_same_period
    assert comparison.has_same_amplitudes
    assert comparison.simulated.period == pytest.approx(2.0 * np.pi, rel=1e-2)
    assert known.as_dict()["not_compared"] == []


@pytest.mark.slow
def test_of_closed_orbits_the_period_is_said_also_where_the_data_are_too_short() -> None:
    """A pendulum of amplitude 1 has the period 4 K(sin(1/2)) = 6.6998."""
    contents = result({"x": "y", "y": "-sin(x)"})
    times = np.linspace(0.0, 8.0, 41)
    values = {"x": np.cos(times).tolist(), "y": (-np.sin(times)).tolist()}
    course = {"name": "1", "times": times.tolist(), "values": values, "start": {"x": 1.0, "y": 0.0}}
    contents["simulation"] = {"trajectories": [course]}
    known = Model(contents).analyse()
    (comparison,) = known.comparisons
    assert comparison.measured.period is None
    assert comparison.orbit_period == pytest.approx(6.6998, rel=1e-3)
    assert "follows a closed orbit of period 6.7" in str(known)
    assert known.as_dict()["dynamics"][0]["orbit_period"] == comparison.orbit_period


def test_amplitudes_are_compared_over_the_measured_times() -> None:
    """Of a decay measured at times that grow tenfold, the second half has but its last row."""
    times = np.array([0.0, 0.01, 0.1, 0.3, 0.6, 1.0, 4.0])
    decay = flow(x="-x")
    measured = MeasuredTrajectory("1", times, np.exp(-times)[:, None])
    (comparison,) = compare(decay, box((0.0, 1.0)), (), [measured], 10.0, has_family=False)
    assert comparison.has_same_amplitudes
    assert comparison.end is not None
