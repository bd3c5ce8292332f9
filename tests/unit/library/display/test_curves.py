"""Curves in pictures are those of the model between rows, as finely as they bend, and say how many pieces they have."""

from typing import Any

import numpy as np
import pytest

from atoll.api.model import Model
from atoll.display.curves import MOST_POINTS, TOLERANCE, ModelCurves, bends, curves_of
from atoll.model.arguments import values_of_curve
from atoll_coordinator.result.listed_trajectories import Simulated
from tests.unit.library.model.results import result

TIMES = np.linspace(0.0, 4.0 * np.pi, 13)


def circle(phases: Any = 0.0, **changes: Any) -> Simulated:
    """Return a trajectory of a rotation by the angle of its times and `phases`."""
    values = {"x": np.cos(TIMES + phases).tolist(), "y": np.sin(TIMES + phases).tolist()}
    start = {name: curve[0] for name, curve in values.items()}
    return Simulated.model_validate({"name": "1", "times": TIMES.tolist(), "values": values, "start": start, **changes})


def between(curves: ModelCurves, times: Any) -> Any:
    """Return what straight lines between the points of x are at `times`."""
    return np.interp(times, values_of_curve(curves.times), values_of_curve(curves.values["x"]))


def test_a_curve_follows_the_model_between_thirteen_rows() -> None:
    curves = curves_of(Model(result({"x": "-y", "y": "x"})), circle())
    fine = np.linspace(0.0, 4.0 * np.pi, 5_000)
    assert np.abs(between(curves, fine) - np.cos(fine)).max() < 4.0 * TOLERANCE
    assert len(curves.times) < 500
    assert curves.pieces == 1


def test_a_simulation_in_pieces_is_drawn_in_pieces() -> None:
    curves = curves_of(Model(result({"x": "-y", "y": "x"})), circle(np.where(TIMES > 5.0, 0.4, 0.0)))
    x = values_of_curve(curves.values["x"])
    assert (curves.pieces, np.isnan(x).sum()) == (2, 1)
    first = np.isfinite(x) & (np.arange(len(x)) < np.flatnonzero(np.isnan(x))[0])
    fine = np.linspace(0.0, TIMES[3], 500)
    drawn = np.interp(fine, values_of_curve(curves.times)[first], x[first])
    assert np.abs(drawn - np.cos(fine)).max() < 0.01


def test_a_band_is_as_wide_at_rows_as_in_the_result() -> None:
    part = circle()
    half = 0.1 + 0.01 * TIMES
    bounds = {
        name: {"x": (np.cos(TIMES) + side * half).tolist(), "y": (np.sin(TIMES) + side * half).tolist()}
        for name, side in (("lower", -1.0), ("upper", 1.0))
    }
    curves = curves_of(Model(result({"x": "-y", "y": "x"})), Simulated.model_validate(part.model_dump() | bounds))
    assert curves.lower is not None
    assert curves.upper is not None
    wide = values_of_curve(curves.upper["x"]) - values_of_curve(curves.lower["x"])
    assert wide == pytest.approx(2.0 * (0.1 + 0.01 * values_of_curve(curves.times)), rel=1e-6)


def test_a_held_input_bends_a_curve_where_it_changes() -> None:
    times = [0.0, 1.0, 2.0]
    levels = [1.0, 0.0, 0.0]
    end = 1.0 - np.exp(-1.0)
    part = {"name": "1", "times": times, "start": {"x": 0.0}, "values": {"x": [0.0, end, end * np.exp(-1.0)]}}
    contents = result({"x": "u-x"}, ("u",))
    contents["system"] |= {"inputs": ["u"], "input_kinds": {"u": "held"}}
    contents["data"] |= {"trajectories": [{"name": "1", "times": times, "inputs": {"u": levels}}]}
    curves = curves_of(Model(contents), Simulated.model_validate(part))
    fine = np.linspace(0.0, 1.0, 200)
    assert np.abs(between(curves, fine) - (1.0 - np.exp(-fine))).max() < 4.0 * TOLERANCE
    assert curves.pieces == 1


def test_without_a_model_the_rows_of_the_result_are_what_there_is() -> None:
    part = circle()
    assert curves_of(None, part) == ModelCurves(part.times, part.values or {}, None, None, None)
    no_input = curves_of(Model(result({"x": "u-y", "y": "x"}, ("u",))), part)
    assert no_input.times == part.times


def test_points_are_where_a_curve_bends_and_bounded() -> None:
    times = np.linspace(0.0, 1.0, 1_001)
    line = np.abs(times - 0.5)[None]
    assert bends(line, times).tolist() == [0, 500, 1_000]
    many = np.linspace(0.0, 1.0, 40_001)
    assert len(bends(np.sin(4_000.0 * many)[None], many)) <= MOST_POINTS
