"""Forecasts with a known part: the job of the drive, and the score of its forecast."""

from pathlib import Path

import numpy as np
import pytest

from atoll_core.errors import UsageError
from benchmarks.templates.forecasts import EMPS, EMPS_WAYS, ForecastKey, case_of, judge, request_of


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A drive with linear friction: q'' = 3 u - 2 q' with u = cos(t), in its stationary motion."""
    t = np.linspace(0.0, 20.0, 400)
    q = -0.6 * np.cos(t) + 1.2 * np.sin(t)
    rows = "".join(f"{a:.17g},{np.cos(a):.17g},{b:.17g}\n" for a, b in zip(t, q, strict=True))
    (tmp_path / EMPS).write_text(f"t,u,q\n{rows}", "utf-8")
    return tmp_path


def test_the_drive_is_searched_without_its_last_quarter_and_with_a_known_part(folder: Path) -> None:
    key = ForecastKey(EMPS_WAYS[1], 0, 1)
    case = case_of(key, folder)
    table, config = request_of(key, case)
    assert (table.rows, len(case.times)) == (300, 400)
    assert config.prior.equations == {"q": "v", "v": "a*u + ?(v)"}
    assert config.data.hidden == ("v",)
    assert config.space.operators == ("+", "-", "*", "/", "abs", "tanh")
    assert request_of(ForecastKey(EMPS_WAYS[0], 0, 1), case)[1].space.operators is None


@pytest.mark.parametrize(("law", "is_right"), [("3*u - 2*v", True), ("3*u - 4*v", False)])
def test_the_forecast_of_the_true_law_is_right(folder: Path, law: str, is_right: bool) -> None:
    key = ForecastKey(EMPS_WAYS[0], 0, 1)
    case = case_of(key, folder)
    at = case.times[case.given - 1]
    values = {"q": [case.measured[case.given - 1]], "v": [0.6 * np.sin(at) + 1.2 * np.cos(at)]}
    equations = [{"variable": "q", "expression": "v", "verdict": "good"}, {"variable": "v", "expression": law}]
    result = {"equations": equations, "simulation": {"trajectories": [{"times": [at], "values": values}]}}
    outcome = judge(key, case, result, 1.0)
    assert outcome.r2 is not None
    assert (outcome.r2 > 0.999) is is_right


def test_the_folder_of_the_drive_must_be_given() -> None:
    with pytest.raises(UsageError, match=f"folder of {EMPS} with --data"):
        case_of(ForecastKey(EMPS_WAYS[0], 0, 1), None)
