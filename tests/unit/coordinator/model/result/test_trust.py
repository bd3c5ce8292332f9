"""What a result says of noise, alternatives, verdicts and simulations: plain numbers, bounded, null for the unknown."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from atoll_coordinator.data.recording import Preparation, Recording, Smoothing, Source
from atoll_coordinator.model.inference.verdict import Verdict
from atoll_coordinator.model.refinement import Alternative, Correlation, Covariance, Refined, Simulated, Simulation
from atoll_coordinator.model.result import trust
from atoll_coordinator.model.result.trust import MOST_POINTS
from atoll_core.data.dataset import Dataset, Target
from atoll_core.expression.text.parsing import from_infix
from tests.unit.coordinator.model.result.plain import plainly

candidates = plainly(trust.candidates)
correlations = plainly(trust.correlations)
covariance = plainly(trust.covariance)
simulation = plainly(trust.simulation)

VALUES = np.linspace(-1.0, 1.0, 20)
TARGET = Target("x", "dx/dt", VALUES, 1e-9, 0.6)
DATASET = Dataset(("x",), VALUES[np.newaxis], (TARGET,), {"x": "x"})
RECORDING = Recording(
    states=("x",),
    state_symbols=("x",),
    velocity_symbols=(),
    inputs=(),
    input_symbols=(),
    order=1,
    offset=100.0,
    smoothing=(Smoothing("x", "loess", 0.1, 0.05, 21, 3, uncertain_rows=4, outliers=1),),
    trajectories=(),
)
PREPARATION = Preparation(DATASET, RECORDING)


def simulated(rows: int, **changes: object) -> Simulated:
    times = np.linspace(-5.0, 5.0, rows)
    values = np.sin(times)[np.newaxis]
    return replace(Simulated("1", False, times, values + 0.5, values, 0.1 * np.ones_like(values), (0.99,)), **changes)


def test_a_curve_is_at_the_times_of_the_file_with_its_band() -> None:
    summary = simulation(Simulation(("x",), (simulated(5, held_out=True),), 2.5), PREPARATION)
    assert summary is not None
    (curve,) = summary["trajectories"]
    assert curve["times"] == [95.0, 97.5, 100.0, 102.5, 105.0]
    assert curve["held_out"] is True
    assert curve["r2"] == {"x": 0.99}
    assert curve["values"]["x"] == pytest.approx(np.sin(np.linspace(-5, 5, 5)), rel=1e-6)
    assert curve["measured"]["x"] == pytest.approx(0.5 + np.sin(np.linspace(-5, 5, 5)), rel=1e-6)
    widths = np.subtract(curve["upper"]["x"], curve["lower"]["x"])
    assert widths == pytest.approx(0.2 * 2.5 * np.ones(5), rel=1e-4)


def test_an_initial_state_names_velocities_behind_the_states() -> None:
    source = Source("0" * 64, ("a.csv",), 5, {}, "t", ("x",), ("x_dot",), (), None, 2)
    curve = simulated(5, start=np.array([1.0, 2.0]))
    summary = simulation(Simulation(("x",), (curve,), 2.0), replace(PREPARATION, source=source))
    assert summary is not None
    assert summary["trajectories"][0]["start"] == {"x": 1.0, "x_dot": 2.0}


def test_the_covariance_names_its_constants_and_has_no_infinite_number() -> None:
    estimated = Covariance((("x", 0), ("x", None)), np.array([[1.0, math.nan], [math.nan, math.inf]]), 7.0)
    assert covariance(estimated) == {
        "constants": [{"variable": "x", "constant": 0}, {"variable": "x", "constant": None}],
        "matrix": [[1.0, None], [None, None]],
        "freedom": 7.0,
    }
    assert covariance(None) is None


@pytest.mark.parametrize(("count", "points"), [(1, MOST_POINTS), (1000, 20)])
def test_long_curves_are_thinned_from_end_to_end(count: int, points: int) -> None:
    summary = simulation(Simulation(("x",), (simulated(5001),) * count, 2.0), PREPARATION)
    assert summary is not None
    times = summary["trajectories"][0]["times"]
    assert len(times) == points
    assert (times[0], times[-1]) == (95.0, 105.0)
    assert np.diff(times) == pytest.approx(10.0 / (points - 1), rel=0.05)


def test_a_simulation_that_ends_early_and_numbers_that_are_not_finite_are_null() -> None:
    wild = np.array([[1.0, math.inf, math.nan]])
    parts = (
        simulated(3, values=None, errors=None, r2=(None,)),
        simulated(3, values=wild, errors=None, r2=(math.nan,)),
    )
    summary = simulation(Simulation(("x",), parts, 2.0), PREPARATION)
    assert summary is not None
    assert json.loads(json.dumps(summary, allow_nan=False)) == summary
    first, second = summary["trajectories"]
    assert (first["values"], first["lower"], first["r2"]) == (None, None, {"x": None})
    assert second["values"] == {"x": [1.0, None, None]}
    assert second["upper"] is None
    assert simulation(None, PREPARATION) is None


def test_contenders_stand_in_the_order_of_their_length() -> None:
    texts = {"3*x": 2.0, "x": 0.0, "x*x": 7.0}
    made = [Alternative(from_infix(text, ("x",)), nats, 0.9, is_shown=text == "x") for text, nats in texts.items()]
    summary = candidates(made, DATASET)
    assert [(candidate["expression"], candidate["nats"], candidate["selected"]) for candidate in summary] == [
        ("x", 0.0, True),
        ("3.0*x", 2.0, False),
        ("x**2", 7.0, False),
    ]
    assert summary[0]["held_out_r2"] is None


def test_correlations_name_constants() -> None:
    (correlated,) = correlations([Correlation(("x", 0), ("y", 2), -0.98)])
    assert correlated["second"] == {"variable": "y", "constant": 2}
    assert correlated["value"] == -0.98


def verdict_on(shown: Refined | None, state: str = "done", why: str = "target", *, has_trajectories: bool = False):
    problem = DATASET.problem("x")
    return trust.verdict(shown, problem, state, has_trajectories=has_trajectories, why=why)


def test_a_verdict_is_given_when_the_job_has_ended() -> None:
    shown = Refined(0, from_infix("x", ("x",)), 1e-12, 1e-24)
    assert verdict_on(shown, "running") is None
    assert verdict_on(shown).grade == "exact"
    worse = replace(shown, program=from_infix("2.0*x", ("x",)), error=0.4, mse=0.3)
    assert verdict_on(worse, "cancelled").grade == "doubtful"
    assert verdict_on(None) == Verdict("no model", "The search has found no equation.", ())
    unsimulated = verdict_on(shown, has_trajectories=True)
    assert unsimulated.grade == "doubtful"
    assert "not simulated" in unsimulated.reason
    judged = replace(shown, grade="good", reason="Because.")
    assert verdict_on(judged, has_trajectories=True) == Verdict("good", "Because.", ())


@pytest.mark.parametrize(("why", "said"), [("max-time", "limit of time"), ("cancelled", "was cancelled")])
def test_a_search_that_was_stopped_leaves_no_good_equation(why: str, said: str) -> None:
    judged = Refined(0, from_infix("x", ("x",)), 1e-3, 1e-6, grade="good", reason="Because.")
    verdict = verdict_on(judged, why=why, has_trajectories=True)
    assert verdict.grade == "doubtful"
    assert said in verdict.reason
    assert verdict.checks[-1].outcome == "not made"
    exact = verdict_on(replace(judged, grade="exact"), why=why, has_trajectories=True)
    assert exact.grade == "exact"


@pytest.mark.parametrize(("state", "why"), [("done", "max-time"), ("cancelled", "cancelled"), ("cancelled", "target")])
def test_the_check_of_time_does_not_pass_where_an_equation_that_nobody_refined_was_stopped(
    state: str, why: str
) -> None:
    """Neither a target nor an equation that was to be simulated."""
    shown = Refined(0, from_infix("x", ("x",)), 1e-12, 1e-24)
    for has_trajectories in (False, True):
        verdict = verdict_on(shown, state, why, has_trajectories=has_trajectories)
        assert verdict.grade == "doubtful"
        time = next(check for check in verdict.checks if check.name == "time")
        assert time.outcome == "not made"
        assert ("--max-time" in time.reason, "was cancelled" in time.reason) == (state == "done", state == "cancelled")
