"""A result says what its columns are, in which units and ranges, and which data it comes from."""

from pathlib import Path

import numpy as np
import pytest

from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.data.reading.files import read_table
from atoll_coordinator.model.result import source
from atoll_coordinator.model.result.source import settings
from atoll_core.config import DataConfig, JobConfig
from tests.unit.coordinator.model.result.plain import plainly

data, system = plainly(source.data), plainly(source.system)

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
    monkeypatch.setattr(source, "MOST_ROWS", 24)
    first, second = data(preparation)["trajectories"]  # type: ignore[index]
    assert (len(first["times"]), first["rows"]) == (12, 20)
    assert (first["measured"]["x"][0], first["measured"]["x"][-1]) == (1.0, 20.0)


def test_settings_are_those_that_are_not_defaults() -> None:
    assert settings(CONFIG) == {"seed": 3, "data": {"target": "y"}}
