"""A result says what its columns are, in which units and ranges, and which data it comes from."""

from pathlib import Path

from atoll.config import DataConfig, JobConfig
from atoll_coordinator.data.prepare import prepare
from atoll_coordinator.data.reading.files import read_table
from atoll_coordinator.model.report.source import data, settings, system

CONFIG = JobConfig(seed=3, data=DataConfig(target="y"))


def test_columns_units_ranges_and_digest_are_those_of_the_table(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("x [m],y [m/s]\n" + "\n".join(f"{row},{2 * row}" for row in range(9)))
    table = read_table([tmp_path / "a.csv"], CONFIG.data)
    preparation = prepare(table, CONFIG)
    assert data(preparation.source) == {"digest": table.digest, "files": ["a.csv"], "rows": 9}
    assert system(preparation) == {
        "kind": "regression",
        "order": 1,
        "time": None,
        "states": [],
        "velocities": [],
        "inputs": ["x"],
        "target": "y",
        "units": {"x": "m", "y": "m/s"},
        "ranges": {"x": [0.0, 8.0]},
    }


def test_settings_are_those_that_are_not_defaults() -> None:
    assert settings(CONFIG) == {"seed": 3, "data": {"target": "y"}}
