"""Forecasts of systems with a state that no column measures: what is given, and how a result is judged."""

import numpy as np
import pytest

from atoll_core.errors import UsageError
from benchmarks.templates.forecasts import ForecastKey, case_of, judge, request_of

KEY = ForecastKey("damped oscillator", 0, 1)


def result_of(case, equations, states):
    """Return a result whose simulation ends with these states at the last given row."""
    listed = {"times": [float(case.times[case.given - 1])], "values": {name: [value] for name, value in states.items()}}
    parts = [{"variable": name, "expression": text, "verdict": "good"} for name, text in equations.items()]
    return {"equations": parts, "simulation": {"trajectories": [listed]}}


def state_at(case):
    """Return position and velocity at the last given row, from the known solution."""
    time, rate = case.times[case.given - 1], np.sqrt(4.0 - 0.15**2)
    decay = np.exp(-0.15 * time)
    x = decay * (np.cos(rate * time) + 0.15 / rate * np.sin(rate * time))
    return {"x": float(x), "h": float(-decay * 4.0 / rate * np.sin(rate * time))}


def test_only_the_first_rows_and_one_column_are_given():
    case = case_of(KEY, None)
    table, config = request_of(KEY, case)
    assert table.names == ("t", "x")
    assert table.rows == case.given == 225
    assert config.data.hidden_count == 1


def test_the_true_law_forecasts_the_end_and_another_law_does_not():
    case = case_of(KEY, None)
    right = judge(KEY, case, result_of(case, {"x": "h", "h": "-4*x - 0.3*h"}, state_at(case)), 1.0)
    assert right.r2 == pytest.approx(1.0, abs=1e-5)
    wrong = judge(KEY, case, result_of(case, {"x": "h", "h": "-5*x - 0.3*h"}, state_at(case)), 1.0)
    assert wrong.r2 < 0.9


def test_a_law_that_runs_away_has_no_forecast():
    case = case_of(KEY, None)
    assert judge(KEY, case, result_of(case, {"x": "x*x*x", "h": "h"}, {"x": 9.0, "h": 0.0}), 1.0).r2 is None
    assert judge(KEY, case, {}, 1.0, "failed").r2 is None


def test_the_tanks_need_their_file():
    with pytest.raises(UsageError, match="--data"):
        case_of(ForecastKey("--hidden 1", 0, 1), None)
