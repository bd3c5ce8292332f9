"""Simulations as results list them: at the times of the file, with bands, thinned, null for what is not finite."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from atoll_coordinator.data.recording import Preparation, Source
from atoll_coordinator.model.constants.standard_errors import joint_covariance
from atoll_coordinator.model.inference.trajectory_simulation import list_trajectories
from atoll_coordinator.model.shooting.measurements import measurements_of
from atoll_coordinator.result.findings import Place
from atoll_core.data.dataset import Dataset, Target
from tests.unit.coordinator.model.shooting.made import DECAY, compare, recording

TIMES = np.linspace(-5.0, 5.0, 20)
STARTS = ([2.0], [1.0], [-1.5])


def listed(fit=True, *, errors=0.1, times=TIMES, simulated=None, unused=None, piece=10, source=None):
    """Return three simulated trajectories of a decay as a result lists them."""
    made = replace(recording(DECAY, STARTS, times, 0.01), offset=100.0)
    measured = np.concatenate([part.measured[0] for part in made.trajectories])
    rows = measurements_of(made, [0], piece=piece)
    dataset = Dataset(("x",), measured[None], (Target("x", "dx/dt", measured, 1e-9, 0.6),), {"x": "x"})
    found = compare(DECAY, rows, 1e-6).fit_model([DECAY.parsed("-0.5*x")]).fit if fit else None
    if simulated is not None:
        found = replace(found, simulated=simulated(found.simulated))
    if unused is not None:
        rows.weights[0, unused] = 0.0
        rows.measured[0] += 7.0
    spread = None if errors is None else np.full(rows.measured.shape, errors)
    parts = list_trajectories(rows, found, spread, ("x",), Preparation(dataset, made, source=source), 2.5)
    return [part.model_dump(mode="json") for part in parts], measured, found


def test_a_curve_is_at_the_times_of_the_file_with_its_band():
    """Also where it was simulated in pieces."""
    curves, measured, fit = listed()
    assert [curve["name"] for curve in curves] == ["1", "2", "3"]
    assert curves[0]["times"] == pytest.approx(100.0 + TIMES)
    assert all(0.5 < curve["r2"]["x"] < 1.0 for curve in curves)
    for name, values in (("values", fit.simulated[0]), ("measured", measured)):
        assert np.concatenate([curve[name]["x"] for curve in curves]) == pytest.approx(values, rel=1e-6)
    widths = np.subtract(curves[1]["upper"]["x"], curves[1]["lower"]["x"])
    assert widths == pytest.approx(0.2 * 2.5 * np.ones(20), rel=1e-4)
    assert listed(errors=None)[0][0]["upper"] is None


def test_where_a_solver_erred_the_measurements_are_listed_as_they_were():
    """What was subtracted is in the measurements of the model alone."""
    (curve, *_), measured, _ = listed(unused=3)
    assert curve["measured"]["x"][3] is None
    assert curve["measured"]["x"][4:] == pytest.approx(measured[4:20], rel=1e-6)


def test_an_initial_state_names_velocities_behind_the_states():
    source = Source("0" * 64, ("a.csv",), 5, {}, "t", ("x",), ("x_dot",), (), None, 2)
    (curve, *_), _, fit = listed(source=source, simulated=lambda values: np.concatenate([values, values + 1.0]))
    assert curve["start"] == pytest.approx({"x": fit.simulated[0, 0], "x_dot": fit.simulated[1, 0]})


def test_long_curves_are_thinned_from_end_to_end():
    times = listed(times=np.linspace(-5.0, 5.0, 1001), piece=2000)[0][0]["times"]
    assert len(times) == 200
    assert (times[0], times[-1]) == (95.0, 105.0)
    assert np.diff(times) == pytest.approx(10.0 / 199, rel=0.2)


def test_a_simulation_that_fails_and_numbers_that_are_not_finite_are_null():
    (failed, *_), _, _ = listed(fit=False)
    wild = listed(simulated=lambda values: np.where(np.arange(60) == 1, math.inf, values))[0][0]
    json.dumps([failed, wild], allow_nan=False)
    assert (failed["values"], failed["lower"], failed["start"], failed["r2"]) == (None, None, None, {"x": None})
    assert wild["values"]["x"][1] is None
    assert wild["values"]["x"][2] is not None


def test_the_covariance_names_its_constants_and_has_no_infinite_number() -> None:
    places = [Place(variable="x", constant=0), Place(variable="x")]
    estimated = joint_covariance(places, np.array([[1.0, math.nan], [math.nan, math.inf]]), 7.0)
    assert estimated is not None
    assert estimated.matrix == ((1.0, None), (None, None))
    assert joint_covariance([], np.zeros((0, 0)), 7.0) is None
