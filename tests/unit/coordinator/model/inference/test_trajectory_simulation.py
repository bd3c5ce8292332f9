"""Simulations as results list them: at the times of the file, with bands, thinned, null for what is not finite."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from atoll_coordinator.data.recording import Preparation, Recording, Smoothing, Source, Trajectory
from atoll_coordinator.model.constants.standard_errors import joint_covariance
from atoll_coordinator.model.inference.trajectory_simulation import SimulatedTrajectory, listed_simulation
from atoll_coordinator.result.findings import Place
from atoll_core.data.dataset import Dataset, Target

VALUES = np.linspace(-1.0, 1.0, 20)
DATASET = Dataset(("x",), VALUES[np.newaxis], (Target("x", "dx/dt", VALUES, 1e-9, 0.6),), {"x": "x"})
NOTHING = np.zeros((0, 20))
MEASURED = Trajectory("1", VALUES, VALUES[None], VALUES[None], VALUES[None], NOTHING, NOTHING)
SMOOTHING = Smoothing("x", "loess", 0.1, 0.05, 21, 3)
PREPARATION = Preparation(DATASET, Recording(("x",), ("x",), (), (), (), 1, 100.0, (SMOOTHING,), (MEASURED,)))


def simulated(rows: int, **changes: object) -> SimulatedTrajectory:
    times = np.linspace(-5.0, 5.0, rows)
    values = np.sin(times)[np.newaxis]
    errors = 0.1 * np.ones_like(values)
    return replace(SimulatedTrajectory("1", False, times, values + 0.5, values, errors, (0.99,)), **changes)


def listed(*parts: SimulatedTrajectory, quantile: float = 2.0, preparation: Preparation = PREPARATION):
    return listed_simulation(parts, ("x",), quantile, preparation).model_dump(mode="json")["trajectories"]


def test_a_curve_is_at_the_times_of_the_file_with_its_band() -> None:
    (curve,) = listed(simulated(5, held_out=True), quantile=2.5)
    assert curve["times"] == [95.0, 97.5, 100.0, 102.5, 105.0]
    assert curve["held_out"] is True
    assert curve["r2"] == {"x": 0.99}
    assert curve["values"]["x"] == pytest.approx(np.sin(np.linspace(-5, 5, 5)), rel=1e-6)
    assert curve["measured"]["x"] == pytest.approx(0.5 + np.sin(np.linspace(-5, 5, 5)), rel=1e-6)
    widths = np.subtract(curve["upper"]["x"], curve["lower"]["x"])
    assert widths == pytest.approx(0.2 * 2.5 * np.ones(5), rel=1e-4)


def test_where_a_solver_erred_the_measurements_are_listed_as_they_were() -> None:
    unused = np.where(np.arange(20) == 3, np.nan, 7.0)[None]
    (curve,) = listed(simulated(20, measured=unused))
    assert curve["measured"]["x"][3] is None
    assert curve["measured"]["x"][4:] == pytest.approx(VALUES[4:], rel=1e-6)


def test_an_initial_state_names_velocities_behind_the_states() -> None:
    source = Source("0" * 64, ("a.csv",), 5, {}, "t", ("x",), ("x_dot",), (), None, 2)
    (curve,) = listed(simulated(5, start=np.array([1.0, 2.0])), preparation=replace(PREPARATION, source=source))
    assert curve["start"] == {"x": 1.0, "x_dot": 2.0}


def test_the_covariance_names_its_constants_and_has_no_infinite_number() -> None:
    places = [Place(variable="x", constant=0), Place(variable="x")]
    estimated = joint_covariance(places, np.array([[1.0, math.nan], [math.nan, math.inf]]), 7.0)
    assert estimated is not None
    assert estimated.matrix == ((1.0, None), (None, None))
    assert joint_covariance([], np.zeros((0, 0)), 7.0) is None


@pytest.mark.parametrize(("count", "points"), [(1, 200), (1000, 20)])
def test_long_curves_are_thinned_from_end_to_end(count: int, points: int) -> None:
    times = listed(*(simulated(5001),) * count)[0]["times"]
    assert len(times) == points
    assert (times[0], times[-1]) == (95.0, 105.0)
    assert np.diff(times) == pytest.approx(10.0 / (points - 1), rel=0.05)


def test_a_simulation_that_ends_early_and_numbers_that_are_not_finite_are_null() -> None:
    wild = np.array([[1.0, math.inf, math.nan]])
    first, second = listed(
        simulated(3, values=None, errors=None, r2=(None,)), simulated(3, values=wild, errors=None, r2=(math.nan,))
    )
    json.dumps([first, second], allow_nan=False)
    assert (first["values"], first["lower"], first["r2"]) == (None, None, {"x": None})
    assert second["values"] == {"x": [1.0, None, None]}
    assert second["upper"] is None
