"""What a person is told about the data that were read."""

import numpy as np
import pytest

from atoll_coordinator.data.outline import describe
from atoll_coordinator.data.reading.files import read_table
from atoll_core.config import DataConfig, JobConfig, PriorConfig
from atoll_core.errors import DataError
from tests.unit.coordinator.data.tables import oscillator, table_of


def described(columns, starts=(0,), **options):
    return describe(table_of(columns, starts), JobConfig(data=DataConfig(**options))).split("\n")


def test_trajectories_rows_time_and_columns_are_said():
    columns = {name: np.tile(values, 2) for name, values in oscillator(30, 0.02).items()}
    assert described(columns, (0, 30), inputs=("y",)) == [
        "a.csv: 2 trajectories, 60 rows",
        "time t: 0 to 0.58, step 0.02",
        "states: x",
        "inputs: y",
    ]


def test_uneven_steps_are_said():
    columns = oscillator(30)
    columns["t"] = np.arange(30.0) ** 2
    assert described(columns)[1] == "time t: 0 to 841, steps 1 to 57"


def test_units_are_said(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("t [s],v [m/s],label\n" + "".join(f"{row},{row * row},{row}\n" for row in range(9)))
    table = read_table([path], DataConfig())
    assert describe(table, JobConfig(data=DataConfig(states=("v",)))).split("\n")[1:] == [
        "read as text with commas",
        "time t [s]: 0 to 8, step 1",
        "states: v [m/s]",
    ]


def test_units_that_are_given_go_before_those_of_the_header():
    assert described(oscillator(), units={"t": "h", "y": "m"})[1:] == [
        "time t [h]: 0 to 5.9, step 0.1",
        "states: x, y [m]",
    ]


def test_a_target_is_said():
    assert described(oscillator(), target="y") == ["a.csv: 60 rows", "target: y", "inputs: x"]


def test_dropped_rows_are_said():
    columns = oscillator()
    columns["x"][3] = np.nan
    assert described(columns, missing="drop")[0] == "a.csv: 60 rows"
    columns["y"][3] = np.nan
    assert described(columns, missing="drop")[0] == "a.csv: 60 rows (59 that can be used)"


def test_objections_are_met_before_anything_is_uploaded():
    columns = oscillator()
    columns["x"][3] = np.nan
    with pytest.raises(DataError, match="add --missing drop"):
        described(columns)


def test_what_is_known_of_a_diffusion_is_said():
    config = JobConfig(
        data=DataConfig(stochastic=True), prior=PriorConfig(known={"[x]": "0.25"}, bounds={"[y]": ("c > 0.1",)})
    )
    lines = describe(table_of(oscillator(120)), config).split("\n")
    assert lines[-2:] == ["known: d[x]/dt = 0.25", "bounds: d[y]/dt: c > 0.1"]
