"""What a result says of the data: columns and source, noise, doubtful rows with reasons, tables of bounded size."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from atoll.text.render import noise_lines
from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.data.reading.files import read_table
from atoll_coordinator.data.recording import ExcludedRow, Recording, StateSmoothing, Trajectory
from atoll_coordinator.model.result import tables
from atoll_coordinator.model.result.tables import MOST_ROWS
from atoll_coordinator.result.findings import Errors
from atoll_coordinator.result.result import Result
from atoll_core.config import DataConfig, JobConfig
from tests.unit.coordinator.model.result.plain import plainly

data, system, noise, smoothing = map(
    plainly, (tables.describe_data, tables.describe_system, tables.describe_noise, tables.describe_smoothing)
)


def trajectory(rows: int, name: str = "1", held_out: bool = False) -> Trajectory:
    times = np.linspace(-5.0, 5.0, rows)
    smoothed = np.stack([np.sin(times), np.cos(times)])
    measured = smoothed.copy()
    measured[0] += 0.1 * (-1.0) ** np.arange(rows)
    none = np.zeros((0, rows))
    return Trajectory(name, times, measured, smoothed, smoothed, none, none, held_out)


def recording(*trajectories: Trajectory, excluded: tuple[ExcludedRow, ...] = (), span: int = 21) -> Recording:
    described_smoothing = StateSmoothing(
        "x", "loess", 0.1, 0.05, span, 3, uncertain_rows=4, outliers=1, excluded_rows=excluded
    )
    exact = StateSmoothing("y", "interpolation", 1e-12, 1e-12)
    return Recording(("x", "y"), ("x", "y"), (), (), (), 1, 100.0, (described_smoothing, exact), trajectories)


def test_noise_is_said_of_each_state() -> None:
    described = noise(recording(trajectory(101)), {})
    assert [*described] == ["x", "y"]
    assert described["x"] == {
        "sd": 0.1,
        "relative": 0.05,
        "method": "loess",
        "span": 21,
        "degree": 3,
        "quantisation": None,
        "residual_rms": pytest.approx(0.1),
        "largest_residual": {"value": pytest.approx(0.1), "trajectory": "1", "time": pytest.approx(95.0, abs=10.0)},
        "doubtful_rows": 4,
        "outliers": 1,
        "doubtful": [],
        "errors": None,
    }
    assert described["y"]["largest_residual"] is None
    assert noise(None, {}) == {}


def test_the_largest_residual_is_found_in_time() -> None:
    one, other = trajectory(101), trajectory(101, "2")
    other.measured[0, 30] = other.smoothed[0, 30] - 0.7
    described = noise(recording(one, other), {})["x"]["largest_residual"]
    assert described == {"value": pytest.approx(-0.7), "trajectory": "2", "time": pytest.approx(98.0)}
    hidden = trajectory(101, "3", held_out=True)
    hidden.measured[0, 0] = 9.0
    assert noise(recording(one, other, hidden), {})["x"]["largest_residual"] == described


def test_a_span_beyond_the_longest_trajectory_is_all_of_it() -> None:
    assert noise(recording(trajectory(60), trajectory(101), span=366), {})["x"]["span"] == 101


def test_doubtful_rows_stand_by_trajectory_and_reason() -> None:
    excluded = (
        ExcludedRow(0, 0, "end"),
        ExcludedRow(0, 1, "end"),
        ExcludedRow(0, 50, "jump"),
        ExcludedRow(1, 100, "end"),
    )
    described = noise(recording(trajectory(101), trajectory(101, "2b"), excluded=excluded), {})["x"]["doubtful"]
    assert described == [
        {"trajectory": "1", "reason": "end", "times": [95.0, 95.1]},
        {"trajectory": "1", "reason": "jump", "times": [100.0]},
        {"trajectory": "2b", "reason": "end", "times": [105.0]},
    ]


def test_only_so_many_doubtful_rows_are_listed() -> None:
    excluded = tuple(ExcludedRow(0, row, "jump") for row in range(MOST_ROWS + 10))
    (described,) = noise(recording(trajectory(MOST_ROWS + 10), excluded=excluded), {})["x"]["doubtful"]
    assert len(described["times"]) == MOST_ROWS


def test_smoothed_rows_stand_beside_measured_ones() -> None:
    described = smoothing(recording(trajectory(5), trajectory(4, "2", held_out=True)))
    assert described is not None
    assert (described["rows"], described["listed"]) == (9, 9)
    first, second = described["trajectories"]
    assert (first["name"], first["held_out"], second["name"], second["held_out"]) == ("1", False, "2", True)
    assert first["times"] == [95.0, 97.5, 100.0, 102.5, 105.0]
    assert [*first["measured"]] == [*first["smoothed"]] == [*first["residuals"]] == ["x"]
    assert first["smoothed"]["x"] == pytest.approx(np.sin([-5.0, -2.5, 0.0, 2.5, 5.0]), abs=1e-6)
    assert first["residuals"]["x"] == pytest.approx([0.1, -0.1, 0.1, -0.1, 0.1])


@pytest.mark.parametrize(("count", "rows"), [(1, 50_001), (40, 501), (3000, 10)])
def test_of_many_rows_some_are_listed_and_their_number_is_said(count: int, rows: int) -> None:
    described = smoothing(recording(*(trajectory(rows, str(number)) for number in range(count))))
    assert described is not None
    listed = [trajectory["times"] for trajectory in described["trajectories"]]
    assert described["rows"] == count * rows
    assert described["listed"] == sum(map(len, listed)) <= max(MOST_ROWS, 2 * count)
    assert {(described_smoothing[0], described_smoothing[-1]) for described_smoothing in listed} == {(95.0, 105.0)}


def test_no_table_without_smoothed_states_and_nothing_but_numbers() -> None:
    clean = recording(trajectory(5))
    clean = Recording(*(getattr(clean, name) for name in ("states", "state_symbols", "velocity_symbols")),
                      (), (), 1, 0.0, clean.smoothing[1:] * 2, clean.trajectories)  # fmt: skip
    assert smoothing(clean) is None
    assert smoothing(None) is None
    wild = trajectory(5)
    wild.measured[0, 2] = math.inf
    described = smoothing(recording(wild))
    assert described is not None
    assert described["trajectories"][0]["measured"]["x"][2] is None
    json.dumps([described, noise(recording(wild), {})], allow_nan=False)


def whole(errors: dict[str, Errors]) -> Result:
    return Result(equations=(), symbols={}, noise=tables.describe_noise(recording(trajectory(101)), errors))


def test_what_residuals_say_of_errors_is_listed_and_told_in_words():
    solver = Errors(
        sd=2e-4, proportional=0.0, correlated=1.0, correlation_rows=5.0, independent_rows=20.0, add_up=True, piece=10
    )
    sensor = Errors(sd=0.1, proportional=0.8, correlated=0.5, correlation_rows=6.3, independent_rows=30.0)
    described = noise(recording(trajectory(101)), {"x": sensor})["x"]["errors"]
    assert (described["sd"], described["proportional"], described["correlation_rows"], described["add_up"]) == (
        0.1,
        0.8,
        6.3,
        False,
    )
    line, *_ = noise_lines(whole({"x": sensor}))
    assert "80 % of their variance grows with the value squared" in line
    assert "50 % of the error variance is correlated over about 6 rows" in line
    line, *_ = noise_lines(whole({"x": solver}))
    assert "errors accumulate along trajectories, like integration errors of a solver: 0.0002 within 10 rows" in line


CONFIG = JobConfig(seed=3, data=DataConfig(target="y"))


def test_columns_units_ranges_and_digest_are_those_of_the_table(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("x [m],y [m/s]\n" + "\n".join(f"{row},{2 * row}" for row in range(9)))
    table = read_table([tmp_path / "a.csv"], CONFIG.data)
    preparation = prepare(table, CONFIG)
    source = {"digest": table.digest, "files": ["a.csv"], "rows": 9, "read_as": "text with commas"}
    assert data(preparation) == {**source, "trajectories": None}
    assert system(preparation) == {
        "kind": "regression",
        "order": 1,
        "time": None,
        "states": [],
        "velocities": [],
        "inputs": ["x"],
        "input_kinds": {},
        "target": "y",
        "units": {"x": "m", "y": "m/s"},
        "ranges": {"x": [0.0, 8.0]},
    }


def test_what_was_measured_of_trajectories_is_kept_evenly_thinned(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = [f"{run},{0.1 * row:.1f},{row + run},{row * row},{1 + row % 2}" for run in (1, 2) for row in range(20)]
    (tmp_path / "a.csv").write_text("run,t,x,u,w\n" + "\n".join(rows))
    config = JobConfig(data=DataConfig(trajectory="run", inputs=("u",), weights="w", holdout=1))
    preparation = prepare(read_table([tmp_path / "a.csv"], config.data), config)
    assert data(preparation, has_trajectories=False)["trajectories"] is None  # type: ignore[index]
    first, second = data(preparation)["trajectories"]  # type: ignore[index]
    assert (first["held_out"], second["held_out"]) == (False, True)
    assert first["rows"] == len(first["times"]) == 20
    assert first["measured"] == {"x": [float(row + 1) for row in range(20)]}
    assert first["inputs"]["u"][3] == 9.0
    assert abs(first["input_slopes"]["u"][3] - 60.0) < 1e-6
    assert abs(first["weights"][1] - 2.0 * first["weights"][0]) < 1e-9
    assert first["robustness_weights"] is None
    np.testing.assert_allclose(first["times"], np.arange(20) / 10.0, atol=1e-12)
    monkeypatch.setattr(tables, "MOST_ROWS", 24)
    first, second = data(preparation)["trajectories"]  # type: ignore[index]
    assert (len(first["times"]), first["rows"]) == (12, 20)
    assert (first["measured"]["x"][0], first["measured"]["x"][-1]) == (1.0, 20.0)
