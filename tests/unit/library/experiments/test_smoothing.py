"""States along trajectories under a law: known posteriors, pieces, other data."""

import csv
import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from atoll.api.model import Model
from atoll.experiments.smoothing import smooth
from atoll_coordinator.result.result import Result
from atoll_core.errors import UsageError
from tests.unit.library.experiments.made import measured
from tests.unit.library.experiments.test_comparison import swinging
from tests.unit.library.model.results import process_result, result

EXAMPLE = Path(__file__).parents[4] / "examples" / "lynx_hare.csv"
TIMES = np.linspace(0.0, 4.0, 40)
NOISE = 0.1 * np.random.default_rng(5).standard_normal(40)
LINE = 1.0 + 0.5 * TIMES + NOISE


def line(**changes: Any) -> Result:
    """dx/dt = c: the states are a straight line, whose posterior is known."""
    return Result.of(measured({"x": "0.5"}, [(TIMES, {"x": LINE})], 0.1, **changes))


def posterior_of_line(times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the line of least squares at `times`, and its standard errors."""
    design = np.stack([np.ones(40), TIMES], axis=1)
    inverse = np.linalg.inv(design.T @ design)
    fitted = inverse @ design.T @ LINE
    variance = ((LINE - design @ fitted) ** 2).sum() / 38
    rows = np.stack([np.ones(len(times)), times], axis=1)
    return rows @ fitted, np.sqrt(variance * ((rows @ inverse) * rows).sum(axis=1))


def test_states_of_a_linear_law_have_their_known_posterior() -> None:
    (part,) = smooth(line()).trajectories
    values, errors = posterior_of_line(TIMES)
    assert part.x[:, 0] == pytest.approx(values, abs=1e-5)
    assert part.stderr[:, 0] == pytest.approx(errors, rel=0.01)
    assert (part.upper - part.x)[:, 0] == pytest.approx(2.024 * errors, rel=0.01)  # Student's t, 38 degrees
    assert part.joins == ()
    assert part.is_like_noise


def test_a_trajectory_that_the_law_does_not_describe_is_divided_and_the_times_are_named() -> None:
    x = 2.0 * np.sin(3.0 * TIMES) + 0.01 * NOISE
    smoothed = smooth(Result.of(measured({"x": "0.5*x"}, [(TIMES, {"x": x})], 0.001)))
    (part,) = smoothed.trajectories
    assert len(part.joins) >= 1
    assert set(part.joins) <= set(part.t.tolist())
    assert part.piece.max() == len(part.joins) + 1
    assert f"{len(part.joins) + 1} pieces, which join at {part.joins[0]:.6g}" in str(smoothed)


def test_new_trajectories_take_the_constants_of_the_result() -> None:
    """A trajectory that is far above the first one has the same slope, however few rows it has."""
    t = np.linspace(0.0, 2.0, 12)
    smoothed = Model(line()).smooth({"t": t, "x": 70.0 + 0.5 * t})
    (part,) = smoothed.trajectories
    slope = posterior_of_line(np.array([0.0, 1.0]))[0]
    assert np.diff(part.x[:, 0]) == pytest.approx(np.diff(t) * (slope[1] - slope[0]), rel=1e-4)
    assert part.x[:, 0].mean() == pytest.approx(70.5, abs=0.01)


def test_every_trajectory_is_smoothed_held_out_ones_too() -> None:
    contents = measured({"x": "0.5"}, [(TIMES, {"x": LINE}), (TIMES, {"x": LINE + 3.0})], 0.1)
    contents["data"]["trajectories"][1]["held_out"] = True
    smoothed = smooth(Result.of(contents))
    assert [part.name for part in smoothed.trajectories] == ["1", "2"]
    assert (smoothed["2"].x - smoothed["1"].x)[:, 0] == pytest.approx(3.0, abs=1e-4)


def test_a_state_with_an_offset_includes_it() -> None:
    x = 2.0 * np.exp(-TIMES) + 1.0
    contents = measured({"x": "-1.0*x"}, [(TIMES, {"x": x + 0.1 * NOISE})], 0.01, config={"data": {"offsets": ["x"]}})
    (part,) = smooth(Result.of(contents)).trajectories
    assert part.x[:, 0] == pytest.approx(x, abs=0.02)


def test_a_law_that_blows_up_from_the_measured_first_state_is_smoothed() -> None:
    """The first measured value of lynx is below the value 4.268, below which they fall without bound."""
    year, hare, lynx = np.loadtxt(EXAMPLE, delimiter=",", skiprows=1).T
    law = {"hare": "0.02564*hare*(19.71-lynx)", "lynx": "0.03534*(hare-33.47)*(lynx-4.268)"}
    start = {"trajectories": [{"name": "1", "start": {"hare": 35.45, "lynx": 6.3}}]}
    contents = measured(law, [(year, {"hare": hare, "lynx": lynx})], 5.0, simulation=start)
    (part,) = smooth(Result.of(contents)).trajectories
    assert part.x[:, 0] == pytest.approx(hare, abs=20.0)
    assert part.x[0, 1] > 4.0


def test_velocities_of_laws_of_second_order_are_states_without_measured_values() -> None:
    smoothed = smooth(swinging(2))
    assert smoothed.states == ("x", "x_dot")
    (part,) = smoothed.trajectories
    assert part.x[:, 1] == pytest.approx(-3.0 * np.sin(3.0 * TIMES), abs=0.05)
    assert (part.stderr > 0.0).all()
    assert "x_dot_lower" in smoothed.columns()
    assert "x_dot_measured" not in smoothed.columns()


def test_tables_have_one_row_for_each_measured_row() -> None:
    smoothed = smooth(line())
    rows = [*csv.DictReader(io.StringIO(smoothed.to_csv()))]
    assert len(rows) == 40
    assert [*rows[0]] == ["trajectory", "t", "piece", "x", "x_stderr", "x_lower", "x_upper", "x_measured"]
    assert float(rows[3]["x_measured"]) == LINE[3]
    listed: Any = smoothed.as_dict()
    assert listed["trajectories"][0]["x"]["x"] == smoothed["1"].x[:, 0].tolist()


@pytest.mark.parametrize(
    ("contents", "sentence"),
    [
        (result({"x": "-x"}), "the result has no measurements"),
        (process_result(), "only models of measured trajectories"),
    ],
)
def test_what_has_no_states_along_trajectories_is_refused(contents: dict[str, Any], sentence: str) -> None:
    with pytest.raises(UsageError, match=sentence):
        smooth(Result.of(contents))
